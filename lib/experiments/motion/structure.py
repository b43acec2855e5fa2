"""A measured structure as a stage: its hammer records, and loops on the measured response."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillwork.base import paths
from stillwork.base.checks import require_number
from stillwork.control.applications import Application, compensator
from stillwork.control.bandwidth import Loop, make_loop
from stillwork.control.pid import Pid
from stillwork.estimation.observer import NoiseIntensities, kalman_observer
from stillwork.identification.frequency_response import Identified, impact_response
from stillwork.identification.modal_fit import ModalFit
from stillwork.lti.modal import ModalModel, mirrored
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel


def hammer_records() -> dict[str, np.ndarray]:
    """The shipped records: ``force_n`` and ``accel_m_s2`` (hits, samples) and ``fs_hz``; see SOURCE.md beside them."""
    file = paths.data("motion", "impact_frf_25k6/impact_hammer_5_hits.npz")
    with np.load(file, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive}


def measured_accelerance(padding: int = 4) -> Identified:
    """Acceleration over force of the structure (1/kg), counted positive along the force.

    The response has died out within each record, so zeros appended to it give a finer grid, not an
    interpolation.
    """
    records = hammer_records()
    force, response = (
        np.pad(records[name], ((0, 0), (0, (padding - 1) * records[name].shape[1])))
        for name in ("force_n", "accel_m_s2")
    )
    return impact_response(force, -response, float(records["fs_hz"]))  # the accelerometer faces the hammer


def as_stage(fit: ModalFit, mass: float) -> tuple[ModalModel, float]:
    """The fitted structure with another total mass, and the factor on its response."""
    require_number("mass", mass, above=0.0)
    factor = 1 / (mass * float(fit.model.input_shapes[0, 0] * fit.model.output_shapes[0, 0]))
    root = np.sqrt(factor)
    model = fit.model
    scaled = replace(
        model,
        input_shapes=root * model.input_shapes,
        output_shapes=root * model.output_shapes,
        feedthrough=factor * model.feedthrough,
    )
    return scaled, factor


def on_measurement(
    loop: Loop, measured: Identified, factor: float, band_hz: tuple[float, float], mirror: bool = False
) -> Loop:
    """The same loop with the measured response for a plant inside `band_hz`, and the model below it.

    Its loop functions are measured; its poles stay those of the model. With `mirror` the flexible part of the
    measurement, what it has beside the rigid body, changes sign.
    """
    inside = (measured.omega >= 2 * np.pi * band_hz[0]) & (measured.omega <= 2 * np.pi * band_hz[1])
    below = loop.omega[loop.omega < 2 * np.pi * band_hz[0]]
    omega = np.concatenate([below, measured.omega[inside]])
    position = -factor * measured.response[inside] / measured.omega[inside] ** 2
    if mirror:
        mobility = float(loop.plant.input_shapes[0, 0] * loop.plant.output_shapes[0, 0])
        position = -2 * mobility / measured.omega[inside] ** 2 - position
    plant = np.concatenate([loop.plant.frequency_response(below)[0, 0], position])
    return replace(
        loop,
        omega=omega,
        plant_response=plant,
        compensator_response=loop.compensator.frequency_response(omega),
    )


def extra_turns(measured: Loop, controller: Pid) -> int:
    """Turns around -1 that the measured open loop makes more than that of the model, on the measured band.

    Zero, with a stable model, means that the loop on the measured plant is stable too (Nyquist).
    """
    model = replace(
        measured,
        plant_response=measured.plant.frequency_response(measured.omega)[0, 0],
    )
    ratio = (1 + measured.at(controller).loop) / (1 + model.at(controller).loop)
    return round(float(np.sum(np.angle(ratio[1:] / ratio[:-1]))) / (2 * np.pi))


def structure_loops(
    stage: ModalModel,
    application: Application | None,
    retained: int,
    noise: NoiseIntensities,
    noise_model: float | None,
) -> list[Loop]:
    """Loops of a one-sensor structure and of its mirror image under one use of the observer."""
    return observed_loops((stage, mirrored(stage)), application, retained, noise, noise_model)


def observed_loops(
    plants: Sequence[ModalModel],
    application: Application | None,
    retained: int,
    noise: NoiseIntensities,
    noise_model: float | None,
) -> list[Loop]:
    """One loop a plant, each with its own observer."""
    return [
        make_loop(
            plant,
            application and observing_compensator(plant, application, retained, noise, noise_model),
        )
        for plant in plants
    ]


def observing_compensator(
    plant: ModalModel,
    application: Application,
    retained: int,
    noise: NoiseIntensities,
    noise_model: float | None,
) -> StateModel:
    """Compensator on an observer of the plant's first `retained` modes and the compliance of the others."""
    reduced = truncate(plant, retained, len(plant.frequencies) - retained)
    return compensator(kalman_observer(reduced, noise, noise_model), application)
