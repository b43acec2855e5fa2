"""The loop of Fig. 1: measure, filter, command forces, move the plant; of a plant with one coordinate, and of a mechanism."""

from typing import NamedTuple

import numpy as np

from stillwork.base.algebra import copy_vector
from stillwork.base.kernels import borrowing_kernel, inlined_kernel, pasted_kernel
from stillwork.control.held_force import HELD_ROWS, move_held, move_mechanism_held
from stillwork.control.mechanism import forward_dynamics, inverse_dynamics
from stillwork.control.regressor import ROOM, fill_regressor
from stillwork.control.transformation import deform_packed
from stillwork.estimation.filter_step import Packed, filter_step

INTEGRATIONS = ("exact", "semi-implicit", "explicit")
EXACT, SEMI_IMPLICIT, EXPLICIT = range(3)
RUNNING, TOO_FAR, NOT_FINITE, NOT_DEFINITE, NO_INERTIA = range(5)  # how a run ends
HOLD, EXTEND, SKIP = range(3)  # of a lost sample
SEEN, MEASURED, DESIRED, DEFORMED = range(4)  # what a coordinate's `memory` holds
COLUMNS = 10  # of a record


class Course(NamedTuple):
    """What the plant meets; n coordinates, N samples."""

    sample_time: float
    nominal: np.ndarray  # (n, 3, N): position, velocity, acceleration
    noise: np.ndarray  # (n, N), NaN where a sample is lost
    resolutions: np.ndarray  # (n,), of the encoders
    grids: np.ndarray  # (n,)
    disturbance: np.ndarray  # (n, N)
    plants: np.ndarray  # a row of parameters before the change, one after it
    changed: int  # first sample after it
    integration: int
    limits: np.ndarray  # (n, 2): position and velocity that count as diverged


class Law(NamedTuple):
    """From the estimates to the forces: a fixed-point iteration, or Slotine and Li's law with `feedback` of n numbers."""

    loss: int
    error_from_measurement: bool
    force_from_estimate: bool
    gains: np.ndarray  # (n, terms) of the kinematics
    transformations: np.ndarray  # (n, 4)
    force_limits: np.ndarray  # (n,)
    feedback: np.ndarray  # (0,) of a fixed-point iteration
    adaptation: np.ndarray  # a number for each parameter of the model
    units: np.ndarray  # identity matrix of as many parameters


class State(NamedTuple):
    """What the loop changes."""

    motion: np.ndarray  # (2, n): true position and velocity
    estimate: np.ndarray  # (n, 3)
    chain: np.ndarray  # (n, terms): the error's integrals
    memory: np.ndarray  # (n, 4)
    parameters: np.ndarray  # of the model, which Slotine and Li's law changes
    columns: np.ndarray  # (n, parameters), workspace
    rows: np.ndarray  # workspace, each row a vector of the coordinates


FORCE, ACCELERATION, WANTED, PLACE, SPEED, HELD, ACTING, OBSERVED, REFERENCE, SLIDING = range(10)  # its rows
ROWS = 10 + HELD_ROWS


def first_state(start: np.ndarray, acceleration: np.ndarray, law: Law, parameters: np.ndarray) -> State:
    """State of a loop that begins at `start`, (2, n), and at the nominal acceleration."""
    count = start.shape[1]
    return State(
        np.array(start, dtype=float),
        np.vstack([start, acceleration]).T.copy(),  # rows in one piece
        np.zeros_like(law.gains),
        np.zeros((count, 4)),
        np.array(parameters, dtype=float),
        np.zeros((count, len(parameters))),
        np.zeros((ROWS + count + max(ROOM, count + 5), count)),
    )


# The filter itself is stepped between the next two by the loop that holds it: handed on through another function, its
# arrays would be counted again at every sample, which takes as long as all the rest.
@inlined_kernel
def measure_position(measurement, position, noise, sample_time, speed, last):
    """Measured position, or its replacement if it is lost; `speed` is the estimated one."""
    resolution, grid, loss = measurement
    measured = position + noise
    if resolution > 0.0:
        measured = np.round((measured - grid) / resolution) * resolution + grid
    if np.isnan(noise) and loss == HOLD:
        measured = last
    elif np.isnan(noise) and loss == EXTEND:
        measured = last + sample_time * speed
    return measured


@inlined_kernel
def command_step(parts, sample_time, nominal, measured, first, held, chain, estimate, memory):
    """Desired and deformed acceleration of one coordinate for one sample.

    parts: whether the error is that of the measurement, transformation, gains. held: the force is at its limit, nothing is integrated.
    """
    error_from_measurement, transformation, gains = parts
    integrals = len(gains) - 2
    seen = measured if error_from_measurement else estimate[0]
    chain[0] = nominal[0] - seen  # chain[j]: j-fold integral of the error
    desired = nominal[2] + gains[integrals + 1] * (nominal[1] - estimate[1])
    desired += gains[integrals] * chain[0]
    for j in range(1, integrals + 1):
        if not held:
            chain[j] += sample_time * chain[j - 1]
        desired += gains[integrals - j] * chain[j]
    deformed = memory[DEFORMED]
    before = memory[DESIRED]
    if first:
        memory[DEFORMED] = desired
    else:
        memory[DEFORMED] = deform_packed(transformation, deformed, estimate[2], desired, before)
    memory[SEEN], memory[MEASURED], memory[DESIRED] = seen, measured, desired


