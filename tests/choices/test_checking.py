"""Committed values are computed again, all within a month, and what moved is named."""

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from choices import toy_work
from choices.toy_work import SEEDS, A, B, axis, study
from committed import again
from committed.again import compute_again
from workbook.choices.axes import load_axes
from workbook.choices.checking import (
    DAYS,
    drawn,
    moved_before,
    moves,
    note,
    short_form_differs,
)
from workbook.choices.results import read_results, results_text
from workbook.choices.running import compute
from workbook.claims import load_entries

ROOT = Path(__file__).parents[2]
NOISY = A + B + SEEDS + study("noisy")
ALL = [(k, s) for k in range(6) for s in range(3)]


def keep(found, tmp_path, *changes):
    """Write ``choices.csv`` as older code left it, with these replacements, and read it."""
    text = results_text([replace(found, code="0" * 64)])
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    (tmp_path / "data/motion/choices.csv").write_text(text, encoding="utf-8")
    (before,) = read_results([found.multiverse])
    return before


@pytest.mark.parametrize("parts", [1, 4, 7, DAYS])
@pytest.mark.parametrize("count", [1, 6, DAYS, 100])
def test_all_runs_come_round_in_a_month(workbook, count, parts):
    _, (multiverse,) = workbook()
    runs = [(k, 0) for k in range(count)]
    one = drawn(multiverse, runs, 739_000)
    days = [drawn(multiverse, runs, day, parts) for day in range(739_000, 739_000 + -(-DAYS // parts))]
    assert set().union(*days) == set(runs)
    assert set(one) <= set(days[0])
    assert all(1 <= len(set(day)) == len(day) <= -(-count // DAYS) * parts for day in days)


def test_neighbours_in_the_order_of_the_runs_come_on_different_days(workbook):
    _, (multiverse,) = workbook()
    (day, *_) = (drawn(multiverse, [(k, 0) for k in range(300)], day) for day in range(3))
    steps = {b[0] - a[0] for a, b in pairwise(day)}
    assert len(steps) > 5  # not each thirtieth, which might be one option of an axis


def test_what_moved_is_tried_again_on_other_days(outcomes, monkeypatch, tmp_path):
    """Else a failed test would pass on the day after."""
    monkeypatch.setattr(again, "LIGHT", 0.0)
    before = keep(outcomes(NOISY), tmp_path)
    days = {at: day for day in range(18) for at in drawn(before.multiverse, ALL, day)}
    note(before.multiverse, [(3, 1), (99, 0)])  # of the latter there is no run any more
    _, tried = compute_again(before, days[3, 1] + 1)
    assert (3, 1) in tried and len(tried) == 2
    note(before.multiverse, [])
    assert moved_before(before.multiverse) == []
    _, tried = compute_again(before, days[3, 1] + 1)
    assert len(tried) == 1


@pytest.mark.parametrize("function", ["noisy", "spread", "raising"])
def test_what_was_computed_comes_out_again(outcomes, tmp_path, function):
    found = outcomes(A + B + (SEEDS if function == "noisy" else "") + study(function))
    now, tried = compute_again(keep(found, tmp_path), 0)
    assert moves(found, now, tried, load_entries("motion")) == []


def with_drift(text: str) -> str:
    """The toy's ledger, whose first entry may move so far."""
    first, *rest = toy_work.LEDGER.split("\n\n")
    return "\n\n".join([f"{first}\ndrift = {{ {text}, source = 'its seeds' }}", *rest])


@pytest.mark.parametrize(
    ("drift", "value", "moved"),
    [
        ("absolute = 0.5", 4.4, False),
        ("absolute = 0.5", 4.6, True),
        ("relative = 0.2", 4.9, False),
        ("relative = 0.2", 5.1, True),
        ("absolute = 0", 4.00001, True),
    ],
)
def test_a_value_moves_by_more_than_its_drift(outcomes, tmp_path, drift, value, moved):
    found = outcomes(A + B + study(), ledger=with_drift(drift))
    before = keep(found, tmp_path, ("3,1,1,1,4,1,", f"3,1,1,1,{value},1,"))
    lines = moves(before, found, ALL[::3], load_entries("motion"))
    named = [f"motion.table-1.sum at a 1, b 1, seed 1: {value} before, 4 now"]
    assert lines == (named if moved else [])


def test_ends_of_intervals_and_failures_are_values_too(outcomes, tmp_path):
    found = outcomes(A + B + study("spread"))
    entries = load_entries("motion")
    before = keep(found, tmp_path, ("0.3333333,11", "0.3333333,12"))
    assert ["(high)" in line for line in moves(before, found, ALL[::3], entries)] == [True]
    found = outcomes(A + B + study("raising"))
    reason = found.failures[4, 0]
    for other, moved in ((reason.replace("such", "such a"), False), (f"Other{reason}", True)):
        before = replace(found, failures=found.failures | {(4, 0): other})
        assert bool(moves(before, found, ALL[::3], entries)) == moved
    before = replace(found, failures={})
    assert "ValueError" in moves(before, found, [(4, 0)], entries)[0]


def run(root, *arguments):
    """A command on the toy at `root`."""
    command = [sys.executable, "-m", *arguments]
    return subprocess.run(command, env=toy_work.environment(root), cwd=ROOT, capture_output=True, text=True)


TEST = ("pytest", "tests/committed/test_choices.py", "-q", "-p", "no:nbval", "-p", "no:anyio")


@pytest.mark.slow
def test_the_tests_find_a_committed_value_that_was_edited(outcomes, tmp_path):
    """By hand, or by code that changed since."""
    found = outcomes()
    keep(found, tmp_path, ("3,1,1,1,4,1,", "3,1,1,1,4.1,1,"))
    done = run(tmp_path, *TEST)
    assert done.returncode == 1
    assert "motion.table-1.sum at a 1, b 1, seed 1: 4.1 before, 4 now" in done.stdout
    assert 'make choices ARGS="motion --study toy"' in done.stdout
    assert run(tmp_path, "stillwork", "choices", "motion", "--jobs", "1", "--study", "toy").returncode == 0
    assert (tmp_path / "data/motion/choices.csv").read_text() == results_text([found])


@pytest.mark.slow
def test_only_studies_that_moved_are_computed(workbook, tmp_path):
    first = axis("a", [0, 1, 2], 0, touches='["motion.order"]') + study("one", '["motion.order"]')
    second = study("other", '["motion.always"]').replace("studies.toy", "studies.more")
    workbook(first + second)
    file = tmp_path / "data/motion/choices.csv"
    assert run(tmp_path, "stillwork", "choices", "motion", "--jobs", "1").returncode == 0
    whole = file.read_text()
    codes = [line.split()[4] for line in whole.splitlines() if line.startswith("# study")]
    older = whole.replace(codes[0], "0" * 64).replace(codes[1], "1" * 64)
    (*_, last) = older.splitlines()
    file.write_text(older.replace(last, last.replace(",1", ",7").replace("0,7,", "0,1,")))
    assert file.read_text() != older
    (tmp_path / "build/choices/motion.jsonl").unlink()
    done = run(tmp_path, "stillwork", "choices", "motion", "--jobs", "1", "--changed")
    assert done.returncode == 0, done.stdout + done.stderr
    assert file.read_text() == whole.replace(codes[0], "0" * 64)  # the first is kept, the second computed
    assert "motion.always at seed 1: 7 before, 1 now" in done.stdout
    assert [each.study for each in load_axes("motion")[1]] == ["toy", "more"]


def test_a_short_form_is_compared_at_every_option(workbook):
    """It gives the whole form's values but with the last option of a, which the default does not show."""
    entries = '["motion.table-1.sum", "motion.always"]'
    _, (multiverse,) = workbook(A + B + study("shortened", entries, 'lean = "a toy"'))
    lines = short_form_differs(multiverse, load_entries("motion"), compute)
    assert lines == ["motion.table-1.sum at a 2: 2 whole, 12 short"]
    _, (alike,) = workbook(A + B + study(more='lean = "a toy"'))
    assert short_form_differs(alike, load_entries("motion"), compute) == []
