"""Position-dependent Kalman filters: gains online by the Riccati recursion, or interpolated from a grid (5.6)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import InputError, require_array
from stillwork.estimation.riccati import discrete_gain
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel


@dataclass(frozen=True)
class GainTable:
    """Stationary filter gains on a grid of positions."""

    grid: Float64[np.ndarray, " places"]  # m, ascending
    gains: Float64[np.ndarray, "places states outputs"]

    def at(self, places: ArrayLike) -> Float64[np.ndarray, "samples states outputs"]:
        """Gains at places (m) on the grid by linear interpolation."""
        places = require_array("places", places, ndim=1)
        if not len(places):
            raise InputError("places is empty; give the position at every sample in m")
        slack = 1e-9 * (self.grid[-1] - self.grid[0])
        if places.min() < self.grid[0] - slack or places.max() > self.grid[-1] + slack:
            raise InputError(
                f"places run from {places.min():g} to {places.max():g} m, outside the table from "
                f"{self.grid[0]:g} to {self.grid[-1]:g} m; extend the grid"
            )
        right = np.clip(np.searchsorted(self.grid, places), 1, len(self.grid) - 1)
        part = (places - self.grid[right - 1]) / (self.grid[right] - self.grid[right - 1])
        part = part[:, None, None]
        return (1 - part) * self.gains[right - 1] + part * self.gains[right]


def gain_table(
    a: ArrayLike, g: ArrayLike, rows: ArrayLike, grid: ArrayLike, process: ArrayLike, sensor: ArrayLike
) -> GainTable:
    """Stationary Kalman filter gains for the rows of C at every point of an ascending grid (m)."""
    rows = require_array("rows", rows, ndim=3)
    grid = require_array("grid", grid, shape=(len(rows),))
    if len(grid) < 2 or np.any(np.diff(grid) <= 0):
        raise InputError("grid must hold at least two places in ascending order")
    gains = []
    for place, c in zip(grid, rows, strict=True):
        try:
            gains.append(discrete_gain(a, g, c, process, sensor).filter_gain)
        except InputError as error:
            raise InputError(f"at {place:g} m: {error}") from None
    return GainTable(grid, np.array(gains))


# Part of the best view of a mode below which a place counts as blind to it.
BLIND = 1e-6


def require_observable_along(model: TimeVaryingModel, places: ArrayLike) -> None:
    """Refuse a trajectory (m) along which a mode that is not stable by itself is lost from view: the first place is named.

    Between samples a filter may coast; a stationary gain has no meaning where such a mode cannot be seen, and a
    time-varying one lets its error grow as long as that lasts.
    """
    places = require_array("places", places, shape=(model.samples,))
    values, every = linalg.eig(model.a[-1])
    for value in values[np.abs(values) >= 1 - 1e-9]:
        same = every[:, np.abs(values - value) <= 1e-6]
        left, sizes, _ = np.linalg.svd(same, full_matrices=False)
        vectors = left[:, sizes > 1e-6 * sizes[0]]  # of this eigenvalue; those of a chain are parallel
        seen = np.linalg.svd(model.c @ vectors, compute_uv=False)
        weakest = seen[:, -1] if seen.shape[1] == vectors.shape[1] else np.zeros(len(seen))
        lost = np.flatnonzero(weakest <= BLIND * seen.max())
        if len(lost):
            raise InputError(
                f"at {places[lost[0]]:g} m (sample {lost[0]}) the mode at z = {value:.6g} is not observable and "
                f"not stable; keep the scan away from its node or add a sensor"
            )


def scheduled_gains(model: TimeVaryingModel, table: GainTable, places: ArrayLike) -> FilterGains:
    """Filter whose gain is looked up at every sample; everything else is the time-varying filter's."""
    require_observable_along(model, places)
    gains = require_array("table.gains", table.at(places), shape=(None, *model.c.shape[:0:-1]))
    return FilterGains(model.a, model.b, gains, model.c)
