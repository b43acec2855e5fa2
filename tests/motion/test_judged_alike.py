"""What decides entries of the ledger, on numbers whose verdict is known; the studies and the notebooks call the same."""

import numpy as np
import pandas as pd
import pytest

from contest.noise_map import ROBUST, noise_values
from notebooks.motion.decoupled_damping import stiffness_values
from notebooks.motion.mimo_decoupling import Moved, Seen, moving_values
from notebooks.motion.optimal_observer import NEAR, aspect_values
from notebooks.motion.over_actuated_rig import positions_apart
from notebooks.motion.robust_comparison import OutputErrors, output_values

ONES = np.ones(4)


def parts(found):
    """Values without intervals, by the last part of their ids."""
    return {
        name.rpartition(".")[2]: each[0] if isinstance(each, tuple) else each for name, each in found.items()
    }


def test_the_best_in_all_aspects_is_counted_and_near_is_a_factor():
    costs = np.array(
        [[NEAR, 1.0, NEAR * 1.01, 2.0, 1.0], [1.0, 1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0, np.inf]]
    )
    assert parts(aspect_values(costs)) == {"best-in-all": 1.0, "kalman-near-best": 0.6}
    assert parts(aspect_values(costs[::2]))["best-in-all"] == 0.0


@pytest.mark.parametrize(("ahead", "grown"), [(0.1, 0.2), (-0.1, -0.2)])
def test_leads_on_the_map_are_counted_by_seed(ahead, grown):
    rows = [
        {"size": 0.05, "noise": noise, "seed": seed, "Kalman": 1.0, **dict.fromkeys(ROBUST, 1.0 - lead)}
        for noise, lead in ((1.0, ahead), (1000.0, grown))
        for seed in range(5)
    ]
    robust_leads = float(ahead > 0)
    assert parts(noise_values(pd.DataFrame(rows))) == {
        "kalman-not-beaten": 1 - robust_leads,
        "penalised-gains-with-noise": robust_leads,
        "regularised-gains-with-noise": robust_leads,
    }


def test_places_are_counted_without_the_one_that_the_gain_was_made_for():
    shifts = np.array([-0.1, 0.0, 0.1])
    kept = np.array([[0.04, 0.05], [0.05, 0.05], [0.05, 0.051]])
    seen = Seen(np.zeros((3, 2)), np.array([True, False, True]), np.zeros(3))
    found = parts(moving_values(Moved(shifts, np.full((3, 2), 0.05), kept), seen, 0.05))
    assert found == {"moving-actuators": 1.0, "kept-gain": 0.5, "moving-sensors-peaks": 2 / 3}


def test_positions_differ_by_more_than_three_decibels_above_100_hz_alone():
    omega = 2 * np.pi * np.array([50.0, 200.0])
    sizes = (1.0, 1.0), (9.0, 1.0), (1.0, 1.5)  # two positions apart below 100 Hz only, one above by 3.5 dB
    plants = [np.ones((3, 3, 1)) * size for size in sizes]
    assert positions_apart(plants, omega).mean(axis=(1, 2)).tolist() == [0.0, 1.0, 1.0]


def test_bandwidths_with_stiffness_may_be_a_tenth_above():
    assert parts(stiffness_values(40.0, [0.0, 43.0, 44.5, 60.0])) == {"stiffness-bandwidth": 0.5}


def test_output_errors_are_judged_on_each_plant():
    off = OutputErrors(
        ONES, np.array([1.0, 1.0, 3.0, 3.0]), 2 * ONES, 6 * ONES, np.ones((4, 2)), np.full((4, 2), 5.0)
    )
    off.by_pseudo_inverse[0, 1] = 11.0
    exact = OutputErrors(ONES, ONES, 2 * ONES, 3 * ONES, np.ones((4, 2)), np.ones((4, 2)))
    assert parts(output_values(off, exact)) == {"output-error": 0.5, "pseudo-inverse": 0.75, "mc-errors": 2.0}
