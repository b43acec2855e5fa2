import numpy as np

from experiments.fixedpoint.published import KALMAN, LITERAL, LOW_PASS, WINDOW
from experiments.fixedpoint.statements import (
    KALMAN_WORST,
    LOW_PASS_BEST,
    NOISIEST,
    SMOOTHEST,
    WINDOW_PRECISE,
    statements,
)
from notebooks.fixedpoint.every_claim import longest_replaced
from workbook.studies import Study


def study(position, roughness, velocity=(1, 1)):
    values = {"position": position, "velocity": velocity, "roughness": roughness}
    return Study(0, {name: np.array(numbers, dtype=float) for name, numbers in values.items()})


CASE = {
    WINDOW: study([1, 3], [2, 2], velocity=[5, 0]),
    LOW_PASS: study([2, 1], [1, 3]),
    KALMAN: study([3, 2], [3, 1]),
    LITERAL: study([0.5, 9], [5, 5]),
}


def test_statements_by_hand():
    found = {name: list(obeyed) for name, obeyed in statements(CASE, KALMAN).items()}
    assert found == {
        SMOOTHEST: [True, False],
        NOISIEST: [True, False],
        WINDOW_PRECISE: [True, False],
        LOW_PASS_BEST: [False, True],
        KALMAN_WORST: [True, False],
    }
    # The other form of the Kalman filter changes the ranking, its own form takes no part.
    assert list(statements(CASE, LITERAL)[WINDOW_PRECISE]) == [False, False]
    assert list(statements(CASE, LITERAL)[KALMAN_WORST]) == [False, True]


def test_the_longest_gap_that_a_simple_filter_bridges_as_well_by_hand():
    def gap(*positions):
        names = (WINDOW, LOW_PASS, KALMAN)
        return {name: study(each, (1, 1)) for name, each in zip(names, positions, strict=True)}

    worse, level = gap([3.0, 3.0], [2.0, 2.0], [1.0, 3.0]), gap([3.0, 1.0], [2.0, 3.0], [2.0, 1.0])
    lost = gap([np.inf, 1.0], [np.inf, 1.0], [np.inf, 5.0])
    assert longest_replaced([0.01, 0.02, 0.05], [worse, level, lost], KALMAN) == 0.02
    assert longest_replaced([0.01, 0.05], [worse, lost], KALMAN) == 0.0


def test_a_run_that_diverged_is_neither_smooth_nor_precise():
    lost = {name: study([np.inf, 1], [np.inf, 1], velocity=[np.inf, 1]) for name in CASE}
    found = statements(lost, KALMAN)
    assert not any(obeyed[0] for name, obeyed in found.items() if name != KALMAN_WORST)
