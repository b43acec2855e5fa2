"""Committed readings are of the committed axes, and what the code gives now is what stands there."""

import pytest

from committed.again import compute_again
from workbook import paths
from workbook.claims import load_entries
from workbook.readings.axes import Multiverse, load_axes
from workbook.readings.checking import moves, note, parts_a_day, today
from workbook.readings.command import standings_of
from workbook.readings.results import read_results
from workbook.readings.sampling import design

PARTS = 4  # tests that share the studies of a room, for workers to take


def studies(room: str) -> list[Multiverse]:
    """Those of a room whose readings were run; none of a room that has not got so far."""
    return load_axes(room)[1] if paths.data(room, "readings.csv").exists() else []


@pytest.mark.parametrize("room", paths.rooms())
def test_they_are_of_these_axes(room):
    found = read_results(studies(room))
    assert [each.multiverse.study for each in found] == [each.study for each in studies(room)], (
        "run `make readings`"
    )
    for each in found:
        assert each.design == design(each.multiverse)


@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("room", paths.rooms())
def test_those_whose_turn_it_is_today_come_out_again(room, part):
    found = []
    for before in read_results(studies(room)[part::PARTS]):
        now, tried = compute_again(before, today(), parts_a_day())
        moved = {at: lines for at in tried if (lines := moves(before, now, [at], load_entries(room)))}
        note(before.multiverse, moved)
        if moved:
            found += [line for at in sorted(moved) for line in moved[at]]
            found.append(f'run make readings ARGS="{room} --study {before.multiverse.study}"')
    if found:
        pytest.fail("\n".join(found), pytrace=False)


@pytest.mark.parametrize("room", paths.rooms())
def test_every_axis_that_moves_an_entry_says_so(room):
    moved = {name: standing.undeclared for name, standing in standings_of(room).items()}
    assert not {name: axes for name, axes in moved.items() if axes}
