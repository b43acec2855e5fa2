import numpy as np
import pytest

from stillwork.fixedpoint import Noise, asin_trajectory, published_controllers
from stillwork.fixedpoint.metrics import noisy_run, sweep
from stillwork.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW
from stillwork.fixedpoint.statements import (
    HECTIC,
    KALMAN_WORST,
    LOW_PASS_BEST,
    SMOOTHEST,
    WINDOW_PRECISE,
    fraction,
    pooled,
    statements,
    table,
)
from stillwork.studies import Study


def study(position, roughness):
    values = {"position": np.array(position, dtype=float), "roughness": np.array(roughness, dtype=float)}
    return Study(0, values)


CASE = {
    WINDOW: study([1, 3], [2, 2]),
    LOW_PASS: study([2, 1], [1, 3]),
    KALMAN: study([3, 2], [3, 1]),
    LITERAL: study([0.5, 9], [5, 5]),
}


def test_statements_by_hand():
    found = {name: list(obeyed) for name, obeyed in statements(CASE, KALMAN).items()}
    assert found == {
        SMOOTHEST: [True, False],
        HECTIC: [True, False],
        WINDOW_PRECISE: [True, False],
        LOW_PASS_BEST: [False, True],
        KALMAN_WORST: [True, False],
    }
    # The other form of the Kalman filter changes the ranking, its own form takes no part.
    assert list(statements(CASE, LITERAL)[WINDOW_PRECISE]) == [False, False]
    assert list(statements(CASE, LITERAL)[KALMAN_WORST]) == [False, True]


def test_fraction_and_pool():
    share, (low, high) = fraction(np.array([True, True, False, True]))
    assert share == 0.75 and 0.3 < low < 0.75 < high < 1
    both = pooled({"a": CASE, "b": CASE}, KALMAN)
    assert list(both[SMOOTHEST]) == [True, False, True, False]


def test_table_prints_both_forms():
    lines = repr(table({"case": CASE}, KALMAN, LITERAL)).splitlines()
    assert len(lines) == 6
    assert lines[0].split("  ")[-1].strip() == "(14) corrected"
    assert (
        "1.00" not in lines[3] and "0.50" in lines[3]
    )  # window most precise: 0 of 2 printed, 1 of 2 corrected


def test_runs_repeat_and_encoders_differ(exact, approximate, short):
    controller = published_controllers(approximate)[LOW_PASS]
    encoder = Noise("encoder", 1e-3)
    first, again, other = (noisy_run(exact, controller, short, encoder, seed).measured for seed in (1, 1, 2))
    assert (first == again).all()
    assert np.abs(first - other).max() > 0
    # All measured values lie on one grid of 1 mm, wherever its lines are.
    assert np.ptp(np.mod(first - first[0] + 5e-4, 1e-3)) < 1e-9


def test_sweep_is_compare_at_each_frequency(exact, approximate):
    controllers = {LOW_PASS: published_controllers(approximate)[LOW_PASS]}
    slow, fast = sweep(exact, controllers, Noise(), [0.1, 0.3], runs=1, seed=0)
    run = noisy_run(exact, controllers[LOW_PASS], asin_trajectory(frequency_hz=0.3), Noise(), 0)
    error = run.position_error[2000:]
    assert fast[LOW_PASS]["position"][0] == pytest.approx(np.sqrt(np.mean(error**2)))
    assert slow[LOW_PASS]["position"][0] < fast[LOW_PASS]["position"][0]
