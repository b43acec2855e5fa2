"""Every page of the site, as a browser sees it from the disk. Each page is opened once, and all is asked then."""

import base64
import json
import re
import zlib
from datetime import date
from urllib.parse import unquote

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from workbook.claims import ledger
from workbook.site.states import MAIN, kept_states
from workbook.tasks import tasks

NARROW, WIDE = 390, 1440

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

# Displayed formulas that are wider than their place and do not scroll, or without keys.
CUT = """
return [...document.querySelectorAll(".equation")].filter((box) => box.scrollWidth > box.clientWidth + 1)
  .filter((box) => getComputedStyle(box).overflowX !== "auto" || box.getAttribute("tabindex") !== "0")
  .map((box) => box.textContent);
"""

# What does not fit: a page wider than its window, a picture wider than what it stands in, text too small to read.
MISFITS = """
const limit = document.documentElement.clientWidth;
const faults = document.documentElement.scrollWidth > limit ? [`${document.documentElement.scrollWidth} in ${limit}`] : [];
for (const image of document.images) if (image.getBoundingClientRect().right > limit) faults.push(image.src);
for (const element of document.querySelectorAll("main :is(p, li, td, th, dd, dt, pre, code, figcaption, summary)"))
  if (parseFloat(getComputedStyle(element).fontSize) < 11.5 && element.textContent.trim()) faults.push(element.outerHTML.slice(0, 80));
return faults;
"""

# Text whose contrast with what is behind it is below WCAG AA: 4.5, for large text 3.
CONTRAST = """
const channels = (text) => { const c = text.match(/[\\d.]+/g).map(Number); return c.length < 4 ? [...c, 1] : c; };
const luminance = (c) => {
  const [r, g, b] = c.slice(0, 3).map((v) => v / 255).map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const known = new Map();
const behind = (element) => {
  if (!element) return [255, 255, 255];
  if (!known.has(element)) {
    const c = channels(getComputedStyle(element).backgroundColor);
    known.set(element, c[3] === 1 ? c : behind(element.parentElement));
  }
  return known.get(element);
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


OUTLINE = """
const levels = [...document.querySelectorAll("h1, h2, h3, h4, h5")].map((each) => Number(each.tagName[1]));
const faults = [];
if (levels.filter((level) => level === 1).length !== 1) faults.push(`h1: ${levels}`);
if (levels.some((level, at) => at && level > levels[at - 1] + 1)) faults.push(`a level left out: ${levels}`);
for (const link of document.querySelectorAll("a[href]"))
  if (!link.textContent.trim() && !link.ariaLabel && !link.querySelector("img[alt]:not([alt=''])")) faults.push(link.outerHTML);
if (!document.title || document.documentElement.lang !== "en") faults.push("title or language");
if (document.querySelector("[onclick], [onchange], [onload], [style], script:not([src])")) faults.push("inline");
const ids = [...document.querySelectorAll("[id]")].map((each) => each.id);
if (new Set(ids).size !== ids.length) faults.push(...ids.filter((id, at) => ids.indexOf(id) !== at));
return faults;
"""


# Explorers that do not move: each control is put to both of its ends.
EXPLORERS = """
const faults = [];
for (const figure of document.querySelectorAll("figure[data-states]")) {
  if (!figure.dataset.ready) faults.push("not drawn");
  const drawn = () => figure.querySelector(".panels").innerHTML + figure.querySelector(".told").textContent;
  const home = drawn();
  for (const control of figure.querySelectorAll(".control :is(input, select)")) {
    const pictures = [0, control.options ? control.options.length - 1 : control.max].map((stop) => {
      control.value = stop;
      control.dispatchEvent(new Event("input", {bubbles: true}));
      if (/NaN|undefined|Infinity/.test(drawn())) faults.push(`${control.id} at ${stop}: no number`);
      return drawn();
    });
    if (pictures.every((each) => each === home)) faults.push(`${control.id} moves nothing`);
    figure.querySelector(".controls button:not(.presets *)").click();
    if (drawn() !== home) faults.push(`${control.id} does not come back`);
  }
  for (const preset of figure.querySelectorAll(".presets button")) {
    preset.click();
    if (preset.getAttribute("aria-pressed") !== "true") faults.push(`${preset.textContent}: not shown as chosen`);
    if (/NaN|undefined|Infinity/.test(drawn())) faults.push(`${preset.textContent}: no number`);
  }
}
return faults;
"""


# Pages that name no design but the one that their explorer starts from.
WITHOUT_PRESETS = {
    "budget/05-your-budget": "the reader's machine",
    "fixedpoint/09-your-plant": "the reader's plant",
    "isolation/06-efficient-update": "one size, the paper's",
    "isolation/08-your-floor": "the reader's floor",
    "motion/01-scan-performance": "one controller, of Example 1.5.1",
    "motion/02-model-reduction": "one reduction, of three modes",
    "motion/25-rig-over-geometries": "geometries are drawn, none has a name",
    "motion/29-your-machine": "the reader's machine",
    "worstcase/02-contraction": "one counter-example",
    "worstcase/07-your-record": "the reader's record",
}


@pytest.fixture(scope="module")
def pages(site):
    """All, but of the reference's modules, which are of one form, a tenth, others each day."""
    modules = sorted(set((site / "reference").glob("*.html")) - {site / "reference" / "index.html"})
    left = {each for number, each in enumerate(modules) if (number - date.today().toordinal()) % 10}
    return sorted(set(site.rglob("*.html")) - left)


