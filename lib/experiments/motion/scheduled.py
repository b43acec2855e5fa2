"""Position-dependent Kalman filters: gains online by the Riccati recursion, or interpolated from a grid (5.6)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.estimation.riccati import discrete_gain
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel


@dataclass(frozen=True)
class GainTable:
    """Stationary filter gains on a grid of positions."""

    grid: Float64[np.ndarray, " places"]  # m, ascending
    gains: Float64[np.ndarray, "places states outputs"]

    def at(self, places: ArrayLike) -> Float64[np.ndarray, "samples states outputs"]:
        """Gains at places (m) on the grid by linear interpolation."""
        places = np.asarray(places, float)
        right = np.clip(np.searchsorted(self.grid, places), 1, len(self.grid) - 1)
        part = (places - self.grid[right - 1]) / (self.grid[right] - self.grid[right - 1])
        part = part[:, None, None]
        return (1 - part) * self.gains[right - 1] + part * self.gains[right]


def gain_table(
    a: ArrayLike, g: ArrayLike, rows: ArrayLike, grid: ArrayLike, process: ArrayLike, sensor: ArrayLike
) -> GainTable:
    """Stationary Kalman filter gains for the rows of C at every point of an ascending grid (m)."""
    gains = [discrete_gain(a, g, c, process, sensor).filter_gain for c in np.asarray(rows, float)]
    return GainTable(np.asarray(grid, float), np.array(gains))


def scheduled_gains(model: TimeVaryingModel, table: GainTable, places: ArrayLike) -> FilterGains:
    """Filter whose gain is looked up at every sample; everything else is the time-varying filter's."""
    return FilterGains(model.a, model.b, table.at(places), model.c)
