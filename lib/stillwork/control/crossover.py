"""Gain crossover: where the magnitude of a loop's response first falls through 1."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import optimize

from stillwork.base.checks import InputError, pluralise, require_one_each
from stillwork.base.validation import checked


@checked
def crossover(
    response: Callable[[np.ndarray], Complex128[np.ndarray, "..."]],
    omega: Float64[np.ndarray, " frequencies"],
    magnitude: Float64[np.ndarray, " frequencies"],
) -> float:
    """First frequency (rad/s) at which ``abs(response(omega))`` falls through 1, Definition 1.2.1.

    The magnitudes on a grid bracket the crossing, which is then refined on the response itself: between two points of a grid a
    magnitude is not a straight line, not in logarithms either.
    """
    if len(omega) != len(magnitude):
        raise InputError(
            f"omega has {pluralise(len(omega), 'frequency')}, magnitude {len(magnitude)}; give one of each"
        )
    falls = np.flatnonzero((magnitude[1:] < 1) & (magnitude[:-1] >= 1))
    if not len(falls):
        raise InputError(
            f"the loop gain does not fall through 0 dB from {omega[0] / (2 * np.pi):g} to "
            f"{omega[-1] / (2 * np.pi):g} Hz; widen the grid, or raise the gain"
        )
    ends = slice(falls[0], falls[0] + 2)
    known = dict(zip(np.log(omega[ends]), np.log(magnitude[ends]), strict=True))

    def excess(logarithm: float) -> float:
        """Logarithm of the gain over that of the frequency, which is nearly a straight line."""
        if logarithm in known:
            return known[logarithm]
        omega = np.exp([logarithm])
        gain = np.abs(require_one_each(response(omega), omega).item())
        if not gain > 0:
            raise InputError(
                f"response is {gain:g} at {omega[0] / (2 * np.pi):g} Hz, where magnitude falls through 1; "
                "give the magnitudes of the same response"
            )
        return float(np.log(gain))

    return float(np.exp(optimize.brentq(excess, *known)))
