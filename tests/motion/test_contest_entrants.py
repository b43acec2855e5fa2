"""Files with an observer of the reader's: what they get, and the reason where one is out."""

import re

import numpy as np
import pandas as pd
import pytest

from contest import runner, tuning
from contest.nominal import TuningParameter
from contest.ranking import KEYS, standings
from contest.runner import Disqualified, FileObserver, knobs_of, running
from contest.scores import ENTRANTS, Scan, scores_of
from contest.table import PUBLICS, hold_contest, on_machine, written_table
from stillwork.base.checks import InputError
from workbook import paths

GUIDE = (paths.root() / "docs" / "contest.md").read_text(encoding="utf-8")
# The guide's Kalman filter shares no code with ours: its Riccati equation is run until it stands still.
[KALMAN] = re.findall(r"^```python\n(.*?)^```$", GUIDE, re.DOTALL | re.MULTILINE)
ZERO = """
import os, sys, time
class Observer:
    def start(self, model, noise, sample_time, *settings):
        self.states, self.k = len(model.a), 0
    def step(self, input, measurement):
        self.k += 1
        if self.k == 5:
            BODY
        return [0.0] * self.states
"""
SCAN = Scan("estimate", "drive", "lost 20 %", "a test", 0)


@pytest.fixture
def written(tmp_path):
    def write(text, name="mine.py"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return str(tmp_path / name)

    return write


@pytest.mark.slow
def test_a_foreign_kalman_filter_gets_what_ours_gets(written):
    file = written(KALMAN)
    for scan in (
        Scan("estimate", "gantry", "lost 20 %", "a test", 0),
        Scan("loop", "stage", "all 5 %", "a test", 0),
    ):
        ours, theirs = (
            scores_of(name, source, scan, ()) for name, source in (("Kalman", None), ("mine", file))
        )
        assert list(theirs) == list(ours)
        assert list(theirs.values()) == pytest.approx(list(ours.values()), rel=1e-5)


BROKEN = {
    "raises": ("1 / 0", r"raises ZeroDivisionError: division by zero \(line 9\)"),
    "ends its process": ("os._exit(1)", "its process ended"),
    "hangs": ("time.sleep(60)", "takes more than 3 s a scan"),
    "returns nothing": ("return", "must return 4 finite numbers"),
    "returns no number": ("return [float('nan')] * 4", "must return 4 finite numbers"),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_observer_is_out_by_reason(what, written, monkeypatch):
    body, reason = BROKEN[what]
    file = written(ZERO.replace("BODY", body))
    with pytest.raises(Disqualified, match=reason), running(file) as call:
        assert call(knobs_of, file) == ()
        call(scores_of, "zero", None, SCAN, ())  # compiles what a scan needs
        if what == "hangs":
            monkeypatch.setattr(runner, "SECONDS", 3)
        call(scores_of, "mine", file, SCAN, ())


def test_the_error_on_a_machine_is_the_rankings():
    """Of one of our entrants, as if it were a file: the line of progress has the numbers of the answer."""
    table = written_table()
    table = table[(table["plant"] == "stage") & (table["public"] == PUBLICS[0]) & (table["seed"] == 0)]
    ranked = standings(table.reset_index(drop=True)).set_index("observer")["error"]
    for name in ("unknown input", "Kalman"):
        said = on_machine(table.set_index(KEYS)[name], table, "stage")
        assert said == f"stage: error {ranked[name]}, Kalman {ranked['Kalman']}"


@pytest.mark.slow
def test_a_file_runs_machine_by_machine_and_one_that_is_out_stops_nobody(written, tmp_path, capsys):
    mine = written("KNOBS = [('size', 0.5, 8.0, 3.0)]\n" + ZERO.replace("BODY", "pass"))
    hopeless = written(ZERO.replace("BODY", "1 / 0"), "hopeless.py")
    out = tmp_path / "out.csv"
    assert hold_contest([hopeless, mine], machine=["drive", "stage"], out=str(out)) == 1
    table, (shown, progress) = pd.read_csv(out, dtype={"public": str}), capsys.readouterr()
    assert "unscented Kalman   " not in shown
    assert "mine: place 15 of 15 by mean rank" in shown and shown.count("place") == 1
    assert re.findall(r"^(\w+): error 1.00, Kalman 0", progress, re.MULTILINE) == ["drive", "stage"]
    flexible = table[table["score"] == "flexible"]
    assert len(flexible) == 2 * 12 and (flexible["mine"] == 1).all() and not flexible[KEYS].duplicated().any()


def test_the_tuner_takes_the_least_error_for_a_file_as_for_ours(written, monkeypatch):
    monkeypatch.setattr(tuning, "TUNED_ON", ("all 5 %",))
    monkeypatch.setattr(tuning, "TRIES", 3)
    knobs = ENTRANTS["unknown input"].knobs
    [scan] = tuning.development_scans("drive", 1)
    errors = [
        scores_of("unknown input", None, scan, tuple(each))["flexible"] for each in tuning.positions(knobs)
    ]
    best = tuning.positions(knobs)[np.argmin(errors)]
    assert tuning.tune("unknown input", None, knobs, "drive", 1) == pytest.approx(list(best), rel=1e-5)
    text = KALMAN.replace("sample_time):", "sample_time, factor):").replace(
        "noise.process", "(factor**2 * noise.process)"
    )
    runner.module_of.cache_clear()
    assert tuning.tune("mine", written(text), knobs, "drive", 1) == pytest.approx(list(best), rel=1e-5)
    assert tuning.positions(()).shape == (1, 0)
    with pytest.raises(InputError, match=r"^name\b.*'particle'"):
        tuning.main(["particle"])


def test_knobs_are_given_in_order(written):
    text = "KNOBS = [('a', 1, 3, 2), ('b', 1.0, 1.0, 1.0)]\nclass Observer:\n    def start(self, *given): self.given = given"
    runner.module_of.cache_clear()
    file = written(text)
    assert knobs_of(file) == (TuningParameter("a", 1, 3, 2), TuningParameter("b", 1.0, 1.0, 1.0))
    observer = FileObserver(file, (2.5, 1.0))
    observer.start(*SCAN.given())
    assert observer.observer.given[3:] == (2.5, 1.0)
