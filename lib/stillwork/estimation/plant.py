"""Plants with one coordinate, and their inverse, from functions of people's own."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, pluralise, require_array
from stillwork.base.kernels import callback
from stillwork.base.validation import by_value, check_fields, checked, user_callback

SIGNATURE = "float64(float64, float64, float64, float64[::1])"  # of a plant's two functions


@by_value
@dataclass(frozen=True)
class Plant:
    """A second-order plant with one coordinate, and its inverse.

    Both functions are written in plain Python with `math` or `numpy`, in a file, and take
    ``(position, velocity, force or acceleration, parameters)``; they are compiled on first use and cached
    beside that file, so that a second process starts at once.

    Attributes
    ----------
    acceleration : callable
        ``acceleration(position, velocity, force, parameters)``, m/s^2.
    force : callable
        ``force(position, velocity, acceleration, parameters)``, N: the inverse of the first.
    parameters : ndarray, shape (parameters,)
        Passed to both; changing them recompiles nothing.

    Raises
    ------
    InputError
        When a function fails, or `force` is not the inverse of `acceleration`.

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> float(slide.force(0.0, 0.1, 3.0, slide.parameters))  # N, for 3 m/s^2 of 2 kg
    6.0
    """

    acceleration: Callable
    force: Callable
    parameters: ArrayLike

    def __post_init__(self):
        check_fields(self)
        object.__setattr__(self, "parameters", require_array("parameters", self.parameters, ndim=1))
        position, velocity, wanted = 0.3, -0.2, 1.7
        try:
            force = self.force(position, velocity, wanted, self.parameters)
            got = self.acceleration(position, velocity, force, self.parameters)
            right = math.isclose(got, wanted, rel_tol=1e-6)
        except Exception as error:  # a reader's function may raise anything
            raise InputError(
                f"acceleration or force fails on {pluralise(len(self.parameters), 'parameter')} ({error}); "
                "give functions of (position, velocity, force or acceleration, parameters) that return a number"
            ) from None
        if not right:
            raise InputError(
                f"force is not the inverse of acceleration: for {wanted} m/s^2 at q = {position}, "
                f"q' = {velocity} it gives {force:g} N, which accelerates by {got:g}; mend one of the two"
            )

    @property
    def compiled(self):
        """The two functions as C callbacks, and the parameters: what the kernels take."""
        return callback(self.acceleration, SIGNATURE), callback(self.force, SIGNATURE), self.parameters


@checked
def partial_derivatives(plant: Plant, position: float, velocity: float, force: float) -> tuple[float, ...]:
    """Derivatives of the acceleration with respect to position, velocity and force, by central differences."""
    return tuple(_slope(plant, axis, position, velocity, force) for axis in range(3))


@checked
def force_slope(plant: Plant, position: float, velocity: float, force: float) -> float:
    """Derivative of the acceleration with respect to the force alone, as `partial_derivatives` gives it."""
    return _slope(plant, 2, position, velocity, force)


def _slope(plant: Plant, axis: int, *point: float) -> float:
    at = np.array(point, dtype=float)
    step = 1e-6 * max(1.0, abs(at[axis])) * np.eye(3)[axis]
    acceleration = user_callback(plant.acceleration)
    high = acceleration(*(at + step), plant.parameters)
    low = acceleration(*(at - step), plant.parameters)
    return float((high - low) / (2 * step[axis]))
