"""Conditions of chapter 3 as checks: integral action (Theorems 3.2.1 to 3.3.1), and small gain of the unknown modes."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError
from stillwork.estimation.observer import Observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, interconnect


def slope(omega: ArrayLike, response: ArrayLike) -> float:
    """Slope of a magnitude in decades a decade, by least squares over the given frequencies."""
    omega = np.asarray(omega, float)
    magnitude = np.abs(np.asarray(response))
    return float(np.polyfit(np.log(omega), np.log(magnitude), 1)[0])


def static_gain(model: StateModel) -> Float64[np.ndarray, "outputs inputs"]:
    """Gain at zero frequency of a continuous model without poles at the origin."""
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
    compensates = application == "compensation"
    gains = static_gain(compensator)[int(compensates)]
    poles = compensator.poles
    peak = np.abs(compensator.frequency_response(np.abs(poles[poles.imag >= 0]))[int(compensates)]).max(
        axis=1
    )
    from_force, from_output = np.abs(gains) <= 1e-9 * peak
    return ObserverConditions(*gains.tolist(), bool(from_output and (from_force or not compensates)))


def without_compliance(observer: Observer) -> Observer:
    """The same observer, gain included, with T_DC taken out: it moves into S."""
    feedthrough = np.zeros_like(observer.model.feedthrough)
    return replace(observer, model=replace(observer.model, feedthrough=feedthrough))


def small_gain(
    omega: Float64[np.ndarray, " frequencies"],
    plant: ModalModel,
    retained: int,
    feedthrough: float,
    compensator: StateModel,
    controller: StateModel,
) -> Complex128[np.ndarray, " frequencies"]:
    r""":math:`H_{11}S` of (3.45) for one loop; a magnitude below 1 everywhere proves stability.

    The discarded modes enter in two places, the measurement that the controller sees and the innovation of the
    observer, where the compliance T_DC (`feedthrough`) is subtracted: S has one input (the actuator force) and two
    outputs. The compensator is that of an observer *without* T_DC, with the gain of the real one.
    """
    known = plant.modes(slice(0, retained)).state_space()
    # Outputs: y0, u_d, y_flex, u_fb. Inputs: f, (f, y + s2), e; ports s1 into e, s2 into the observer.
    feedback = np.array([[0, 1, 0, 1], [0, 1, 0, 1], [1, 0, 0, 0], [-1, 0, 1, 0]], dtype=float)
    ports = np.array([[0, 0], [0, 0], [0, 1], [-1, 0]], dtype=float)
    wanted = np.array([[0, 1, 0, 1]], dtype=float)
    loop = interconnect([known, compensator, controller], feedback, ports, wanted)
    if not loop.is_stable:
        raise InputError("the nominal loop is unstable; the small-gain check needs it stable")
    nominal = loop.frequency_response(omega)[0]
    unknown = plant.modes(slice(retained, None)).frequency_response(omega)[0, 0]
    return (nominal * np.array([unknown, unknown - feedthrough])).sum(axis=0)
