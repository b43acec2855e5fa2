"""Frequency grids that resolve lightly damped modes, and peaks between their points."""

from collections.abc import Callable
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Natural, Positive, at_least
from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
    require_memory,
    require_number,
    require_one_each,
)
from stillwork.base.validation import checked


@checked
def resonance_grid(
    poles: ArrayLike,
    low_hz: Positive,
    high_hz: float,
    points: Annotated[int, at_least(2)] = 600,
    around: Natural = 40,
) -> Float64[np.ndarray, " frequencies"]:
    """Frequencies (rad/s): logarithmic, and `around` more on either side of every pole, dense at its width.

    A logarithmic grid alone (`around` = 0) steps over the peaks of lightly damped modes.

    Parameters
    ----------
    poles : array_like
        rad/s, complex.
    low_hz, high_hz : float
        Range, Hz.
    points, around : int
        Number of points in the whole range, and on either side of a pole.

    Returns
    -------
    ndarray, shape (frequencies,)

    Raises
    ------
    InputError
        When the range is empty or a count is too small.

    Examples
    --------
    >>> omega = lti.resonance_grid([-0.5 + 500j, -0.5 - 500j], low_hz=1.0, high_hz=1000.0)
    >>> bool(np.abs(omega - 500).min() < 0.01)  # rad/s
    True
    """
    require_number("high_hz", high_hz, above=low_hz)
    poles = np.ravel(require_array("poles", poles, dtype=complex))
    poles = poles[np.argsort(np.abs(poles))]
    centre = np.abs(poles)
    # Poles of one distance count once, whatever their last bits, with the least width.
    first = np.flatnonzero(np.diff(centre, prepend=0.0) > 1e-9 * centre)
    width = np.minimum.reduceat(np.maximum(np.abs(poles.real), 1e-7 * centre), first)
    centre = centre[first]
    reach = np.arcsinh(0.5 * centre / width)
    require_memory("points", points)
    require_memory("around", len(centre), 2 * around + 1)
    steps = np.linspace(-1, 1, 2 * around + 1) if around else np.zeros(0)
    offsets = width[:, None] * np.sinh(reach[:, None] * steps)
    low, high = 2 * np.pi * low_hz, 2 * np.pi * high_hz
    every = np.concatenate([np.geomspace(low, high, points), (centre[:, None] + offsets).ravel()])
    return np.unique(every[(every >= low) & (every <= high)])


class Peak(NamedTuple):
    """The largest magnitude of a frequency response."""

    magnitude: float
    omega: float  # rad/s


@checked
def refine_peak(
    response: Callable[[np.ndarray], Complex128[np.ndarray, "..."]],
    omega: Float64[np.ndarray, " frequencies"],
    magnitude: Float64[np.ndarray, " frequencies"],
    near: float = 0.7,
) -> Peak:
    """Peak of ``abs(response(omega))`` between grid points: zoom into every local maximum above `near` of the largest."""
    if not 0 < len(omega) == len(magnitude):
        raise InputError(
            f"omega has {pluralise(len(omega), 'frequency')}, magnitude {len(magnitude)}; give one of each"
        )
    last = len(omega) - 1
    inner = (magnitude[1:-1] >= magnitude[:-2]) & (magnitude[1:-1] >= magnitude[2:])
    places = np.concatenate([[0], 1 + np.flatnonzero(inner), [last]])
    places = places[magnitude[places] >= near * magnitude.max()]
    low, high = omega[np.maximum(places - 1, 0)], omega[np.minimum(places + 1, last)]
    rows = np.arange(len(places))
    for _ in range(5):  # each round shrinks the bracket by 4: a thousand times in all
        grid = np.linspace(low, high, 9, axis=1)
        values = np.abs(require_one_each(response(grid.ravel()), grid)).reshape(grid.shape)
        best = values.argmax(axis=1)
        low, high = grid[rows, np.maximum(best - 1, 0)], grid[rows, np.minimum(best + 1, 8)]
    winner = values.max(axis=1).argmax()
    return Peak(float(values[winner].max()), float(grid[winner, best[winner]]))
