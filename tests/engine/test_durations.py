"""In which order notebooks are built, and when a new duration is news."""

import json

import pytest

from workbook import paths
from workbook.build import longest_first
from workbook.notebooks import Notebook
from workbook.tasks import DURATIONS, Task, updated_durations

NAMES = ["isolation/01", "isolation/02", "motion/01", "motion/02"]


def order(*names: str) -> list[str]:
    stale = [(Task(Notebook(name, "", {}, {}), {}, {}), ["never built"]) for name in names]
    return [task.notebook.name for task, _ in longest_first(stale)]


@pytest.fixture
def noted(tmp_path, monkeypatch):
    """Write the file of durations of a workbook of one's own."""
    monkeypatch.setenv(paths.ROOT_VARIABLE, str(tmp_path))
    (tmp_path / "data").mkdir()
    (tmp_path / DURATIONS).parent.mkdir()
    return (tmp_path / DURATIONS).write_text


def test_the_longest_begins_and_before_it_what_nobody_has_timed(noted):
    noted(json.dumps({"isolation/01": 3, "isolation/02": 40.5, "motion/02": 12, "motion/gone": 99}))
    assert order(*NAMES) == ["motion/01", "isolation/02", "motion/02", "isolation/01"]


@pytest.mark.parametrize(
    "text", ["", "<<<<<<< ours\n{}", "[]", "null", '{"isolation/01": null}', "[" * 100_000]
)
def test_a_file_that_nobody_can_read_stops_no_build(noted, text):
    noted(text)
    assert order(*NAMES) == NAMES


def test_only_what_moves_much_is_written_anew():
    before = {"isolation/01": 20.0, "isolation/02": 1.0, "motion/01": 60.0, "motion/gone": 9.0}
    found = {"isolation/01": 27.0, "isolation/02": 3.0, "motion/01": 60.0, "motion/02": 4.567}
    kept = {name: seconds for name, seconds in before.items() if name != "motion/gone"}
    assert updated_durations(before, found | {"isolation/02": 1.0}) == kept | {"motion/02": 4.6}
    assert updated_durations(before, found | {"isolation/02": None, "motion/02": None}) == kept
    slower = {"isolation/01": 20.0, "isolation/02": 1.0, "motion/01": 101.2, "motion/02": None}
    assert updated_durations(before, slower) == kept | {"motion/01": 100.0}
