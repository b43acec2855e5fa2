"""The controller's loop, Fig. 1: measure, filter, desire, deform, push, move; one kernel for every filter."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.base.front_door import check_fields, checked
from stillwork.base.kernels import kernel
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import Transformation, deform_packed, warn_outside_contraction
from stillwork.estimation.coordinate_filters import Filter, require_step
from stillwork.estimation.filtering import filter_step, model_of
from stillwork.estimation.plant import Plant, force_slope

INTEGRATIONS = ("semi-implicit", "explicit")
COLUMNS = (
    "position",
    "velocity",
    "acceleration",
    "measured",
    "position_estimate",
    "velocity_estimate",
    "acceleration_estimate",
    "desired",
    "deformed",
    "force",
)
RUNNING, TOO_FAR, NOT_FINITE, NOT_DEFINITE = range(4)


@dataclass(frozen=True)
class Controller:
    """What stands between the measurement and the force.

    Attributes
    ----------
    signal_filter : Filter
        Makes position, velocity and acceleration of the noisy coordinate.
    transformation : Transformation
        (6) or (8).
    kinematics : KinematicDesign
        (1).
    model : Plant
        The approximate model, which turns the deformed acceleration into a force.

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> parts = estimation.LowPass(), control.FlowTransformation(), control.KinematicDesign(10.0), slide
    >>> control.Controller(*parts).kinematics.exponent  # 1/s
    10.0
    """

    signal_filter: Filter
    transformation: Transformation
    kinematics: KinematicDesign
    model: Plant

    def __post_init__(self):
        check_fields(self)
        if self.kinematics.order != 2:
            raise InputError(
                f"kinematics has order {self.kinematics.order}; the loop drives second-order plants: use 2"
            )


@dataclass(frozen=True)
class ControlledRun:
    """One simulated run; all arrays of shape (samples,), NaN after a divergence."""

    trajectory: Trajectory
    position: Float64[np.ndarray, " samples"]  # m, true
    velocity: Float64[np.ndarray, " samples"]  # m/s, true
    acceleration: Float64[np.ndarray, " samples"]  # m/s^2, true, over the coming step
    measured: Float64[np.ndarray, " samples"]  # m
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


@checked(missing=True)
def simulate(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    noise: ArrayLike | None = None,
    *,
    resolution: float = 0.0,
    grid: float = 0.0,
    integration: str = "semi-implicit",
    start: tuple[float, float] | ArrayLike | None = None,
    bound: float = 10.0,
) -> ControlledRun:
    """Drive `plant` along `trajectory`.

    In every sample: measure; filter; desired acceleration (1); deformed acceleration by the transformation,
    equal to the desired one at first; force from the approximate model; acceleration of the plant.

    Parameters
    ----------
    plant : Plant
        The exact model.
    controller : Controller
        Filter, transformation, kinematics and approximate model. Where the filter says
        `error_from_measurement`, the error and the force use the measured position, else the estimated one.
    trajectory : Trajectory
        Nominal motion.
    noise : array_like, shape (samples,), optional
        Added to the position when it is measured, m.
    resolution : float
        Step of an encoder that rounds the measured position, m; 0 without one.
    grid : float
        Where a line of the encoder stands, m.
    integration : str
        ``semi-implicit`` moves the position with the new velocity, ``explicit`` with the old one.
    start : array_like, shape (2,), optional
        Initial position and velocity; by default on the trajectory.
    bound : float
        A position or velocity beyond `bound` times the trajectory's largest (at least 1) counts as diverged.

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

    References
    ----------
    Equations (1), (6) and (8) of the fixed-point work.

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> parts = estimation.LowPass(), control.FlowTransformation(), control.KinematicDesign(10.0), slide
    >>> sine = control.asin_trajectory(amplitude=0.1, sharpness=0.5, duration=1.0)
    >>> run = control.simulate(slide, control.Controller(*parts), sine)
    >>> bool(np.abs(run.position_error).max() < 1e-3)  # m
    True
    """
    samples = len(trajectory.position)
    noise = np.zeros(samples) if noise is None else require_array("noise", noise, shape=(samples,))
    require_number("resolution", resolution, at_least=0)
    require_number("grid", grid)
    require_number("bound", bound, above=1)
    require_choice("integration", integration, INTEGRATIONS)
    require_step(controller.signal_filter, trajectory.time_step)
    start = (trajectory.position[0], trajectory.velocity[0]) if start is None else start
    start = require_array("start", start, shape=(2,))
    warn_outside_contraction(controller.transformation, response_gain(plant, controller.model))
    limits = [bound * max(1.0, np.abs(x).max()) for x in (trajectory.position, trajectory.velocity)]
    record = np.full((len(COLUMNS), samples), np.nan)
    done, status = _closed_loop(
        controller.signal_filter.packed(),
        *model_of(controller.signal_filter),
        bool(controller.signal_filter.error_from_measurement),
        controller.transformation.packed,
        controller.kinematics.gains,
        plant.compiled[0],
        plant.parameters,
        controller.model.compiled[1],
        controller.model.parameters,
        trajectory.time_step,
        (trajectory.position, trajectory.velocity, trajectory.acceleration),
        (noise, float(resolution), float(grid)),
        integration == "semi-implicit",
        start,
        np.array(limits),
        record,
    )
    found: dict[str, Any] = dict(zip(COLUMNS, record, strict=True))
    if status != RUNNING:
        causes = {
            TOO_FAR: f"the plant left the bound of {limits[0]:g} m and {limits[1]:g} m/s",
            NOT_FINITE: "the commanded force is not finite",
            NOT_DEFINITE: "the filter's covariance is no longer positive definite",
        }
        found |= {"diverged_at": float(done * trajectory.time_step), "cause": causes[status]}
    return ControlledRun(trajectory, **found)


@checked
def response_gain(plant: Plant, model: Plant) -> float:
    """f': acceleration realised per acceleration commanded through an imperfect model, at rest."""
    return force_slope(plant, 0.0, 0.0, 0.0) / force_slope(model, 0.0, 0.0, 0.0)


