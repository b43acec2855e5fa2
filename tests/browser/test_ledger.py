"""The ledger's page: filters, order, links, and all of it by keyboard."""

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from workbook.choices.command import judged_ledger
from workbook.report import column

CLAIMS = judged_ledger()
ROWS = "return [...document.querySelectorAll('#claims tbody tr')].filter((row) => !row.hidden).map((row) => row.id)"
BY_ID = {f"row-{claim.entry.id}": claim for claim in CLAIMS}


@pytest.fixture
def front(browser, site):
    browser.resize(1440)
    browser.open("about:blank")
    browser.open((site / "ledger.html").as_uri())
    return browser


def choose(front, field: str, value: str) -> None:
    Select(front.driver.find_element(By.NAME, field)).select_by_value(value)


def told(front) -> str:
    return front.driver.find_element(By.ID, "shown").text


@pytest.mark.parametrize(
    ("field", "value_of"),
    [
        ("topic", lambda claim: claim.entry.topic),
        ("counted", column),
        ("verdict", lambda claim: claim.verdict),
        ("kind", lambda claim: claim.entry.kind),
    ],
)
def test_each_filter_shows_what_the_ledger_has(front, field, value_of):
    for value in sorted({value_of(claim) for claim in CLAIMS}):
        choose(front, field, value)
        wanted = [row for row, claim in BY_ID.items() if value_of(claim) == value]
        assert front.run(ROWS) == wanted
        assert told(front) == f"{len(wanted)} of {len(CLAIMS)} numbers"


def test_rows_come_by_the_page_and_a_link_leads_past_it(front, site):
    """Whichever the width, some screens of rows stand there at first, and more after a click."""
    seen = (
        "return [...document.querySelectorAll('#claims tbody tr')].filter((row) => row.offsetHeight).length"
    )
    for width in (390, 1440):
        front.resize(width)
        front.open("about:blank")
        front.open((site / "ledger.html").as_uri())
        first = front.run(seen)
        assert 0 < first < len(CLAIMS) / 5
        front.driver.find_element(By.ID, "more").click()
        assert front.run(seen) == 2 * first
    last = front.run("return [...document.querySelectorAll('#claims tbody tr')].at(-1).id")
    front.open("about:blank")
    front.open((site / "ledger.html").as_uri() + f"#{last}")
    assert front.run("return document.querySelector(':target').offsetHeight") > 0
    assert not front.driver.find_element(By.ID, "more").is_displayed()


def test_a_view_is_kept_in_the_address(front):
    choose(front, "verdict", "not replicated")
    choose(front, "order", "farthest")
    front.driver.find_element(By.CSS_SELECTOR, "#filters [name=q]").send_keys("floor")
    shown, address = front.run(ROWS), front.driver.current_url
    assert shown
    front.open("about:blank")
    front.open(address)
    assert front.run(ROWS) == shown
    front.open(address.replace("verdict=not+replicated", "verdict=nothing"))
    assert len(front.run(ROWS)) > len(shown)


def test_the_table_is_there_without_the_script(front, site):
    front.driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    try:
        front.open((site / "ledger.html").as_uri())
        rows = front.driver.find_elements(By.CSS_SELECTOR, "#claims tbody tr")
        assert len(rows) == len(CLAIMS)
        assert rows[0].is_displayed()
    finally:
        front.driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": False})


def press(front, key):
    front.driver.switch_to.active_element.send_keys(key)


FOCUS = """
const at = document.activeElement, style = getComputedStyle(at);
return [at.tagName, at.name || at.getAttribute("href") || at.id || at.textContent.trim(),
        style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2];
"""


def test_the_keyboard_reaches_and_works_the_filters(front):
    front.driver.find_element(By.TAG_NAME, "body").send_keys(Keys.TAB)
    stops = [front.run(FOCUS)]
    assert stops[0][1] == "#content"  # the way past the navigation comes first
    for _ in range(100):  # every count and every statement above is a link
        press(front, Keys.TAB)
        stops.append(front.run(FOCUS))
        if stops[-1][1] == "verdict":
            break
    assert stops[-1][1] == "verdict", stops
    assert all(visible for *_, visible in stops), [stop for stop in stops if not stop[2]]
    press(front, "n")  # a select takes the first letter of an option
    assert {BY_ID[row].verdict for row in front.run(ROWS)} <= {"not replicated", "not judged", "not built"}
