"""For which limits of the peaks a bandwidth is written as printed: against the search itself, and against brute force."""

import numpy as np
import pytest

from experiments.motion.designs import PRINTED_HZ, stage_bandwidth
from notebooks.motion.bandwidth_table import (
    AS_PRINTED,
    MEANT,
    SEARCHES,
    best_as,
    count_combinations,
    designs_of,
    limit_windows,
    most_at_once,
    names_of,
)
from notebooks.motion.bandwidth_table import (
    COARSE as COARSE_GRID,
)

COARSE = {**COARSE_GRID, "refine": False}
WRITE = {"rounded": np.rint, "cut off": np.floor}


@pytest.mark.parametrize(
    ("name", "search", "grid"),
    [
        ("PID with notches", "fine grid", {}),
        ("MC", "2000 frequencies", COARSE),
        ("AD", "fine grid", {}),
    ],
)
def test_a_limit_within_the_window_gives_the_printed_hertz_and_one_beside_it_does_not(name, search, grid):
    windows = limit_windows([(name, PRINTED_HZ[name])], 1e4)
    for written, write in WRITE.items():
        low, high = windows[search, written, 0, AS_PRINTED][0]
        limits = [low * (1 - 1e-3), low * (1 + 3e-4), (low + high) / 2, high * (1 - 3e-4), high * (1 + 1e-3)]
        hertz = [write(stage_bandwidth(name, limit=float(limit), **grid).design_hz) for limit in limits]
        assert [hz == PRINTED_HZ[name] for hz in hertz] == [False, True, True, True, False]


def test_a_crossing_is_written_as_printed_between_the_ends_of_its_window_alone():
    windows = limit_windows([("AD, no band-pass", 65.0)], 1e4)
    for mass in (1, 7):
        low, high = windows["fine grid", "rounded", 0, AS_PRINTED][MEANT.index(("P_eq C_fb", mass))]
        limits = [low * (1 - 4e-4), low * (1 + 4e-4), high * (1 - 4e-4), high * (1 + 4e-4)]
        found = [
            stage_bandwidth("AD, no band-pass", limit=float(each)).crossing_hz[mass - 1] for each in limits
        ]
        assert [round(hz) == 65 for hz in found] == [False, True, True, False]


@pytest.mark.slow
def test_searches_at_the_best_limit_give_the_seven_numbers_that_are_counted():
    """The count rests on peaks at given f_bw; here every design is searched for its largest f_bw under the limit."""
    printed = sorted([*PRINTED_HZ.items(), ("MC, two constraints", 73.0)], key=lambda each: each[1])
    combinations = count_combinations(printed, limit_windows(printed, 1e4), 1e4)
    assert len(combinations) == len(SEARCHES) * 2 * 2**3 * len(MEANT)
    best = best_as(combinations, "f_bw")
    assert best["count"] == 7
    assert (best["written"], best["search"]) == ("cut off", "2000 frequencies")
    limit = float(best["from"] + best["to"]) / 2
    given = []
    for name, hz in printed:
        design = designs_of(name, 1e4)[best["variants"].get(hz, AS_PRINTED)]
        found = stage_bandwidth(design, limit=limit, **COARSE).design_hz
        given += [hz] * bool(np.floor(found) == hz)
    assert given == best["gives"] == [37.0, 43.0, 46.0, 59.0, 72.0, 73.0, 83.0]
    by_design = combinations[combinations["means"] == "f_bw"]
    counts = [
        by_design["count"][
            (by_design["written"] == written) & by_design["variants"].map(free.issuperset)
        ].max()
        for written in WRITE
        for free in (set(), {72.0, 73.0}, {83.0}, {72.0, 73.0, 83.0})
    ]
    assert counts == [4, 5, 5, 6, 5, 6, 6, 7]
    assert names_of(combinations[combinations["count"] == 7]).count("mass") == 2


def test_the_most_windows_that_meet_are_those_of_brute_force():
    rng = np.random.default_rng(3)
    for _ in range(50):
        windows = np.sort(rng.uniform(0, 1, (rng.integers(1, 9), 2)))
        count, low, high = most_at_once(windows)
        inside = [np.sum((windows[:, 0] <= x) & (x < windows[:, 1])) for x in np.linspace(0, 1, 5001)]
        assert count >= max(inside)
        for x in (low, (low + high) / 2):
            assert np.sum((windows[:, 0] <= x) & (x < windows[:, 1])) == count


def test_windows_that_are_empty_meet_none():
    assert most_at_once([[2.0, 2.0], [2.1, 2.1]])[0] == 0
    assert most_at_once([[2.0, 2.0], [1.9, 2.1]]) == (1, 1.9, 2.1)
