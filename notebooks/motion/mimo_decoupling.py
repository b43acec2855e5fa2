"""Decoupling a machine with several inputs and outputs: what this notebook alone needs."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from experiments.motion.beam import beam, beam_parameters, beam_shapes
from experiments.motion.decoupled_damping import added_damping
from experiments.motion.decoupling_schemes import (
    Settings,
    low_frequency_slopes,
    published_settings,
    with_compensation,
)
from experiments.motion.intervals import Values
from stillwork.control.decoupling import decouple, decoupled_plant
from stillwork.control.feedback import damping_gain
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from workbook import figures


def paint_beam_layout(actuators: Sequence[float], sensors: Sequence[float]):
    """Flexible mode shapes of the uniform beam with the places of actuators and sensors."""
    published = beam_parameters()["published"]["frequencies_hz"]
    along = np.linspace(0, 1, 201)
    figure, axis = figures.new(1, 1, height=2.6)
    shapes = beam_shapes(along, 2 + len(published))[:, 2:]
    for frequency, shape in zip(published, shapes.T, strict=True):
        axis.plot(along, shape, label=f"{frequency:g} Hz")
    axis.plot(actuators, np.full(len(actuators), -2.35), "^", color=figures.BLACK, label="actuators")
    for number, place in enumerate(actuators, 1):
        axis.annotate(str(number), (place, -2.3), xytext=(6, 0), textcoords="offset points", fontsize=8)
    axis.plot(sensors, np.full(len(sensors), 2.35), "v", color=figures.GREY, label="sensors")
    axis.set(xlabel="place along the beam (of its length)", ylabel="mode shape (tip = 2)")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, 1.22), ncols=len(published) + 2)
    return figure


def observable_noise_models(plant: ModalModel) -> int:
    """How many constant forces, one per actuator, the sensors can tell apart: the rank test (3.17).

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


ACTUATORS, SENSORS = (0.1, 0.85), (0.03, 0.92)  # places as parts of the length; unpublished
TRAVEL, SENSOR_TRAVEL = (-0.1, 0.15), (-0.03, 0.07)  # of both along the beam; unpublished


class Moved(NamedTuple):
    """Added damping of the damped modes as both actuators move, with K(p) and with the gain of the built place."""

    shifts: Float64[np.ndarray, " shifts"]
    following: Float64[np.ndarray, "shifts modes"]
    kept: Float64[np.ndarray, "shifts modes"]


def move_actuators(
    actuators: Sequence[float],
    sensors: Sequence[float],
    settings: Settings,
    travel: Sequence[float],
    taper: float = 0.0,
) -> Moved:
    """Both actuators at eleven places along `travel`."""
    actuators, sensors = np.array(actuators), np.array(sensors)
    retained, rows = 2 + settings.damped, []
    built = damping_gain(truncate(beam(actuators, sensors, taper=taper), retained), settings.increase)
    shifts = np.linspace(*travel, 11)
    for shift in shifts:
        there = beam(actuators + shift, sensors, taper=taper)
        follows = damping_gain(truncate(there, retained), settings.increase)
        systems = [decoupled_plant(there, decouple(there), gain) for gain in (follows, built)]
        rows.append([added_damping(there, system)[0][: settings.damped] for system in systems])
    return Moved(shifts, *np.moveaxis(rows, 1, 0))


class Seen(NamedTuple):
    """MC as both sensors move: slopes off the diagonal, peaks lowered, and the slope with the sensing of the built place."""

    slopes: Float64[np.ndarray, "shifts 2"]
    lowered: Bool[np.ndarray, " shifts"]
    stale: Float64[np.ndarray, " shifts"]


def move_sensors(
    actuators: Sequence[float],
    sensors: Sequence[float],
    settings: Settings,
    travel: Sequence[float],
    taper: float = 0.0,
) -> Seen:
    """Both sensors at six places along `travel`, with the C_f of each."""
    actuators, sensors = np.array(actuators), np.array(sensors)
    slow, found = (0.03, 0.3), []  # Hz
    plant = beam(actuators, sensors, taper=taper)
    modes = plant.frequencies[2 : 2 + settings.damped]
    idle, built = np.zeros((2, 2 * len(plant.frequencies[: 2 + settings.damped]))), decouple(plant)
    for shift in np.linspace(*travel, 6):
        there = beam(actuators, sensors + shift, taper=taper)
        bare, seen = decoupled_plant(there, decouple(there), idle), with_compensation(there, settings)
        lowered = np.abs(seen.frequency_response(modes)) < np.abs(bare.frequency_response(modes))
        stale = low_frequency_slopes(decoupled_plant(there, built, idle), *slow)[0, 1]
        found.append((low_frequency_slopes(seen, *slow)[[0, 1], [1, 0]], lowered.all(), stale))
    return Seen(*map(np.array, zip(*found, strict=True)))


def moving_values(moved: Moved, seen: Seen, increase: float) -> Values:
    """What section 4.3 says of moving actuators and sensors, as the ledger has it: fractions of the places."""
    off = np.abs(moved.kept / increase - 1) > 0.1
    return {
        "motion.section-4-3.moving-actuators": float(
            np.all(np.abs(moved.following / increase - 1) < 0.01, axis=1).mean()
        ),
        "motion.section-4-3.kept-gain": float(off.any(axis=1)[np.abs(moved.shifts) > 1e-9].mean()),
        "motion.section-4-3.moving-sensors-peaks": float(seen.lowered.mean()),
    }


def moving(*, second_actuator: float, beam_taper: float, seed: int) -> Values:
    """The same on another beam; it has no fast variant."""
    places, settings = ((ACTUATORS[0], second_actuator), SENSORS), published_settings()
    moved = move_actuators(*places, settings, TRAVEL, beam_taper)
    seen = move_sensors(*places, settings, SENSOR_TRAVEL, beam_taper)
    return moving_values(moved, seen, settings.increase)