@inlined_kernel
def record_sample(record, i, position, velocity, acceleration, estimate, memory, force):
    """One column of a coordinate's record, in the order of `ControlledRun`."""
    record[0, i], record[1, i], record[2, i] = position, velocity, acceleration
    record[3, i] = memory[MEASURED]
    record[4, i], record[5, i], record[6, i] = estimate[0], estimate[1], estimate[2]
    record[7, i], record[8, i], record[9, i] = memory[DESIRED], memory[DEFORMED], force


# The compiled functions are arguments of their own: numba warns of those in a tuple.
@borrowing_kernel
def run_one_coordinate(
    device,
    filter_acceleration,
    filter_plant,
    law,
    model_acceleration,
    model_force,
    model,
    plant_acceleration,
    course,
    state,
    record,
):
    """Fill `record` (COLUMNS x N) of a `Plant`; the samples done, and how it ended.

    It keeps position, velocity and force in registers: `run_mechanism` takes a third to two times as long on one coordinate.
    """
    positions, velocities, accelerations = course.nominal[0, 0], course.nominal[0, 1], course.nominal[0, 2]
    noise, disturbance, sample_time = course.noise[0], course.disturbance[0], course.sample_time
    measurement, force_limit = (course.resolutions[0], course.grids[0], law.loss), law.force_limits[0]
    parts = law.error_from_measurement, law.transformations[0], law.gains[0]
    estimate, chain, memory, limits = state.estimate[0], state.chain[0], state.memory[0], course.limits[0]
    position, velocity = state.motion[0, 0], state.motion[1, 0]
    force, held, length = 0.0, False, sample_time
    for i in range(len(noise)):
        plant = course.plants[0] if i < course.changed else course.plants[1]
        now = positions[i], velocities[i], accelerations[i]
        measured = measure_position(
            measurement, position, noise[i], sample_time, estimate[1], memory[MEASURED]
        )
        if not filter_step(device, filter_acceleration, filter_plant, sample_time, measured, force, estimate):
            return i, NOT_DEFINITE
        command_step(parts, sample_time, now, measured, i == 0, held, chain, estimate, memory)
        place = estimate[0] if law.force_from_estimate else memory[SEEN]
        force = model_force(place, estimate[1], memory[DEFORMED], model)
        if not np.isfinite(force):
            return i, NOT_FINITE
        held = abs(force) > force_limit
        if held:
            force = np.copysign(force_limit, force)
            memory[DEFORMED] = model_acceleration(place, estimate[1], force, model)
        acting = force + disturbance[i]
        acceleration = plant_acceleration(position, velocity, acting, plant)
        record_sample(record, i, position, velocity, acceleration, estimate, memory, force)
        if course.integration == EXACT:
            position, velocity, length = move_held(
                plant_acceleration, plant, position, velocity, acting, sample_time, length
            )
        else:
            before = velocity
            velocity += sample_time * acceleration
            position += sample_time * (velocity if course.integration == SEMI_IMPLICIT else before)
        if not (abs(position) < limits[0] and abs(velocity) < limits[1]):
            return i, TOO_FAR
    return len(noise), RUNNING


@pasted_kernel
def observe(device, acceleration, plant, law, course, i, state):
    """Measure and filter all coordinates; false where a covariance is no longer positive definite."""
    kind, options, process, sensor, works = device
    estimate, rows, period = state.estimate, state.rows, course.sample_time
    measured, driven = rows[OBSERVED], rows[WANTED]
    for j in range(len(estimate)):
        measurement, last = (course.resolutions[j], course.grids[j], law.loss), state.memory[j, MEASURED]
        position, noise = state.motion[0, j], course.noise[j, i]
        measured[j] = measure_position(measurement, position, noise, period, estimate[j, 1], last)
        own = Packed(kind, options[j], process[j], sensor[j], works[j])
        if not filter_step(own, acceleration, plant, period, measured[j], driven[j], estimate[j]):
            return False
    return True


