import numpy as np
import pytest

from stillwork.base.checks import InputError
from stillwork.control.crossover import crossover


def found(response, grid):
    return crossover(response, grid, np.abs(response(grid)))


def second_order(w):
    """|L| = 1 / |w (w - 1j)| is 1 where w^4 + w^2 = 1: at the root of the golden ratio's inverse."""
    return -1 / (w * (w - 1j))


GOLDEN = np.sqrt((np.sqrt(5) - 1) / 2)


@pytest.mark.parametrize("points", [2, 3, 50])
def test_a_coarse_grid_gives_the_closed_form_too(points):
    assert found(second_order, np.geomspace(0.01, 100, points)) == pytest.approx(GOLDEN, rel=1e-12)


def test_the_first_of_several_is_taken_and_a_rise_is_none():
    # |L| = 2 |sin w| rises through 1 at 30 degrees and falls at 150, again at 330.
    grid = np.linspace(0.01, 6.2, 400)
    assert found(lambda w: 2 * np.sin(w), grid) == pytest.approx(np.radians(150), rel=1e-12)


def test_a_point_of_the_grid_may_be_the_crossing():
    grid = np.array([0.5, 1.0, 2.0])
    assert found(lambda w: 1 / w, grid) == 1.0
    # On the grid the gain is above 1 there, by rounding; the response says that it is not.
    assert crossover(lambda w: 1 / w, grid, np.array([2.0, 1 + 2e-16, 0.5])) == 1.0


@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_a_loop_that_does_not_cross_is_refused(gain):
    grid = 2 * np.pi * np.array([1.0, 10.0])
    with pytest.raises(InputError, match=r"\b1 \w+ 10 Hz"):
        found(lambda w: gain * np.ones_like(w, dtype=complex), grid)
