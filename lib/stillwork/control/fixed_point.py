"""The controller's loop, Fig. 1: measure, filter, desired and deformed acceleration, force, motion; one kernel for every filter."""

import warnings
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.base.kernels import borrowing_kernel, inlined_kernel
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.held_force import move_held
from stillwork.control.joint_kalman import JointKalman
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.mechanism import Mechanism
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import Transformation, deform_packed, warn_outside_contraction
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    Filter,
    UnscentedKalman,
    require_sample_time,
)
from stillwork.estimation.filter_step import filter_step
from stillwork.estimation.filtering import model_of
from stillwork.estimation.plant import Plant, force_slope, partial_derivatives

INTEGRATIONS = ("exact", "semi-implicit", "explicit")
EXACT, SEMI_IMPLICIT, EXPLICIT = range(3)
LOSSES = ("predict", "hold")  # what stands for a sample that is lost
LONGEST_TURN = 0.3  # rad of free motion a sample, up to which an Euler step stands for the plant
RUNNING, TOO_FAR, NOT_FINITE, NOT_DEFINITE, NO_INERTIA = range(5)
HOLD, EXTEND, SKIP = range(3)  # of a lost sample
SEEN, MEASURED, DESIRED, DEFORMED = range(4)  # what a coordinate's `memory` holds
CAUSES = {
    NOT_FINITE: "the commanded force is not finite",
    NOT_DEFINITE: "the filter's covariance is no longer positive definite",
    NO_INERTIA: "the inertia of a model is not positive definite",
}


@by_value
@dataclass(frozen=True)
class Controller:
    """The controller, from the measurement to the force.

    Attributes
    ----------
    signal_filter : Filter or JointKalman
        Estimates position, velocity and acceleration of the noisy coordinate, or of all coordinates together.
    transformation : Transformation
        (6) or (8), or a `DisturbanceObserver`.
    kinematics : KinematicDesign
        (1).
    model : Plant or Mechanism
        The approximate model, which turns the deformed acceleration into a force.

    Raises
    ------
    InputError
        When the kinematic design is not of order 2.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control,
    Fig. 1.

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> parts = estimation.LowPass(), control.FlowTransformation(), control.KinematicDesign(10.0), slide
    >>> control.Controller(*parts).kinematics.exponent  # 1/s
    10.0
    """

    signal_filter: Filter | JointKalman
    transformation: Transformation
    kinematics: KinematicDesign
    model: Plant | Mechanism

    def __post_init__(self):
        check_fields(self)
        if self.kinematics.order != 2:
            raise InputError(
                f"kinematics has order {self.kinematics.order}; the loop drives second-order plants: use 2"
            )


@by_value
@dataclass(frozen=True)
class ControlledRun:
    """One coordinate of a simulated run; all arrays of shape (samples,), NaN after a divergence.

    For an angle read rad for m and N m for N.
    """

    trajectory: Trajectory
    position: Float64[np.ndarray, " samples"]  # m, true
    velocity: Float64[np.ndarray, " samples"]  # m/s, true
    acceleration: Float64[np.ndarray, " samples"]  # m/s^2, true, as the coming step begins
    measured: Float64[np.ndarray, " samples"]  # m; what stands for a lost sample, NaN where a filter predicts
    position_estimate: Float64[np.ndarray, " samples"]  # m
    velocity_estimate: Float64[np.ndarray, " samples"]  # m/s
    acceleration_estimate: Float64[np.ndarray, " samples"]  # m/s^2
    desired: Float64[np.ndarray, " samples"]  # m/s^2, (1)
    deformed: Float64[np.ndarray, " samples"]  # m/s^2, (6) or (8)
    force: Float64[np.ndarray, " samples"]  # N
    diverged_at: float | None = None  # s
    cause: str = ""  # of the divergence

    @property
    def time(self) -> Float64[np.ndarray, " samples"]:
        """s."""
        return self.trajectory.time

    @property
    def position_error(self) -> Float64[np.ndarray, " samples"]:
        """Nominal minus true position, m."""
        return self.trajectory.position - self.position

    @property
    def velocity_error(self) -> Float64[np.ndarray, " samples"]:
        """Nominal minus true velocity, m/s."""
        return self.trajectory.velocity - self.velocity


