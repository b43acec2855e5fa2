"""Sensors that see another place of the structure at every instant: mode shapes along the row of masses."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array
from stillwork.lti.modal import ModalModel


def shapes_along(
    model: ModalModel, grid: ArrayLike, places: ArrayLike
) -> Float64[np.ndarray, "samples modes"]:
    """Mode shapes at places (m) between the outputs of a model, which sit on a `grid`, by cubic splines through them."""
    from scipy.interpolate import CubicSpline

    grid = require_array("grid", grid, shape=(len(model.output_shapes),))
    places = require_array("places", places, ndim=1)
    if np.any(np.diff(grid) <= 0):
        raise InputError("grid must ascend; sort the outputs along the structure")
    if not len(places):
        raise InputError("places is empty; give the position at every sample in m")
    if places.min() < grid[0] or places.max() > grid[-1]:
        raise InputError(
            f"places run from {places.min():g} to {places.max():g} m, outside the grid from {grid[0]:g} to "
            f"{grid[-1]:g} m; shift or shorten the move"
        )
    return CubicSpline(grid, model.output_shapes)(places)
