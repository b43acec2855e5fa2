"""Integral action of the equivalent controller: Theorems 3.2.1, 3.2.3, 3.2.4 and 3.3.1 as checks."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array, require_choice
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


def slope(omega: ArrayLike, response: ArrayLike) -> float:
    """Slope of a magnitude in decades a decade, by least squares over the given frequencies."""
    omega = require_array("omega", omega, ndim=1)
    magnitude = np.abs(np.asarray(response))
    if len(omega) < 2 or np.any(omega <= 0) or np.any(magnitude == 0):
        raise InputError(
            "omega and response: give at least two positive frequencies with a response that is not 0"
        )
    return float(np.polyfit(np.log(omega), np.log(magnitude), 1)[0])


def static_gain(model: StateModel) -> Float64[np.ndarray, "outputs inputs"]:
    """Gain at zero frequency of a continuous model without poles at the origin."""
    rate = np.abs(model.poles).max()
    if np.abs(model.poles).min() < 1e-12 * rate:
        raise InputError("model has a pole at the origin; its static gain is infinite")
    return model.d - model.c @ np.linalg.solve(model.a, model.b)


class ObserverConditions(NamedTuple):
    """Static gains of the observer block and whether they keep the integral action."""

    input_gain: float  # O_yu(0) for MC, O_uu(0) for AD
    output_gain: float  # O_yy(0) for MC, O_uy(0) for AD
    keeps: bool


def required_integrators(disturbance: int = 1, reference: int = 1, sensor: int = 1, plant: int = 2) -> int:
    """Smallest number of integrators in C_y that brings the error to zero, (3.8), by the powers of 1/s in w, r, v, P."""
    return max(disturbance - 1, sensor - plant - 1, reference - plant - 1, -1) + 1


def keeps_integral_action(compensator: StateModel, application: str) -> ObserverConditions:
    """Conditions (3.12)-(3.13) for measurement compensation or (3.38)-(3.39) for active damping.

    A static gain below 1e-9 of the largest over frequency counts as zero: it is a difference of large
    numbers, exact only to rounding.
    """
    require_choice("application", application, ("compensation", "damping"))
    row = 1 if application == "compensation" else 0
    gains = static_gain(compensator)[row]
    omega = np.unique(np.abs(compensator.poles))
    peak = np.abs(compensator.frequency_response(omega)[row]).max(axis=1)
    zero = np.abs(gains) <= 1e-9 * peak
    keeps = bool(zero[1] and zero[0]) if application == "compensation" else bool(zero[1])
    return ObserverConditions(float(gains[0]), float(gains[1]), keeps)


def observable_noise_models(plant: ModalModel) -> int:
    """How many constant forces, one an actuator, the sensors can tell apart: the rank test (3.17).

    The rank of [A B; C 0] beyond the states, after scaling.
    """
    states = plant.state_space()
    size = np.linalg.norm(states.a)
    whole = np.block([[states.a, states.b], [states.c, np.zeros_like(states.d)]])
    scale = np.repeat(np.where(plant.frequencies > 0, plant.frequencies, size**0.5), 2)
    scale[1::2] = 1.0  # velocities count as the displacement they lead to
    whole[:, : len(states.a)] /= scale
    whole[: len(states.a)] *= scale[:, None]
    whole /= np.linalg.norm(whole, axis=1)[:, None]
    whole /= np.linalg.norm(whole, axis=0)
    return int(np.linalg.matrix_rank(whole, tol=1e-10)) - len(states.a)
