"""The desk in a cell of Jupyter, in Chromium: its view against a model with anywidget's interface."""

import json
import re

import numpy as np
import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from stillwork.control.digital import load_controller
from stillwork.design.desk import machine_to_begin_with
from stillwork.design.desk_page import widget_module

# What anywidget hands to a view: `get`, `set`, `save_changes`, `on`, `off`. Two views of one model stand on the page.
HOST = """
<!doctype html><title>cells</title><div id="above" style="width: 900px"></div><div id="below" style="width: 900px"></div>
<script type="module">
const values = {values}, listeners = new Set(), key = (name) => JSON.stringify(values[name]);
const model = {{
  get: (name) => values[name],
  set(name, value) {{
    const before = key(name);
    values[name] = value;
    if (key(name) !== before) for (const each of [...listeners]) if (each.name === `change:${{name}}`) each.call();
  }},
  save_changes: () => (window.saved = (window.saved ?? 0) + 1),
  on: (name, call) => listeners.add({{ name, call }}),
  off: (name, call) => listeners.forEach((each) => each.call === call && listeners.delete(each)),
}};
const source = URL.createObjectURL(new Blob([{module}], {{ type: "text/javascript" }}));
const {{ default: widget }} = await import(source);
window.model = model;
window.widget = widget;
window.values = values;
window.listeners = listeners;
window.ends = ["above", "below"].map((id) => widget.render({{ model, el: document.getElementById(id) }}));
</script>
"""


class Cells:
    """The page, and what stands in its cells and in Python."""

    def __init__(self, browser):
        self.browser, self.driver = browser, browser.driver

    def wait(self, condition):
        return WebDriverWait(self.driver, 30, poll_frequency=0.1).until(lambda _: condition())

    def python(self, name):
        return self.browser.run(f"return window.values.{name}")

    def by(self, cell, name):
        shadow = self.driver.find_element(By.CSS_SELECTOR, f"#{cell} > div").shadow_root
        return shadow.find_element(By.CSS_SELECTOR, f"#desk-{name}")

    def value(self, cell, name):
        return float(self.by(cell, name).get_property("value"))


@pytest.fixture
def cells(browser, tmp_path):
    machine = machine_to_begin_with(rate=5e3)
    values = {
        "machines": [machine],
        "machine": machine["name"],
        "design": {},
        "controller": "",
        "reached": {},
    }
    page, module = tmp_path / "cells.html", json.dumps(widget_module()).replace("<", "\\u003c")
    page.write_text(HOST.format(values=json.dumps(values), module=module), encoding="utf-8")
    browser.resize(1440)
    browser.driver.get("about:blank")
    browser.requests(), browser.messages()
    browser.open(page.as_uri())
    found = Cells(browser)
    found.wait(lambda: found.python("controller"))
    yield found
    browser.require_quiet()


def test_what_is_shaped_in_a_cell_is_in_python(cells, tmp_path):
    before = cells.python("reached")
    assert before["stable"] and before["bandwidth_hz"] > 1 and before["peaks_db"]["output_sensitivity"] < 6
    field, gain = cells.by("above", "0-gain"), cells.value("above", "0-gain")
    cells.browser.run("arguments[0].focus(); arguments[0].select()", field)
    ActionChains(cells.driver).send_keys(f"{2 * gain:.7g}", Keys.TAB).perform()
    cells.wait(lambda: cells.python("design")["blocks"][0]["gain"] == pytest.approx(2 * gain, rel=1e-6))
    cells.wait(lambda: cells.python("reached")["bandwidth_hz"] > 1.2 * before["bandwidth_hz"])
    cells.wait(lambda: cells.python("reached")["whole_box"])
    (tmp_path / "controller.toml").write_text(cells.python("controller"), encoding="utf-8")
    assert load_controller(tmp_path / "controller.toml").model.sample_time == 1 / 5000
    # Another view of it, in another cell, and undone there.
    cells.wait(lambda: cells.value("below", "0-gain") == pytest.approx(2 * gain, rel=1e-5))
    cells.by("below", "undo").click()
    cells.wait(lambda: cells.value("above", "0-gain") == pytest.approx(gain, rel=1e-5))


