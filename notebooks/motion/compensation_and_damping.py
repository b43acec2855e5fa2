"""The small gain of the modes that an observer does not know (notebook 08), section 3.4.1."""

from dataclasses import replace

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.checks import InputError
from stillwork.estimation.observer import Observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, interconnect


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