@pasted_kernel
def iterate(law, inertia, bias, course, i, state):
    """Deformed accelerations and the forces that command them; how it ends."""
    rows, memory, room = state.rows, state.memory, state.rows[ROWS:]
    force, deformed, place, speed, held = rows[FORCE], rows[WANTED], rows[PLACE], rows[SPEED], rows[HELD]
    for j in range(len(force)):
        parts = law.error_from_measurement, law.transformations[j], law.gains[j]
        now = course.nominal[j, 0, i], course.nominal[j, 1, i], course.nominal[j, 2, i]
        at_limit, estimate = held[j] > 0.0, state.estimate[j]
        measured = rows[OBSERVED, j]
        command_step(
            parts, course.sample_time, now, measured, i == 0, at_limit, state.chain[j], estimate, memory[j]
        )
        place[j], deformed[j], speed[j] = memory[j, SEEN], memory[j, DEFORMED], estimate[1]
    inverse_dynamics(inertia, bias, state.parameters, place, speed, deformed, room, force)
    limited = False
    for j in range(len(force)):
        if not np.isfinite(force[j]):
            return NOT_FINITE
        held[j] = 0.0
        if abs(force[j]) > law.force_limits[j]:
            force[j] = np.copysign(law.force_limits[j], force[j])
            held[j], limited = 1.0, True
    if limited and not forward_dynamics(inertia, bias, state.parameters, place, speed, force, room, deformed):
        return NO_INERTIA
    copy_vector(deformed, memory[:, DEFORMED])
    return RUNNING


@pasted_kernel
def adapt(law, inertia, bias, course, i, state, history):
    """Slotine and Li's forces, and a step of the model's parameters; how it ends."""
    rows, memory, columns, parameters = state.rows, state.memory, state.columns, state.parameters
    force, wanted, place, speed = rows[FORCE], rows[WANTED], rows[PLACE], rows[SPEED]
    reference, sliding, integrals = rows[REFERENCE], rows[SLIDING], law.gains.shape[1] - 1
    for j in range(len(force)):
        chain, gains = state.chain[j], law.gains[j]
        place[j], speed[j] = rows[OBSERVED, j], state.estimate[j, 1]
        chain[0] = course.nominal[j, 0, i] - place[j]
        reference[j] = course.nominal[j, 1, i] + gains[integrals] * chain[0]
        wanted[j] = course.nominal[j, 2, i] + gains[integrals] * (course.nominal[j, 1, i] - speed[j])
        for k in range(1, integrals + 1):
            chain[k] += course.sample_time * chain[k - 1]
            reference[j] += gains[integrals - k] * chain[k]
            wanted[j] += gains[integrals - k] * chain[k - 1]
        sliding[j] = reference[j] - speed[j]
        memory[j, MEASURED], memory[j, DESIRED], memory[j, DEFORMED] = place[j], wanted[j], wanted[j]
    fill_regressor(inertia, bias, law.units, place, speed, reference, wanted, rows[ROWS:], columns)
    for j in range(len(force)):
        force[j] = law.feedback[j] * sliding[j]
        for k in range(len(parameters)):
            force[j] += columns[j, k] * parameters[k]
        if not np.isfinite(force[j]):
            return NOT_FINITE
    for k in range(len(parameters)):
        history[k, i] = parameters[k]
        for j in range(len(force)):
            parameters[k] += course.sample_time * law.adaptation[k] * columns[j, k] * sliding[j]
    return RUNNING


@borrowing_kernel
def run_mechanism(
    device,
    filter_acceleration,
    filter_plant,
    law,
    model_inertia,
    model_bias,
    inertia,
    bias,
    course,
    state,
    record,
    history,
):
    """Fill `record` (n x COLUMNS x N) and `history` (parameters x N, or 0 x N); the samples done, and how it ended."""
    n, samples = course.noise.shape
    rows, room, length = state.rows, state.rows[ROWS:], course.sample_time
    position, velocity, force = state.motion[0], state.motion[1], rows[FORCE]
    acting, acceleration = rows[ACTING], rows[ACCELERATION]
    for i in range(samples):
        parameters = course.plants[0] if i < course.changed else course.plants[1]
        if not observe(device, filter_acceleration, filter_plant, law, course, i, state):
            return i, NOT_DEFINITE
        if len(law.feedback) == 0:
            status = iterate(law, model_inertia, model_bias, course, i, state)
        else:
            status = adapt(law, model_inertia, model_bias, course, i, state, history)
        if status != RUNNING:
            return i, status
        for j in range(n):
            acting[j] = force[j] + course.disturbance[j, i]
        if not forward_dynamics(inertia, bias, parameters, position, velocity, acting, room, acceleration):
            return i, NO_INERTIA
        for j in range(n):
            own, estimate, memory = record[j], state.estimate[j], state.memory[j]
            record_sample(own, i, position[j], velocity[j], acceleration[j], estimate, memory, force[j])
        if course.integration == EXACT:
            held, period = rows[ROWS - HELD_ROWS : ROWS], course.sample_time
            length = move_mechanism_held(
                inertia, bias, parameters, position, velocity, acting, period, length, room, held
            )
            if length == 0.0:
                return i, NO_INERTIA
        for j in range(n):
            if course.integration != EXACT:
                speed = velocity[j]
                velocity[j] += course.sample_time * acceleration[j]
                if course.integration == SEMI_IMPLICIT:
                    speed = velocity[j]
                position[j] += course.sample_time * speed
            if not (abs(position[j]) < course.limits[j, 0] and abs(velocity[j]) < course.limits[j, 1]):
                return i, TOO_FAR
    return samples, RUNNING