@pytest.fixture(scope="module")
def seen(browser, site, pages) -> dict[str, dict[str, list]]:
    """What is wrong, by what was asked and then by page; `formulas` counts instead."""
    found = {}
    browser.requests(), browser.messages()
    for page in pages:
        browser.resize(WIDE)
        browser.open(page.as_uri())
        answers = {
            "pictures": browser.driver.execute_async_script(PICTURES),
            "wide": browser.run(MISFITS) + browser.run(CUT),
            "formulas": browser.run("return document.querySelectorAll('math').length"),
            "unrendered": browser.run(FORMULAS)
            + re.findall(r"\$[^$\n]*[\\^_{][^$\n]*\$|\\[a-z]+\{", browser.run(PROSE)),
            "contrast": browser.run(CONTRAST),
            "outline": browser.run(OUTLINE),
            "explorers": browser.run(EXPLORERS),
        }
        browser.dark(True)
        answers["contrast in the dark"] = browser.run(CONTRAST)
        browser.dark(False)
        browser.resize(NARROW)
        answers["narrow"] = browser.run(MISFITS) + browser.run(CUT)
        answers["outside"] = [
            each  # the browser's own page, with which it begins, is no request of ours
            for each in browser.requests()
            if not each.startswith((site.as_uri(), "data:", "chrome:"))
        ]
        answers["messages"] = browser.messages()
        for question, answer in answers.items():
            found.setdefault(question, {})
            if answer:
                found[question][str(page.relative_to(site))] = answer
    return found


@pytest.mark.parametrize(
    "question",
    [
        "outside",
        "messages",
        "pictures",
        "unrendered",
        "narrow",
        "wide",
        "contrast",
        "contrast in the dark",
        "outline",
        "explorers",
    ],
)
def test_nothing_is_wrong_with(seen, question):
    assert seen[question] == {}


@pytest.fixture(scope="module")
def explorers(site) -> dict[str, dict]:
    """What the site's explorers hold, by notebook."""
    kept = {name: each["states"] for name, each in kept_states(tasks()).items() if "states" in each}
    return {name: json.loads(zlib.decompress(base64.b64decode(text))) for name, text in kept.items()}


def test_every_explorer_names_its_controls_and_shows_its_designs(explorers):
    assert len(explorers) > 50
    without = {page for page, each in explorers.items() if not each["presets"]}
    assert without == WITHOUT_PRESETS.keys() & explorers.keys()
    few = {}
    for page, explorer in explorers.items():
        names = [each["name"] for each in explorer["controls"]]
        assert len({"".join(each.split()) for each in names}) == len(names), page
        assert not [each for each in explorer["controls"] if each["name"].split()[-1] == each["unit"].lower()]
        first = explorer["controls"][0]
        if not first["choice"] and 0 in explorer["joint"] and len(first["stops"]) < MAIN:
            few[page] = first["name"]
        for design, stops in explorer["presets"]:
            place = explorer["states"][".".join(map(str, stops))]
            assert isinstance(explorer["pictures"][place], list), f"{page}: {design} has no picture"
    # Whole numbers, each of which is a stop.
    assert (
        few.items()
        <= {"motion/02-model-reduction": "retained", "motion/03-position-dependence": "place"}.items()
    )


def test_search_finds_sections_numbers_and_names_and_keeps_the_words_in_the_address(browser, site):
    browser.resize(WIDE)
    browser.open((site / "index.html").as_uri())
    field = browser.driver.find_element(By.CSS_SELECTOR, "header input[type=search]")
    field.send_keys("bandwidth damping", Keys.ENTER)
    WebDriverWait(browser.driver, 60).until(lambda _: "search.html?q=bandwidth" in browser.driver.current_url)
    found = browser.run(
        "return [...document.querySelectorAll('#results a')].map((each) => each.getAttribute('href'))"
    )
    texts = {
        address: " ".join(each).lower()
        for *each, address in browser.run(
            "return searchIndex.map(([title, kind, address, text]) => [title, kind, text, address])"
        )
    }
    assert 5 < len(found) <= 50
    # Either word finds a page; those with both stand first.
    assert all("bandwidth" in texts[each] and "damping" in texts[each] for each in found[:5])
    assert all("bandwidth" in texts[each] or "damping" in texts[each] for each in found)
    browser.driver.find_element(By.CSS_SELECTOR, "#results a").click()
    assert browser.run("return Boolean(document.querySelector(':target'))")
    entry = next(claim.entry for claim in ledger() if claim.notebook)
    for words, place in (
        (entry.id, f"ledger.html#row-{entry.id}"),
        ("lti tustin", "reference/stillwork.lti."),
    ):
        browser.open((site / "search.html").as_uri() + f"?q={words}")
        first = browser.driver.find_element(By.CSS_SELECTOR, "#results a").get_attribute("href")
        assert place in unquote(first)
    browser.open((site / "search.html").as_uri() + "?q=xyzzy+plugh")
    assert browser.driver.find_element(By.ID, "found").text == "0 places"
