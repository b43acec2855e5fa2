"""Plants with one coordinate: the modified van der Pol oscillator, and people's own."""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from stillwork import paths
from stillwork.checks import InputError, nearest, require_array, require_number
from stillwork.kernels import callback, kernel

SIGNATURE = "float64(float64, float64, float64, float64[::1])"  # of a plant's two functions


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
    """

    acceleration: Callable
    force: Callable
    parameters: ArrayLike

    def __post_init__(self):
        object.__setattr__(self, "parameters", require_array("parameters", self.parameters, ndim=1))
        position, velocity, wanted = 0.3, -0.2, 1.7
        try:
            force = self.force(position, velocity, wanted, self.parameters)
            got = self.acceleration(position, velocity, force, self.parameters)
            right = math.isclose(got, wanted, rel_tol=1e-6)
        except Exception as error:  # a reader's function may raise anything
            raise InputError(
                f"acceleration or force fails on {len(self.parameters)} parameters ({error}); "
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


@dataclass(frozen=True)
class VanDerPol:
    """The oscillator of (11): m q'' + k q - b1 (a^2 - q^2) q' + b2 q' + d sign(q') q'^2 = u."""

    mass: float  # m, kg
    stiffness: float  # k, N/m
    separator: float  # a, m
    excitation: float  # b1, N s/m^3
    damping: float  # b2, N s/m
    drag: float  # d, N s^2/m^2

    def __post_init__(self):
        require_number("mass", self.mass, above=0)
        for field in fields(self)[1:]:
            require_number(field.name, getattr(self, field.name))

    @property
    def plant(self) -> Plant:
        """The oscillator as the kernels know it."""
        parameters = np.array([getattr(self, field.name) for field in fields(self)], dtype=float)
        return Plant(oscillator_acceleration, oscillator_force, parameters)


def oscillator_acceleration(position, velocity, force, parameters):
    """Equation (11) solved for the acceleration."""
    return (force - _restoring_force(position, velocity, parameters)) / parameters[0]


def oscillator_force(position, velocity, acceleration, parameters):
    """Equation (11): the force that gives an acceleration."""
    return parameters[0] * acceleration + _restoring_force(position, velocity, parameters)


@kernel
def _restoring_force(position, velocity, parameters):
    separator, excitation = parameters[2], parameters[3]
    return (
        parameters[1] * position
        - excitation * (separator**2 - position**2) * velocity
        + parameters[4] * velocity
        + parameters[5] * abs(velocity) * velocity
    )


def load_oscillator(file: Path | str | None = None) -> dict[str, VanDerPol]:
    """Models ``exact`` and ``approximate`` from TOML, by default those of Table I.

    Raises
    ------
    InputError
        When the file lacks a model or a parameter, or holds an unknown one.
    """
    file = Path(file) if file else paths.data("fixedpoint", "oscillator.toml")
    try:
        tree = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"file {file} does not exist; give the path of a TOML file") from None
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror}); give the path of a TOML file") from None
    except UnicodeDecodeError:
        raise InputError(f"{file} is not text; give a TOML file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{file}: not valid TOML ({error}); mend that line") from None
    known = [field.name for field in fields(VanDerPol)]
    models = {}
    for name in ("exact", "approximate"):
        if name not in tree:
            raise InputError(f"{file}: no table [{name}]{nearest(name, tree)}; add it")
        if not isinstance(tree[name], dict):
            raise InputError(f"{file}: {name} is {tree[name]!r}; make it a table [{name}] of parameters")
        for key in tree[name]:
            if key not in known:
                raise InputError(f"{file}: [{name}] has an unknown parameter {key!r}{nearest(key, known)}")
        if missing := [key for key in known if key not in tree[name]]:
            raise InputError(f"{file}: [{name}] lacks {', '.join(missing)}; add them")
        try:
            models[name] = VanDerPol(**tree[name])
        except InputError as error:
            raise InputError(f"{file}: [{name}] {error}") from None
    return models


def partial_derivatives(plant: Plant, position: float, velocity: float, force: float) -> tuple[float, ...]:
    """Derivatives of the acceleration with respect to position, velocity and force, by central differences."""
    point = np.array([position, velocity, force], dtype=float)

    def slope(axis):
        step = 1e-6 * max(1.0, abs(point[axis])) * np.eye(3)[axis]
        high = plant.acceleration(*(point + step), plant.parameters)
        low = plant.acceleration(*(point - step), plant.parameters)
        return float((high - low) / (2 * step[axis]))

    return slope(0), slope(1), slope(2)
