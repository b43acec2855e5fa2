"""For which limits of the peaks a printed bandwidth is f_bw: against the search itself, and against brute force."""

import numpy as np
import pytest

from experiments.motion.designs import PRINTED_HZ, stage_bandwidth
from notebooks.motion.bandwidth_table import CHOICES, limit_windows, most_at_once

COARSE = CHOICES["grid of 2000 points"]


@pytest.mark.parametrize(
    ("name", "way", "grid"),
    [
        ("PID with notches", "peaks refined", {}),
        ("MC", "2000 frequencies", COARSE),
        ("AD", "peaks refined", {}),
    ],
)
def test_a_limit_within_the_window_gives_the_printed_hertz_and_one_beside_it_does_not(name, way, grid):
    windows = limit_windows([(name, PRINTED_HZ[name])])
    for written, write in (("rounded", np.rint), ("cut off", np.floor)):
        ((low, high),) = windows[written][way]
        limits = np.array(
            [low * (1 - 1e-3), low * (1 + 1e-4), (low + high) / 2, high * (1 - 1e-4), high * (1 + 1e-3)]
        )
        hertz = [write(stage_bandwidth(name, limit=float(limit), **grid).design_hz) for limit in limits]
        assert [hz == PRINTED_HZ[name] for hz in hertz] == [False, True, True, True, False]


def test_the_most_windows_that_meet_are_those_of_brute_force():
    rng = np.random.default_rng(3)
    for _ in range(50):
        windows = np.sort(rng.uniform(0, 1, (rng.integers(1, 9), 2)))
        count, low, high = most_at_once(windows)
        inside = [np.sum((windows[:, 0] <= x) & (x < windows[:, 1])) for x in np.linspace(0, 1, 5001)]
        assert count >= max(inside)
        for x in (low, (low + high) / 2):
            assert np.sum((windows[:, 0] <= x) & (x < windows[:, 1])) == count
