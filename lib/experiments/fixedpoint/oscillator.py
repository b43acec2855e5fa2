"""The modified van der Pol oscillator of the paper, (11), from TOML."""

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError, nearest
from stillwork.base.kernels import kernel
from stillwork.base.toml_files import read_toml
from stillwork.base.validation import check_fields
from stillwork.estimation.plant import Plant
from workbook import paths


@dataclass(frozen=True)
class VanDerPol:
    """The oscillator of (11): m q'' + k q - b1 (a^2 - q^2) q' + b2 q' + d sign(q') q'^2 = u."""

    mass: Positive  # m, kg
    stiffness: float  # k, N/m
    separator: float  # a, m
    excitation: float  # b1, N s/m^3
    damping: float  # b2, N s/m
    drag: float  # d, N s^2/m^2

    def __post_init__(self):
        check_fields(self)

    @property
    def plant(self) -> Plant:
        """The oscillator as the kernels use it."""
        parameters = np.array([getattr(self, field.name) for field in fields(self)], dtype=float)
        return Plant(oscillator_acceleration, oscillator_force, parameters)


def oscillator_acceleration(position, velocity, force, parameters):
    """Equation (11) solved for the acceleration."""
    return (force - restoring_force(position, velocity, parameters)) / parameters[0]


def oscillator_force(position, velocity, acceleration, parameters):
    """Equation (11): the force that gives an acceleration."""
    return parameters[0] * acceleration + restoring_force(position, velocity, parameters)


@kernel
def restoring_force(position, velocity, parameters):
    """All forces of (11) but the inertial and the driving one, N."""
    separator, excitation = parameters[2], parameters[3]
    return (
        parameters[1] * position
        - excitation * (separator**2 - position**2) * velocity
        + parameters[4] * velocity
        + parameters[5] * abs(velocity) * velocity
    )


def load_oscillator(file: Path | str | None = None) -> dict[str, VanDerPol]:
    """Models ``exact`` and ``approximate`` from TOML, by default those of Table I."""
    file = Path(file) if file else paths.data("fixedpoint", "oscillator.toml")
    tree = read_toml(file)
    known = [field.name for field in fields(VanDerPol)]
    models = {}
    for name in ("exact", "approximate"):
        table = tree.table(name)
        for key in table:
            if key not in known:
                raise InputError(f"{file}: [{name}] has an unknown parameter {key!r}{nearest(key, known)}")
        try:
            models[name] = VanDerPol(*(table[key] for key in known))
        except InputError as error:
            raise InputError(f"{file}: [{name}] {error}") from None
    return models