@kernel
def _closed_loop(
    device,
    filter_acceleration,
    filter_plant,
    error_from_measurement,
    transformation,
    gains,
    plant_acceleration,
    plant,
    model_force,
    model,
    time_step,
    nominal,
    measurement,
    semi_implicit,
    start,
    limits,
    record,
):
    """Fill `record` (COLUMNS x samples); returns the samples done and how it ended."""
    (nominal_position, nominal_velocity, nominal_acceleration), (noise, resolution, grid) = (
        nominal,
        measurement,
    )
    integrals = len(gains) - 2
    chain = np.zeros(integrals + 1)  # chain[j]: j-fold integral of the error
    estimate = np.array([start[0], start[1], nominal_acceleration[0]])
    position, velocity = start[0], start[1]
    force, deformed = 0.0, 0.0
    for i in range(len(nominal_position)):
        measured = position + noise[i]
        if resolution > 0.0:
            measured = np.round((measured - grid) / resolution) * resolution + grid
        if not filter_step(device, filter_acceleration, filter_plant, time_step, measured, force, estimate):
            return i, NOT_DEFINITE
        seen = measured if error_from_measurement else estimate[0]
        chain[0] = nominal_position[i] - seen
        desired = nominal_acceleration[i] + gains[integrals + 1] * (nominal_velocity[i] - estimate[1])
        desired += gains[integrals] * chain[0]
        for j in range(1, integrals + 1):
            chain[j] += time_step * chain[j - 1]
            desired += gains[integrals - j] * chain[j]
        deformed = desired if i == 0 else deform_packed(transformation, deformed, estimate[2], desired)
        force = model_force(seen, estimate[1], deformed, model)
        if not np.isfinite(force):
            return i, NOT_FINITE
        acceleration = plant_acceleration(position, velocity, force, plant)
        record[0, i] = position
        record[1, i] = velocity
        record[2, i] = acceleration
        record[3, i] = measured
        record[4, i] = estimate[0]
        record[5, i] = estimate[1]
        record[6, i] = estimate[2]
        record[7, i] = desired
        record[8, i] = deformed
        record[9, i] = force
        before = velocity
        velocity += time_step * acceleration
        position += time_step * (velocity if semi_implicit else before)
        if not (abs(position) < limits[0] and abs(velocity) < limits[1]):
            return i, TOO_FAR
    return len(nominal_position), RUNNING
