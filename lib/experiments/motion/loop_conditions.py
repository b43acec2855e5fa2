"""Slopes and static gains, which tell whether a loop keeps its integral action (Theorems 3.2.3 to 3.3.1)."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.lti.state_space import StateModel


def slope(omega: ArrayLike, response: ArrayLike) -> float:
    """Slope of a magnitude in decades a decade, by least squares over the given frequencies."""
    omega = np.asarray(omega, float)
    magnitude = np.abs(np.asarray(response))
    return float(np.polyfit(np.log(omega), np.log(magnitude), 1)[0])


def static_gain(model: StateModel) -> Float64[np.ndarray, "outputs inputs"]:
    """Gain at zero frequency of a continuous model without poles at the origin."""
    return model.d - model.c @ np.linalg.solve(model.a, model.b)
