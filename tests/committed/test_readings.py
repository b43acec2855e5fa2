"""Committed readings belong to the committed code and axes, and one of each study gives the same again."""

import datetime

import pytest

from stillwork.base import paths
from stillwork.workbook.claims import load_entries
from stillwork.workbook.readings.axes import Multiverse, load_axes
from stillwork.workbook.readings.closure import study_digest
from stillwork.workbook.readings.command import standings_of
from stillwork.workbook.readings.results import collect, read_results
from stillwork.workbook.readings.running import calls_of, compute
from stillwork.workbook.readings.sampling import design

PARTS = 4  # tests that share the studies of a room, for workers to take


def studies(room: str) -> list[Multiverse]:
    """Those of a room whose readings were run; none of a room that has not got so far."""
    return load_axes(room)[1] if paths.data(room, "readings.csv").exists() else []


@pytest.mark.parametrize("room", paths.rooms())
def test_they_are_of_these_axes_and_this_code(room):
    found = read_results(studies(room))
    assert [each.multiverse.study for each in found] == [each.study for each in studies(room)], (
        "run `make readings`"
    )
    for each in found:
        assert each.code == study_digest(each.multiverse.function, room), "run `make readings`"
        assert each.design == design(each.multiverse)


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("room", paths.rooms())
def test_the_first_and_on_other_days_the_last_gives_the_same_again(room, part):
    """What the first test cannot see: another library, another processor, a table that was edited."""
    entries, day = load_entries(room), datetime.date.today().toordinal()
    for multiverse in studies(room)[part::PARTS]:
        (before,) = read_results([multiverse])
        runs = list(calls_of(multiverse).items())
        at, run = runs[-(day % 2)]
        now = collect(multiverse, before.design, {at: compute(run)})
        assert now.failures.get(at) == before.failures.get(at)
        for entry in multiverse.entries:
            value = before.values[entry][at]
            room_for = 1e-12 + entries[entry].drift.width(value)
            assert now.values[entry][at] == pytest.approx(value, rel=0, abs=room_for, nan_ok=True), (
                run,
                entry,
            )


@pytest.mark.parametrize("room", paths.rooms())
def test_every_axis_that_moves_an_entry_says_so(room):
    moved = {name: standing.undeclared for name, standing in standings_of(room).items()}
    assert not {name: axes for name, axes in moved.items() if axes}
