"""Every page of the site, as a browser sees it from the disk."""

import re

import pytest

WIDTHS = (390, 1440)

# Load what is lazy, and wait until every picture has arrived or failed.
PICTURES = """
const done = arguments[0];
const images = [...document.images];
images.forEach((image) => { image.loading = "eager"; });
Promise.allSettled(images.map((image) => image.decode())).then(() =>
  done(images.filter((image) => !image.naturalWidth || !image.alt).map((image) => image.src)));
"""

# Formulas without size, with an error in them, or in which a glyph is missing its script position.
FORMULAS = """
return [...document.querySelectorAll("math")].filter((formula) => {
  const box = formula.getBoundingClientRect();
  const shown = formula.closest("details:not([open])") === null;
  return formula.querySelector("merror") || (shown && (box.width < 3 || box.height < 5));
}).map((formula) => formula.outerHTML);
"""

PROSE = """
const copy = document.querySelector("main").cloneNode(true);
copy.querySelectorAll("pre, code, math, svg").forEach((each) => each.remove());
return copy.textContent;
"""

# What sticks out of the page's width, other than inside a part that scrolls by itself.
TOO_WIDE = """
const limit = document.documentElement.clientWidth;
return document.documentElement.scrollWidth > limit ? [document.documentElement.scrollWidth, limit] : [];
"""

# Text whose contrast with what is behind it is below WCAG AA: 4.5, for large text 3.
CONTRAST = """
const channels = (text) => { const c = text.match(/[\\d.]+/g).map(Number); return c.length < 4 ? [...c, 1] : c; };
const luminance = (c) => {
  const [r, g, b] = c.slice(0, 3).map((v) => v / 255).map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const behind = (element) => {
  for (let at = element; at; at = at.parentElement) {
    const c = channels(getComputedStyle(at).backgroundColor);
    if (c[3] === 1) return c;
  }
  return [255, 255, 255];
};
const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
const bad = new Set();
while (walker.nextNode()) {
  const element = walker.currentNode.parentElement;
  if (!walker.currentNode.textContent.trim() || element.closest("script, style, title, noscript")) continue;
  const style = getComputedStyle(element);
  if (style.display === "none" || style.visibility === "hidden") continue;
  const ink = element.closest("svg") ? style.fill : style.color;
  const [a, b] = [luminance(channels(ink)), luminance(behind(element))].sort((x, y) => y - x);
  const size = parseFloat(style.fontSize);
  const large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
  if ((a + 0.05) / (b + 0.05) < (large ? 3 : 4.5)) bad.add(`${element.tagName}.${element.className}: ${ink}`);
}
return [...bad];
"""


@pytest.fixture(scope="module")
def pages(site):
    return sorted(site.rglob("*.html"))


def faults(browser, pages, look) -> dict[str, list]:
    """What `look` finds wrong, by page."""
    found = {}
    for page in pages:
        browser.open(page.as_uri())
        if wrong := look():
            found[page.name] = wrong
    return found


def test_no_page_asks_for_anything_outside_or_complains(browser, site, pages):
    browser.requests(), browser.messages()

    def look():
        missing = browser.driver.execute_async_script(PICTURES)
        outside = [each for each in browser.requests() if not each.startswith(site.as_uri())]
        return missing + outside + browser.messages()

    assert faults(browser, pages, look) == {}


def test_every_formula_is_rendered(browser, pages):
    total = 0

    def look():
        nonlocal total
        total += browser.run("return document.querySelectorAll('math').length")
        raw = re.findall(r"\$[^$\n]*[\\^_{][^$\n]*\$|\\[a-z]+\{", browser.run(PROSE))
        return browser.run(FORMULAS) + raw

    assert faults(browser, pages, look) == {}
    assert total > 50


@pytest.mark.parametrize("width", WIDTHS)
def test_pages_fit(browser, pages, width):
    browser.resize(width)
    assert faults(browser, pages, lambda: browser.run(TOO_WIDE)) == {}


def test_text_stands_out_from_what_is_behind_it(browser, pages):
    browser.resize(1440)
    assert faults(browser, pages, lambda: browser.run(CONTRAST)) == {}


def test_the_contrast_check_notices_pale_text(browser, pages):
    browser.open(pages[0].as_uri())
    browser.run("document.querySelector('main p').style.color = '#999'")
    assert browser.run(CONTRAST)


def test_every_page_has_one_heading_a_title_and_a_language(browser, pages):
    outline = """
    const levels = [...document.querySelectorAll("h1, h2, h3, h4, h5")].map((each) => Number(each.tagName[1]));
    const faults = [];
    if (levels.filter((level) => level === 1).length !== 1) faults.push(`h1: ${levels}`);
    if (!document.title || document.documentElement.lang !== "en") faults.push("title or language");
    if (document.querySelector("[onclick], [onchange], [onload], [style], script:not([src])")) faults.push("inline");
    const ids = [...document.querySelectorAll("[id]")].map((each) => each.id);
    if (new Set(ids).size !== ids.length) faults.push(...ids.filter((id, at) => ids.indexOf(id) !== at));
    return faults;
    """
    assert faults(browser, pages, lambda: browser.run(outline)) == {}