COLUMNS = tuple(field.name for field in fields(ControlledRun)[1:-2])  # the arrays, in the order of a record


@checked(missing=True)
def simulate(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    noise: ArrayLike | None = None,
    *,
    resolution: float = 0.0,
    grid: float = 0.0,
    integration: str = "exact",
    start: tuple[float, float] | ArrayLike | None = None,
    bound: float = 10.0,
    lost: str = "predict",
    force_limit: float | None = None,
    force_from_estimate: bool = False,
    disturbance: ArrayLike | None = None,
    change: tuple[float, ArrayLike] | None = None,
) -> ControlledRun:
    """Drive `plant` along `trajectory`.

    In every sample: measure; filter; desired acceleration (1); deformed acceleration by the transformation,
    equal to the desired one at first; force from the approximate model; acceleration of the plant.

    Parameters
    ----------
    plant : Plant
        The exact model.
    controller : Controller
        Filter, transformation, kinematics and approximate model. If the filter states
        `error_from_measurement`, the error and the force use the measured position, else the estimated one.
    trajectory : Trajectory
        Nominal motion.
    noise : array_like, shape (samples,), optional
        Added to the measured position, m; NaN where a sample is lost.
    resolution : float
        Step of an encoder that rounds the measured position, m; 0: no encoder.
    grid : float
        Position of a line of the encoder, m.
    integration : str
        ``exact``: the motion under a held force, by Runge-Kutta steps with error control. The others are
        one Euler step per sample: ``semi-implicit`` advances the position with the new velocity, ``explicit`` with the old one.
    start : array_like, shape (2,), optional
        Initial position and velocity; by default on the trajectory.
    bound : float
        A position or velocity beyond `bound` times the trajectory's largest (at least 1) counts as diverged.
    lost : str
        ``predict``: where a sample is lost a Kalman filter predicts, and the others get the last measurement extrapolated
        at the estimated velocity; ``hold``: all filters get the last measurement.
    force_limit : float, optional
        Largest force of the actuator, N; by default unlimited. At the limit the error is not integrated, and the deformed
        acceleration is set back to what the limited force commands of the approximate model.
    force_from_estimate : bool
        Compute the force at the filtered position even if the error uses the measured one.
    disturbance : array_like, shape (samples,), optional
        Force on the plant in addition to the commanded one, each held for a sample, N.
    change : tuple of float and array_like, optional
        Time in s from which the plant has these parameters instead, e.g. with a payload. A change of the sensor
        belongs in `noise`.

    Returns
    -------
    ControlledRun
        With `diverged_at` and `cause` when it diverged.

    Raises
    ------
    InputError
        When the noise does not have a sample for each of the trajectory, or an option is unknown.

    Warns
    -----
    ContractionWarning
        When the transformation cannot contract even with perfect measurements.
    IntegrationWarning
        When an Euler step is too long for the plant: from 0.3 rad of its free motion, or its decay, per sample.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control,
    (1), (6) and (8).

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> parts = estimation.LowPass(), control.FlowTransformation(), control.KinematicDesign(10.0), slide
    >>> sine = control.asin_trajectory(amplitude=0.1, sharpness=0.5, duration=1.0)
    >>> run = control.simulate(slide, control.Controller(*parts), sine)
    >>> bool(np.abs(run.position_error).max() < 1e-3)  # m
    True
    """
    if not isinstance(controller.model, Plant):
        raise InputError("the controller's model is a Mechanism; drive one with simulate_mechanism")
    if isinstance(controller.signal_filter, JointKalman):
        raise InputError(
            "the controller's filter is a JointKalman; use ExtendedKalman, or simulate_mechanism"
        )
    samples = len(trajectory.position)
    noise = require_noise(noise, (samples,))
    require_number("grid", grid)
    require_number("bound", bound, above=1)
    require_choice("integration", integration, INTEGRATIONS)
    require_sample_time(controller.signal_filter, trajectory.sample_time)
    start = (trajectory.position[0], trajectory.velocity[0]) if start is None else start
    start = require_array("start", start, shape=(2,))
    warn_outside_contraction(controller.transformation, response_gain(plant, controller.model))
    if integration != "exact":
        by_position, by_velocity, _ = partial_derivatives(plant, float(start[0]), float(start[1]), 0.0)
        warn_long_steps(max(abs(by_position) ** 0.5, abs(by_velocity)), trajectory.sample_time)
    limits = [bound * max(1.0, np.abs(x).max()) for x in (trajectory.position, trajectory.velocity)]
    record = np.full((len(COLUMNS), samples), np.nan)
    done, status = run_closed_loop(
        controller.signal_filter.packed(),
        *model_of(controller.signal_filter),
        packed_parts(controller, resolution, grid, lost),
        bool(force_from_estimate),
        plant.compiled[0],
        *plants_along(plant.parameters, change, trajectory.sample_time),
        require_disturbance(disturbance, (samples,)),
        *controller.model.compiled,
        trajectory.sample_time,
        (trajectory.position, trajectory.velocity, trajectory.acceleration),
        noise,
        np.inf if force_limit is None else require_number("force_limit", force_limit, above=0),
        INTEGRATIONS.index(integration),
        np.array([*start, trajectory.acceleration[0]]),
        np.zeros(len(controller.kinematics.gains) - 1),
        np.zeros(4),
        np.array(limits),
        record,
    )
    left = f"the plant left the bound of {limits[0]:g} in position and {limits[1]:g} in velocity"
    return ControlledRun(trajectory, *record, **ending(status, done * trajectory.sample_time, left))


