"""A search of settings: a Sobol sequence, and simplexes from its best points."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64


def sobol_points(
    low: Float64[np.ndarray, " knobs"], high: Float64[np.ndarray, " knobs"], budget: int, seed: int
) -> Float64[np.ndarray, "points knobs"]:
    """The largest power of two of points within half the budget, evenly between the bounds."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(len(low), rng=np.random.default_rng(seed))
    return np.clip(low + sequence.random_base2(int(np.log2(budget / 2))) * (high - low), low, high)


def run_simplex(
    cost: Callable,
    start: Float64[np.ndarray, " knobs"],
    low: Float64[np.ndarray, " knobs"],
    high: Float64[np.ndarray, " knobs"],
    size: float,
    evaluations: int,
) -> None:
    """Nelder and Mead's simplex from a point, its edges a `size` of the ranges, turned inwards at a bound."""
    from scipy.optimize import minimize

    steps = size * (high - low) * np.where(start + size * (high - low) > high, -1.0, 1.0)
    simplex = np.vstack([start, start + np.diag(steps)])
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": 1e-12, "fatol": 0.0}
    minimize(cost, start, method="Nelder-Mead", options=options)