def test_a_design_from_python_is_shown_and_what_is_none_refused(cells):
    design = cells.python("design")
    design["blocks"][0]["gain"] *= 0.5
    cells.browser.run("window.model.set('design', arguments[0])", design)
    for cell in ("above", "below"):
        cells.wait(
            lambda cell=cell: (
                cells.value(cell, "0-gain") == pytest.approx(design["blocks"][0]["gain"], rel=1e-5)
            )
        )
    cells.browser.run("window.model.set('design', {blocks: [{kind: 'gain'}]})")
    cells.wait(lambda: "no known kind, or one that lacks numbers" in cells.by("above", "message").text)
    # Without a sampling block there is no controller to be run.
    design["blocks"] = [each for each in design["blocks"] if each["kind"] != "sampling"]
    cells.browser.run("window.model.set('design', arguments[0])", design)
    cells.wait(lambda: cells.python("controller") == "")


def test_what_is_refused_does_not_stay_in_python(cells):
    before = cells.python("design")
    for block in (
        {"kind": "pid"},
        {"kind": "delay", "delay_us": -100.0},
        {"kind": "sampling", "rate_hz": 1e4},
    ):
        wrong = {**before, "blocks": [*before["blocks"], block]}
        cells.browser.run("window.model.set('design', arguments[0])", wrong)
        assert cells.python("design") == before
        assert "the desk keeps its own" in cells.by("above", "message").text
    wrong = {**before, "limit": "50"}
    cells.browser.run("window.model.set('design', arguments[0])", wrong)
    assert cells.python("design") == before


def test_a_dropped_machine_is_in_every_cell(cells):
    """Also in one that is shown later, which leaves the design as it is."""
    hertz = np.linspace(2, 400, 300)
    rows = "\n".join(f"{f},{1 / 3 * (1 + 0.1 * (f / 300) ** 2):.8g},{-1e-3 * f:.8g}" for f in hertz)
    cells.browser.run(
        """const files = new DataTransfer(), input = document.querySelector('#above > div').shadowRoot.querySelector('#desk-file');
        files.items.add(new File([arguments[0]], 'own.csv'));
        input.files = files.files;
        input.dispatchEvent(new Event('change'));""",
        f"frequency (Hz),real (m/s^2/N),imaginary (m/s^2/N)\n{rows}\n",
    )
    cells.wait(lambda: cells.python("machine") == "own.csv")
    cells.wait(lambda: cells.by("below", "machine").get_property("value") == "own.csv")
    assert [each["name"] for each in cells.python("machines")][1:] == ["own.csv"]
    field, gain = cells.by("above", "0-gain"), cells.value("above", "0-gain")
    cells.browser.run("arguments[0].focus(); arguments[0].select()", field)
    ActionChains(cells.driver).send_keys(f"{0.7 * gain:.7g}", Keys.TAB).perform()
    cells.wait(lambda: cells.value("below", "0-gain") == pytest.approx(0.7 * gain, rel=1e-5))
    before = cells.python("design")
    cells.browser.run(
        """const cell = document.createElement('div');
        cell.id = 'third';
        document.body.append(cell);
        window.widget.render({ model: window.model, el: cell });"""
    )
    cells.wait(lambda: cells.value("third", "0-gain") == pytest.approx(0.7 * gain, rel=1e-5))
    assert cells.python("machine") == "own.csv" and cells.python("design") == before


def test_a_cell_keeps_to_itself_and_ends(cells):
    """Keys outside it, the page's address and its style are none of its; a narrow cell is laid out as a narrow page."""
    cells.browser.run(
        "document.body.dispatchEvent(new KeyboardEvent('keydown', {key: 'z', ctrlKey: true, cancelable: true}))"
    )
    assert "#" not in cells.driver.current_url
    assert not re.search(r"\bdesk-", cells.browser.run("return document.getElementById('above').innerHTML"))
    columns = "return getComputedStyle(document.querySelector('#above > div').shadowRoot.querySelector('.desk-columns')).gridTemplateColumns.split(' ').length"
    assert cells.browser.run(columns) == 2
    cells.browser.run("document.getElementById('above').style.width = '400px'")
    cells.wait(lambda: cells.browser.run(columns) == 1)
    cells.wait(lambda: cells.by("above", "magnitude").get_property("width") < 400)
    cells.browser.run("window.ends.forEach((end) => end())")
    assert cells.browser.run("return window.listeners.size") == 0