class IntegrationWarning(UserWarning):
    """One Euler step per sample is too inaccurate for this plant."""


@checked
def warn_long_steps(rate: float, sample_time: float) -> None:
    """Warn if an Euler step per sample is too long for free motion that oscillates or decays at a rate, in 1/s."""
    turn = require_number("rate", rate, at_least=0.0) * require_number("sample_time", sample_time, above=0.0)
    if turn >= LONGEST_TURN:
        warnings.warn(
            f"integration by one Euler step per sample is too coarse: the plant's free motion oscillates or decays by {turn:.2g} "
            "rad in a sample; use integration='exact'",
            IntegrationWarning,
            stacklevel=5,
        )


@checked
def response_gain(plant: Plant, model: Plant) -> float:
    """f': acceleration realised per acceleration commanded through an imperfect model, at rest."""
    return force_slope(plant, 0.0, 0.0, 0.0) / force_slope(model, 0.0, 0.0, 0.0)


@checked
def ending(status: int, time: float, left: str) -> dict[str, Any]:
    """When a run diverged, in s, and why (`left` if the plant left its bounds); empty if it did not."""
    if status == RUNNING:
        return {}
    causes = {TOO_FAR: left, **CAUSES}
    if status not in causes:
        raise InputError(f"status is {status}; give {RUNNING} or one of {', '.join(map(str, causes))}")
    return {"diverged_at": float(time), "cause": causes[status]}


