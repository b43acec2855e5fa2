"""One file, one answer: the command `design`, the command `report` and the notebook print the same."""

import json
from unittest.mock import MagicMock

import numpy as np
import pytest

import workbook
from stillwork.identification.machine import build_machine
from stillwork.identification.machine_files import load_machine
from stillwork.machine.design import design_file
from stillwork.machine.machine_designs import default_rate, stated_uncertainty
from stillwork.machine.report import report_file
from workbook import paths

RATE, DELAY, UNCERTAINTY = 8e3, 0.5, "frequency=0.03,gain=0.1"
USES = ("PID", "PID with notches", "MC", "AD", "MC and AD")


def write_two_modes(file):
    """3.3 kg with modes of both signs, 40 us late, as a mobility in mm/s/N with noise of 0.2 %."""
    hertz = np.arange(4.0, 800.0, 0.5)
    s = 2j * np.pi * hertz
    position = 1 / s**2
    for resonance, ratio, share in ((151, 0.006, -0.4), (340, 0.007, 0.5)):
        w = 2 * np.pi * resonance
        position = position + share / (s**2 + 2 * ratio * w * s + w**2)
    noise = np.random.default_rng(3).standard_normal((2, len(hertz)))
    mobility = 1e3 * s * position / 3.3 * np.exp(-4e-5 * s) * (1 + 1.4e-3 * (noise[0] + 1j * noise[1]))
    rows = [f"{f:.6g},{x.real:.9g},{x.imag:.9g}" for f, x in zip(hertz, mobility, strict=True)]
    file.write_text("\n".join(["frequency (Hz),real (mm/s/N),imaginary (mm/s/N)", *rows]))


def by_notebook(file, monkeypatch, capsys, **settings):
    """What the notebook prints of its search: its own cells, without what it saves."""
    monkeypatch.setattr(workbook, "Page", MagicMock())
    notebook = json.loads((paths.root() / "notebooks/motion/29-your-machine.ipynb").read_text("utf-8"))
    names: dict = {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] != "code" or "page.check" in source or "explore(" in source:
            continue
        exec(source, names)
        if "machine_file:" in source:
            names |= {"machine_file": str(file), "fit_hz": (0.0, 0.0), "loop_hz": (0.0, 0.0)} | settings
    return capsys.readouterr().out.splitlines()


def answer(lines):
    """Of each use its row, the ranking, and for what it was searched."""
    kept = [
        line
        for line in lines
        if line.partition(":")[0] in USES or line.startswith(("highest bandwidth first", "searched at"))
    ]
    assert len(kept) == len(USES) + 2
    return kept


@pytest.mark.slow
def test_design_report_and_notebook_print_the_same(tmp_path, monkeypatch, capsys):
    """In mm/s/N: the whole search as each of the three makes it, which no part of it shows."""
    write_two_modes(tmp_path / "machine.csv")
    asked = {"rate": RATE, "delay": DELAY, "uncertainty": UNCERTAINTY}
    file = str(tmp_path / "machine.csv")
    designed = answer(design_file(file, str(tmp_path / "out"), verbose=True, **asked))
    reported = report_file(file, str(tmp_path / "page.html"), verbose=True, **asked)
    assert sorted(answer(reported)) == sorted(designed)
    assert [each.partition(" ")[0] for each in reported[:3]] == ["frequency", "highest", "written:"]
    capsys.readouterr()
    named = {"controller_hz": RATE, "delay_samples": DELAY, "uncertainty": UNCERTAINTY}
    assert answer(by_notebook(file, monkeypatch, capsys, **named)) == designed
    assert "8000 Hz" in designed[0] and "frequency ± 0.03 and gain ± 0.1" in designed[0]
    page = (tmp_path / "page.html").read_text()
    assert designed[-1] in page and designed[0] in page
    assert "searched at" in (tmp_path / "out" / "report.html").read_text()


def test_the_default_rate_is_a_round_number_far_above_the_modes():
    machine = build_machine(
        load_machine(paths.data("motion", "your_machine/matrices.csv")), modes_hz=[], fit_hz=(0.0, 0.0), mirrored_sensor=False
    )  # fmt: skip
    rate = default_rate(machine)
    assert rate >= 20 * machine.resonances_hz[0] and rate >= 4 * machine.resonances_hz[-1]
    assert rate / 10 ** np.floor(np.log10(rate)) in (1.0, 2.0, 5.0)
    assert stated_uncertainty("") == {"frequency": 0.05, "gain": 0.05}
