"""A notebook's page: its pictures enlarge, its code opens, and from the ledger one comes to the right place."""

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from workbook.claims import ledger

CLAIM = next(claim for claim in ledger() if claim.notebook and claim.entry.reason)


@pytest.fixture
def page(browser, site):
    browser.resize(390)
    browser.open((site / f"notebooks/{CLAIM.notebook}.html").as_uri())
    return browser


def dialogs(page) -> list:
    return page.driver.find_elements(By.CSS_SELECTOR, "dialog[open]")


def test_a_picture_enlarges_by_keyboard_and_closes_again(page):
    link = page.driver.find_element(By.CSS_SELECTOR, "a.zoom")
    small = link.find_element(By.TAG_NAME, "img").size["width"]
    link.send_keys(Keys.ENTER)
    picture = page.driver.find_element(By.CSS_SELECTOR, "dialog[open] img")
    WebDriverWait(page.driver, 60).until(lambda _: picture.size["width"] > small)
    assert picture.get_attribute("alt") == link.find_element(By.TAG_NAME, "img").get_attribute("alt")
    page.driver.switch_to.active_element.send_keys(Keys.ESCAPE)
    WebDriverWait(page.driver, 60).until(lambda _: not dialogs(page))
    assert page.driver.switch_to.active_element == link


def test_every_row_leads_to_its_place_and_every_place_back(browser, site):
    browser.open((site / "ledger.html").as_uri())
    links = browser.run(
        "return Object.fromEntries([...document.querySelectorAll('#claims tbody tr')].map((row) =>"
        "[row.id, [...row.querySelectorAll('td:last-child a')].map((link) => link.getAttribute('href'))]))"
    )
    for claim in ledger():
        found = links[f"row-{claim.entry.id}"]
        if claim.notebook:
            place = f"notebooks/{claim.notebook}.html"
            assert found[0] == f"{place}#claim-{claim.entry.id}"
            curve = f"choices/{claim.entry.topic}.html#curve-{claim.entry.id}"
            figures = [each for each in found[1:] if each != curve]
            assert all(each.startswith(f"{place}#figure-") for each in figures)
            assert len(figures) <= 1
    # The link opens the fold in which the place stands.
    browser.open((site / f"notebooks/{CLAIM.notebook}.html").as_uri() + f"#claim-{CLAIM.entry.id}")
    browser.driver.find_element(By.CSS_SELECTOR, f"[id='claim-{CLAIM.entry.id}'] a").click()
    assert browser.run("return document.querySelector(':target').id") == f"row-{CLAIM.entry.id}"
