"""Gain crossover: where the magnitude of a loop's response first falls through 1."""

from collections.abc import Callable
from functools import cache

import numpy as np
from jaxtyping import Float64
from scipy import optimize

from stillwork.base.checks import InputError


def crossover(
    response: Callable[[np.ndarray], np.ndarray],
    omega: Float64[np.ndarray, " frequencies"],
    magnitude: Float64[np.ndarray, " frequencies"],
) -> float:
    """First frequency (rad/s) at which ``abs(response(omega))`` falls through 1, Definition 1.2.1.

    A grid and the magnitudes on it bracket the crossing, the response itself finds it: between two points of a grid a
    magnitude is no straight line, in logarithms either.
    """
    falls = np.flatnonzero((magnitude[1:] < 1) & (magnitude[:-1] >= 1))
    if not len(falls):
        raise InputError(
            f"the loop gain does not fall through 0 dB from {omega[0] / (2 * np.pi):g} to "
            f"{omega[-1] / (2 * np.pi):g} Hz; widen the grid, or raise the gain"
        )
    low, high = omega[falls[0]], omega[falls[0] + 1]

    @cache  # both ends are asked for twice
    def excess(frequency: float) -> float:
        return float(np.log(np.abs(response(np.array([frequency]))[0])))

    if not excess(low) > 0 > excess(high):  # a point of the grid is the crossing, but for rounding
        return float(min((low, high), key=lambda end: abs(excess(end))))
    return float(optimize.brentq(excess, low, high))
