"""An explorer without a kernel: moved by hand, keyboard and finger, on a page from the disk."""

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from workbook import figures
from workbook.checks import InputError
from workbook.explorer import Choice, Slider
from workbook.publish import replace_folder
from workbook.site.build import static_files
from workbook.site.explorers import Explorer
from workbook.site.states import packed, states

PAGE = """<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>x</title>
<link rel="stylesheet" href="static/site.css"><script src="static/explorer.js" defer></script></head>
<body><main><article class="notebook"><figure id="figure-x" class="explorer" data-states="{states}">
<a class="zoom" href="x.png">the picture</a><figcaption>below</figcaption></figure></article></main></body></html>"""

# Ends of the first line in front, or of its ghost, in shares of the plot.
ENDS = """
const [plot] = document.querySelectorAll(".panel > svg > svg");
const path = plot.querySelector(arguments[0]);
if (!path) return null;
const [x, y, width, height] = plot.getAttribute("viewBox").split(" ").map(Number);
const points = path.getAttribute("d").slice(1).split("L").map((pair) => pair.split(" ").map(Number));
return [points[0], points.at(-1)].map(([a, b]) => [(a - x) / width, 1 - (b - y) / height]);
"""


def paint(rise, level_mm, kind, bend):
    if kind == "refused":
        raise InputError("kind is refused; take the other")
    figure, (left, right) = figures.new(1, 2)
    left.plot([1, 100], [level_mm, level_mm + rise + bend / 100], label="line $x_1$")
    left.set(xscale="log", xlabel="frequency (Hz)", ylabel="height (mm)", xlim=(1, 100), ylim=(0, 10))
    left.legend()
    right.plot([0, 1], [0, bend], "o")
    right.set(xlabel="time (s)", ylabel="bend (1)")
    return figure


@pytest.fixture(scope="module")
def page(browser, tmp_path_factory):
    controls = {
        "rise": Slider(0.0, 4.0, 1.0, step=0.5),
        "level_mm": Slider(0.0, 5.0, 2.0, "mm", step=1.0),
        "kind": Choice(("plain", "refused"), "plain"),
        "bend": Slider(1.0, 100.0, 10.0, log=True, step=1),
    }
    folder = tmp_path_factory.mktemp("explorer") / "site"
    found = states(Explorer(paint, controls))
    html = PAGE.format(states=packed(found))
    replace_folder(folder, {**static_files(), "page.html": html.encode()})
    browser.resize(1200)
    browser.requests()
    browser.open((folder / "page.html").as_uri())
    yield browser
    assert [each for each in browser.requests() if not each.startswith((folder.as_uri(), "data:"))] == []
    assert browser.messages() == []


@pytest.fixture
def moving(page):
    """The page at the start, and its controls."""
    page.resize(1200)
    WebDriverWait(page.driver, 60).until(lambda _: page.run("return document.querySelector('[data-ready]')"))
    page.driver.find_element(By.CSS_SELECTOR, ".controls button").click()
    return page


def control(page, number: int):
    return page.driver.find_element(By.ID, f"figure-x-{number}")


def told(page) -> str:
    return page.driver.find_element(By.CSS_SELECTOR, ".told").text


def near(wanted):
    return [pytest.approx(each, abs=0.005) for each in wanted]


def test_keys_move_the_line_and_leave_the_start_as_a_ghost(moving):
    control(moving, 0).send_keys(Keys.END)
    assert moving.run(ENDS, ".front path") == near([[0, 0.2], [1, 0.61]])
    assert moving.run(ENDS, ".ghost path") == near([[0, 0.2], [1, 0.31]])
    assert control(moving, 0).get_attribute("aria-valuetext") == "4"
    control(moving, 0).send_keys(Keys.ARROW_LEFT)
    assert moving.run(ENDS, ".front path") == near([[0, 0.2], [1, 0.56]])
    assert "grey" in told(moving)
    moving.driver.find_element(By.CSS_SELECTOR, ".controls button").click()
    assert moving.run(ENDS, ".ghost path") is None


def test_a_setting_without_a_picture_says_why(moving):
    moving.run(
        "const s = document.getElementById('figure-x-2'); s.value = 1; s.dispatchEvent(new Event('input'))"
    )
    assert told(moving) == "no picture: kind is refused; take the other"
    assert not moving.driver.find_elements(By.CSS_SELECTOR, ".panel")


def test_a_finger_drags_a_slider(moving):
    slider = control(moving, 0)
    box = slider.rect
    places = [box["x"] + share * box["width"] for share in (0.25, 0.6, 0.98)]
    y = box["y"] + box["height"] / 2 - moving.run("return window.scrollY")
    events = [("touchStart", places[0]), *(("touchMove", place) for place in places[1:]), ("touchEnd", None)]
    for kind, place in events:
        points = [] if place is None else [{"x": place, "y": y}]
        moving.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    WebDriverWait(moving.driver, 60).until(
        lambda _: slider.get_attribute("value") == slider.get_attribute("max")
    )
    assert moving.run(ENDS, ".front path") == near([[0, 0.2], [1, 0.61]])
