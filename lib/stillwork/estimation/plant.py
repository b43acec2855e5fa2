"""Plants with one coordinate, and their inverse, from user-defined functions."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, pluralise, require_array
from stillwork.base.kernels import callback
from stillwork.base.validation import by_value, check_fields, checked, user_callback

# Nearest first: what a reader's units make of a number that is about 1 in SI is not known.
SIZES = [10.0**decade for decade in sorted(range(-30, 31, 3), key=abs)]
STEPS = sorted(range(-15, 16), key=abs)  # decades
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
        Passed to both functions; a change does not recompile them.

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
        failure: Exception | None = None
        for size in SIZES:
            position, velocity = 0.3 * size, -0.2 * size
            try:
                wanted, force, got = self._inverted(position, velocity)
            except Exception as error:  # a reader's function may raise anything, as outside its range
                failure = failure or error
                continue
            if math.isclose(got, wanted, rel_tol=1e-6):
                return
            raise InputError(
                f"force is not the inverse of acceleration: for {wanted:g} m/s^2 at q = {position:g}, "
                f"q' = {velocity:g} it gives {force:g} N, which accelerates by {got:g}; correct one of the two"
            )
        raise InputError(
            f"acceleration or force fails on {pluralise(len(self.parameters), 'parameter')} ({failure}); "
            "give functions of (position, velocity, force or acceleration, parameters) that return a number"
        ) from None

    def _inverted(self, position: float, velocity: float) -> tuple[float, float, float]:
        """An acceleration whose share of the force is not lost beside the others', its force, and what that gives."""
        rest = self.force(position, velocity, 0.0, self.parameters)
        for size in SIZES:
            wanted = 1.7 * size
            force = self.force(position, velocity, wanted, self.parameters)
            if math.isfinite(force) and abs(force - rest) > 1e-3 * abs(rest):
                got = self.acceleration(position, velocity, force, self.parameters)
                if math.isfinite(got):
                    return wanted, force, got
        raise ValueError(f"no acceleration shows in a finite force at q = {position:g}")

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
    acceleration = user_callback(plant.acceleration)

    def along(value):
        return acceleration(*point[:axis], value, *point[axis + 1 :], plant.parameters)

    return float(slope(along, point[axis]))


@checked(missing=True)
def slope(function: Callable[[float], ArrayLike], at: float) -> float | np.ndarray:
    """Derivative of numbers with respect to one, in whatever units: a central difference, NaN where none is finite.

    Of the decades of steps around a millionth it takes the first at which halving the step moves the difference by
    less than a billionth, else that at which it moves it least. Where it moves it by more than a tenth at all of them
    it takes the smallest difference: a kink in its middle has the slope 0, and so has a jump.

    Examples
    --------
    >>> from stillwork.estimation.plant import slope
    >>> bool(abs(slope(lambda q: 5.0 + 1e18 * q**2, 1e-9) / 2e9 - 1) < 1e-6)
    True
    """

    def values(place):
        return require_array("what function returns", function(place), missing=True, infinite=True)

    least, best, smallest, flattest, failure = 0.1, None, np.inf, np.array(np.nan), None
    for decade in STEPS:
        step = 1e-6 * max(1.0, abs(at)) * 10.0**decade
        if step < 1e-10 * abs(at):  # lost in rounding the place
            continue
        try:
            high, low, up, down = (values(at + share * step) for share in (1.0, -1.0, 0.5, -0.5))
        except Exception as error:  # a reader's function may raise anything, as outside its range
            failure = error
            continue
        fine = (up - down) / step
        lost = 4 * np.finfo(float).eps * np.abs([high, low]).max(initial=0.0) / step
        change = np.abs((high - low) / (2 * step) - fine).max(initial=0.0) + lost
        size = np.abs(fine).max(initial=0.0)
        if not np.isfinite(size + change):
            continue
        if size + change < smallest:
            smallest, flattest = size + change, fine
        if change <= least * size:
            least, best = change / size if size else 0.0, fine
            if least < 1e-9:
                break
    if smallest == np.inf and failure is not None:
        raise failure
    found = flattest if best is None else best
    return found if found.ndim else float(found)