def require_noise(noise: ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray:
    """Noise of this shape, zero where none is given; NaN is a lost sample, and the first one is needed."""
    if not (isinstance(shape, tuple) and shape and shape[-1]):
        raise InputError(f"shape is {shape!r}; give a tuple of sizes, the last one of samples, at least 1")
    if noise is None:
        return np.zeros(shape)
    noise = require_array("noise", noise, shape=shape, missing=True)
    if np.isnan(noise[..., 0]).any():
        raise InputError("noise is NaN at the first sample; start with one that was measured")
    return np.ascontiguousarray(noise)


@checked
def joint_motion(
    trajectories: list[Trajectory], count: int, start: ArrayLike | None, bound: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Desired motion of `count` coordinates (position, velocity and acceleration of each), their start, and the bounds of divergence."""
    alike = {(trajectory.sample_time, len(trajectory.position)) for trajectory in trajectories}
    if len(trajectories) != count or len(alike) != 1:
        raise InputError(
            f"trajectories holds {len(trajectories)}; give one for each of {count} coordinates, of one length and sample time"
        )
    require_number("bound", bound, above=1)
    nominal = np.array([[each.position, each.velocity, each.acceleration] for each in trajectories])
    start = require_array("start", nominal[:, :2, 0].T if start is None else start, shape=(2, count))
    return nominal, start, bound * np.maximum(1.0, np.abs(nominal[:, :2]).max(axis=2))


@checked
def require_disturbance(disturbance: ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray:
    """A disturbance of this shape, zero where none is given."""
    if disturbance is None:
        return np.zeros(shape)
    return np.ascontiguousarray(require_array("disturbance", disturbance, shape=shape))


@checked
def plants_along(
    parameters: np.ndarray, change: tuple[float, ArrayLike] | None, sample_time: Positive
) -> tuple[np.ndarray, int]:
    """Parameters of a plant before and after a change, a row each, and the first sample after it."""
    if change is None:
        return np.array([parameters, parameters]), 0
    after = require_array("change", change[1], shape=parameters.shape)
    begins = require_number("change", change[0], at_least=0.0)
    return np.array([parameters, after]), round(begins / sample_time)


@checked
def packed_parts(controller: Controller, resolution: float, grid: float, lost: str) -> tuple:
    """Arguments of `command_step` beside the filter itself."""
    predicts = isinstance(controller.signal_filter, UnscentedKalman | ExtendedKalman | JointKalman)
    if require_choice("lost", lost, LOSSES) == "hold":
        loss = HOLD
    else:
        loss = SKIP if predicts else EXTEND
    return (
        bool(controller.signal_filter.error_from_measurement),
        controller.transformation.packed,
        controller.kinematics.gains,
        (require_number("resolution", resolution, at_least=0), float(grid), loss),
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
    """Desired and deformed acceleration of one coordinate for one sample, with `packed_parts`.

    held: the force is at its limit, nothing is integrated.
    """
    error_from_measurement, transformation, gains, _ = parts
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
    """One column of the record, in the order of `COLUMNS`."""
    record[0, i] = position
    record[1, i] = velocity
    record[2, i] = acceleration
    record[3, i] = memory[MEASURED]
    record[4, i] = estimate[0]
    record[5, i] = estimate[1]
    record[6, i] = estimate[2]
    record[7, i] = memory[DESIRED]
    record[8, i] = memory[DEFORMED]
    record[9, i] = force


@borrowing_kernel
def run_closed_loop(
    device,
    filter_acceleration,
    filter_plant,
    parts,
    force_from_estimate,
    plant_acceleration,
    plants,
    changed,
    disturbance,
    model_acceleration,
    model_force,
    model,
    sample_time,
    nominal,
    noise,
    force_limit,
    integration,
    estimate,
    chain,
    memory,
    limits,
    record,
):
    """Fill `record` (COLUMNS x samples) from the state in `estimate`; returns the number of samples done and how the run ended."""
    measurement = parts[3]
    positions, velocities, accelerations = nominal
    position, velocity = estimate[0], estimate[1]
    force, held, length = 0.0, False, sample_time
    for i in range(len(noise)):
        plant = plants[0] if i < changed else plants[1]
        now = positions[i], velocities[i], accelerations[i]
        measured = measure_position(
            measurement, position, noise[i], sample_time, estimate[1], memory[MEASURED]
        )
        if not filter_step(device, filter_acceleration, filter_plant, sample_time, measured, force, estimate):
            return i, NOT_DEFINITE
        command_step(parts, sample_time, now, measured, i == 0, held, chain, estimate, memory)
        place = estimate[0] if force_from_estimate else memory[SEEN]
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
        if integration == EXACT:
            position, velocity, length = move_held(
                plant_acceleration, plant, position, velocity, acting, sample_time, length
            )
        else:
            before = velocity
            velocity += sample_time * acceleration
            position += sample_time * (velocity if integration == SEMI_IMPLICIT else before)
        if not (abs(position) < limits[0] and abs(velocity) < limits[1]):
            return i, TOO_FAR
    return len(noise), RUNNING
