"""The desk in Chromium: mouse, keyboard, a dropped file, the way out to C, and that all of it has a name."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select, WebDriverWait

from browser.test_pages import CONTRAST, MISFITS
from motion.true_machines import CompiledLoop, TrueMachine
from stillwork.__main__ import main
from stillwork.machine.desk_page import offline_page, shipped_machines
from workbook import paths

PATIENCE = 120  # s, of a busy machine

UNNAMED = """
const named = (element) => element.getAttribute("aria-label") || element.textContent.trim() || element.labels?.length || element.title;
const wanted = [...document.querySelectorAll("button, input, select, canvas, [role]")];
const ids = [...document.querySelectorAll("[id]")].map((each) => each.id);
return [
  ...wanted.filter((element) => !element.hidden && !named(element) && element.getAttribute("role") !== "status").map((each) => each.outerHTML.slice(0, 90)),
  ...ids.filter((id, at) => ids.indexOf(id) !== at),
  ...[...document.querySelectorAll("[role=slider]")].filter((each) => !(Number(each.getAttribute("aria-valuenow")) >= Number(each.getAttribute("aria-valuemin")) && Number(each.getAttribute("aria-valuenow")) <= Number(each.getAttribute("aria-valuemax")))).map((each) => each.outerHTML.slice(0, 90)),
];
"""

DROP = """
const data = new DataTransfer();
data.items.add(new File([arguments[1]], arguments[0]));
for (const kind of ["dragenter", "dragover", "drop"]) {
  document.getElementById("desk").dispatchEvent(new DragEvent(kind, {bubbles: true, cancelable: true, dataTransfer: data}));
}
"""


class Desk:
    """What a user does on the page, and what is there."""

    def __init__(self, browser):
        self.browser, self.driver = browser, browser.driver

    def wait(self, condition):
        return WebDriverWait(self.driver, PATIENCE, poll_frequency=0.1).until(lambda _: condition())

    def by(self, name):
        return self.driver.find_element(By.ID, f"desk-{name}")

    def value(self, name):
        return float(self.by(name).get_property("value"))

    def handle(self, label):
        return self.driver.find_element(By.CSS_SELECTOR, f"[role=slider][aria-label^='{label} ']")

    @property
    def bandwidth(self):
        return float(self.driver.find_element(By.CSS_SELECTOR, "#desk-figures dd").text.split()[0])

    @property
    def lights(self):
        return [each.text for each in self.driver.find_elements(By.CSS_SELECTOR, "#desk-lights td")]

    def type(self, name, value):
        field = self.by(name)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(f"{value}\t")

    def add(self, kind):
        Select(self.by("kind")).select_by_value(kind)
        self.by("add").click()


@pytest.fixture
def desk(browser, tmp_path):
    page = tmp_path / "desk.html"
    page.write_text(offline_page(shipped_machines(paths.root())), encoding="utf-8")
    browser.resize(1440)
    browser.driver.get("about:blank")
    browser.requests(), browser.messages()
    browser.open(page.as_uri())
    browser.require_quiet()
    folder = tmp_path / "downloads"
    folder.mkdir()
    browser.driver.execute_cdp_cmd(
        "Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(folder)}
    )
    found = Desk(browser)
    found.folder, found.page = folder, page
    found.wait(lambda: browser.run("return document.getElementById('desk').dataset.ready") == "yes")
    yield found
    browser.require_quiet()


def downloaded(desk, name):
    file = desk.folder / name
    desk.wait(lambda: file.is_file() and file.stat().st_size)  # it is there before it is full
    return file


def test_a_handle_is_dragged_and_the_drag_undone(desk):
    before, bandwidth = desk.value("0-low_pass_hz"), desk.bandwidth
    ActionChains(desk.driver).drag_and_drop_by_offset(desk.handle("low-pass"), 90, 0).perform()
    desk.wait(lambda: desk.value("0-low_pass_hz") > 1.5 * before)
    desk.wait(lambda: desk.bandwidth != bandwidth)
    desk.by("undo").click()
    desk.wait(lambda: desk.value("0-low_pass_hz") == before and desk.bandwidth == bandwidth)
    desk.by("redo").click()
    desk.wait(lambda: desk.value("0-low_pass_hz") > 1.5 * before)


def test_the_keyboard_alone_shapes_a_loop(desk):
    before = desk.value("0-differentiator_hz")
    desk.handle("PID").send_keys(Keys.ARROW_RIGHT)
    desk.wait(lambda: desk.value("0-differentiator_hz") == pytest.approx(1.01 * before, rel=1e-4))
    gain, bandwidth = desk.value("0-gain"), desk.bandwidth
    desk.by("0-gain").send_keys(Keys.ARROW_UP)
    desk.wait(
        lambda: desk.value("0-gain") == pytest.approx(1.02 * gain, rel=1e-4) and desk.bandwidth > bandwidth
    )
    desk.type("0-gain", 4 * gain)
    desk.wait(lambda: desk.bandwidth > 1.5 * bandwidth)
    desk.type("0-gain", "much")
    assert "give a number" in desk.by("message").text
    desk.wait(lambda: desk.value("0-gain") == pytest.approx(4 * gain, rel=1e-4))
    ActionChains(desk.driver).key_down(Keys.CONTROL).send_keys("z").key_up(Keys.CONTROL).perform()
    desk.wait(lambda: desk.value("0-gain") == pytest.approx(1.02 * gain, rel=1e-4))


def test_a_dropped_response_is_shaped_and_leaves_as_c(desk):
    """A mass of 8 kg with a resonance, dropped as CSV; the C of what is shaped compiles."""
    hertz = np.geomspace(2, 800, 300)
    s = 2j * np.pi * hertz
    response = 1 / 8 + 0.1 * s**2 / (s**2 + 20 * s + (2 * np.pi * 300) ** 2)
    rows = "\n".join(f"{f},{h.real},{h.imag}" for f, h in zip(hertz, response, strict=True))
    desk.browser.run(DROP, "stage.csv", f"frequency (Hz),real (m/s^2/N),imaginary (m/s^2/N)\n{rows}\n")
    desk.wait(lambda: re.search(r"\b8\.00\d kg", desk.by("notes").text))
    assert Select(desk.by("machine")).first_selected_option.text == "stage.csv"
    desk.type("limit", 40)
    desk.by("controller").click()
    written = downloaded(desk, "controller.json")
    assert json.loads(written.read_text(encoding="utf-8"))["controller"]["low"] == -40
    assert main(["export", str(written), "--out", str(desk.folder / "code")]) == 0
    compiler = shutil.which("cc") or shutil.which("gcc")
    assert compiler, "a C compiler is not installed: apt-get install gcc"
    source = desk.folder / "code" / "controller.c"
    strict = "-std=c99 -Wall -Wextra -Wconversion -pedantic -Werror".split()
    command = [compiler, *strict, "-c", str(source), "-o", f"{source}.o"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    desk.browser.run(DROP, "notes.csv", "time,force\n0,1\n1,2\n")
    desk.wait(lambda: "stillwork desk FILE" in desk.by("message").text)


def test_a_design_waits_for_its_dropped_file(desk):
    """A mass with friction, 0.01 of a rigid body below its first line; its address alone, then with the file again."""
    hertz = np.geomspace(1, 400, 300)
    s = 2j * np.pi * hertz
    response = s / (s + 2 * np.pi * 100) / 4
    rows = "\n".join(f"{f},{h.real},{h.imag}" for f, h in zip(hertz, response, strict=True))
    table = f"frequency (Hz),real (m/s^2/N),imaginary (m/s^2/N)\n{rows}\n"
    desk.browser.run(DROP, "slide.csv", table)
    desk.wait(lambda: "slide.csv is on the desk, with a first design" in desk.by("message").text)
    below = Select(desk.by("notes").find_element(By.TAG_NAME, "select"))
    assert below.first_selected_option.text == "friction" and "slope -1" in desk.by("notes").text
    desk.type("0-gain", 3000)
    state = desk.driver.find_elements(By.CSS_SELECTOR, "#desk-figures dd")[1]
    desk.wait(lambda: state.text == "stable by the lines")
    below.select_by_visible_text("a rigid body")
    now = Select(desk.by("notes").find_element(By.TAG_NAME, "select"))
    assert now.first_selected_option.text == "a rigid body"
    assert state.text == "stable by the lines"  # whatever it is below, the lines hold the turns
    address = desk.driver.current_url
    desk.driver.get("about:blank")
    desk.browser.open(address)
    desk.wait(lambda: "design for slide.csv: drop that file" in desk.by("message").text)
    desk.browser.run(DROP, "slide.csv", table)
    desk.wait(lambda: "with the design of the address" in desk.by("message").text)
    assert desk.value("0-gain") == 3000


def test_an_observer_leaves_as_c_and_a_picture_as_svg(desk):
    desk.add("observer")
    desk.wait(lambda: desk.lights[0] != desk.lights[2])
    desk.by("controller").click()
    written = downloaded(desk, "controller.json")
    assert main(["export", str(written), "--out", str(desk.folder / "code")]) == 0
    desk.driver.find_element(By.CSS_SELECTOR, "[aria-label='Nyquist, with the 6 dB circle as SVG']").click()
    picture = downloaded(desk, "nyquist.svg").read_text(encoding="utf-8")
    assert picture.startswith("<svg") and "real part" in picture and "NaN" not in picture
    desk.driver.find_element(By.CSS_SELECTOR, "[aria-label='Open loop, phase as PNG']").click()
    assert downloaded(desk, "phase.png").read_bytes()[1:4] == b"PNG"


def test_the_guide_leads_to_six_decibels(desk):
    """Each number of "To 6 dB by hand" and of "Then the best" in docs/desk.md, on the machine that it names."""
    guide = (paths.root() / "docs" / "desk.md").read_text(encoding="utf-8")

    def sizes():
        desk.wait(lambda: "anywhere in the box" in desk.by("in-box").text)
        return [f"{float(each.split()[1]):.1f} dB" for each in desk.lights[:2]]

    def number(pattern):
        return float(re.search(pattern, guide)[1])

    assert desk.bandwidth == pytest.approx(number(r"controller at (\d+) Hz"), abs=0.5)
    assert sizes()[0] == "5.7 dB" and "at 5.7 dB." in guide
    typed = r"Type (\d+) for the gain, (\d+) Hz for the integrator, (\d+) Hz for the differentiator and\s+(\d+) Hz"
    for name, value in zip(
        ("gain", "integrator_hz", "differentiator_hz", "low_pass_hz"),
        re.search(typed, guide).groups(),
        strict=True,
    ):
        desk.type(f"0-{name}", value)
    desk.wait(lambda: desk.bandwidth == pytest.approx(number(r"bandwidth is (\d+) Hz"), abs=0.5))
    assert sizes() == list(re.search(r"triangles: ([\d.]+ dB), and ([\d.]+ dB)", guide).groups())
    desk.type("0-low_pass_hz", number(r"to the right, to (\d+) Hz"))
    desk.wait(lambda: "▲" not in "".join(desk.lights))
    assert sizes() == list(re.search(r"falls to ([\d.]+ dB), and to ([\d.]+ dB)", guide).groups())
    desk.by("best").click()
    desk.wait(lambda: "all constraints hold" in desk.by("message").text)
    assert desk.bandwidth == pytest.approx(number(r"about (\d+) Hz here"), rel=0.05)
    # Then C, by the command that the guide names: in the loop with the fitted machine, and with it 5 % lower and higher.
    desk.by("controller").click()
    code = desk.folder / "my_controller"
    assert main(["export", str(downloaded(desk, "controller.json")), "--out", str(code)]) == 0
    [machine, *_] = shipped_machines(paths.root())
    model, rate = machine["model"], desk.value("1-rate_hz")
    gains = np.multiply(model["input"], model["output"]) * machine["mass"]
    true = TrueMachine(
        mass=machine["mass"] / gains[0],
        hertz=tuple(np.array(model["omega"][1:]) / (2 * np.pi)),
        damping=tuple(model["damping"][1:]),
        position=tuple(gains[1:] / gains[0]),
        delay=machine["delay_s"] + 1e-6 * desk.value("2-delay_us"),
    )
    loop, size = CompiledLoop(code, rate), 2 * len(true.hertz) + 3
    peaks = [
        loop.peak_db(true.moved(np.full(size, sign), {"frequency": 0.05, "gain": 0.05}))
        for sign in (-1, 0, 1)
    ]
    assert 4 < max(peaks) < 6.05


def test_a_design_of_the_command_line_is_opened(desk, tmp_path):
    [machine, *_] = shipped_machines(paths.root())
    gains = {
        "gain": 50000.0,
        "integrator": 60.0,
        "differentiator": 200.0,
        "low_pass": 2000.0,
        "low_pass_damping": 0.7,
    }
    file = {"format": "stillwork controller 1", "gains": gains, "sample_time_s": 5e-5, "high": [50.0]}
    file["provenance"] = {"settings": {"application": None}, "delay_samples_of_the_loop": 1.0}
    (tmp_path / "controller.json").write_text(json.dumps(file), encoding="utf-8")
    desk.by("file").send_keys(str(tmp_path / "controller.json"))
    desk.wait(lambda: desk.value("0-gain") == 50000)
    assert desk.value("limit") == 50 and machine["name"] in desk.by("machine").text


@pytest.mark.parametrize("width", [1440, 390])
def test_everything_has_a_name_fits_and_can_be_read(desk, width):
    desk.add("observer")
    desk.browser.resize(width)
    assert not desk.browser.run(UNNAMED)
    assert not desk.browser.run(MISFITS)
    assert not desk.browser.run(CONTRAST)
    desk.browser.dark(True)
    assert not desk.browser.run(CONTRAST)
    desk.browser.dark(False)
