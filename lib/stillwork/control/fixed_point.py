"""The controller of Fig. 1 and its run on a plant with one coordinate."""

import warnings
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.bounds import one_of
from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.adaptation_loop import EXTEND, HOLD, INTEGRATIONS, SKIP, Law
from stillwork.control.controlled_run import (
    ControlledRun,
    close_loop,
    make_course,
    require_disturbance,
    require_noise,
)
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.mechanism import Mechanism
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import Transformation, warn_outside_contraction
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    Filter,
    UnscentedKalman,
    require_sample_time,
)
from stillwork.estimation.filter_step import Packed
from stillwork.estimation.filtering import model_of
from stillwork.estimation.plant import Plant, force_slope, partial_derivatives

LOSSES = ("predict", "hold")  # what stands for a sample that is lost
LONGEST_TURN = 0.3  # rad of free motion a sample, up to which an Euler step stands for the plant


@by_value
@dataclass(frozen=True)
class Controller:
    """The controller, from the measurement to the force.

    Attributes
    ----------
    signal_filter : Filter
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

    signal_filter: Filter
    transformation: Transformation
    kinematics: KinematicDesign
    model: Plant | Mechanism

    def __post_init__(self):
        check_fields(self)
        if self.kinematics.order != 2:
            raise InputError(
                f"kinematics has order {self.kinematics.order}; the loop drives second-order plants: use 2"
            )


@checked(missing=True)
def simulate(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    noise: ArrayLike | None = None,
    *,
    resolution: float = 0.0,
    grid: float = 0.0,
    integration: Annotated[str, one_of(INTEGRATIONS)] = "exact",
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
    shape = trajectory.position.shape
    noise = require_noise(noise, shape)[None]
    require_sample_time(controller.signal_filter, trajectory.sample_time)
    start = (trajectory.position[0], trajectory.velocity[0]) if start is None else start
    start = require_array("start", start, shape=(2,))
    warn_outside_contraction(controller.transformation, response_gain(plant, controller.model))
    if integration != "exact":
        by_position, by_velocity, _ = partial_derivatives(plant, float(start[0]), float(start[1]), 0.0)
        warn_long_steps(max(abs(by_position) ** 0.5, abs(by_velocity)), trajectory.sample_time)
    disturbance = require_disturbance(disturbance, shape)[None]
    course = make_course(plant, [trajectory], noise, disturbance, change, bound)._replace(
        resolutions=np.array([require_number("resolution", resolution, at_least=0)]),
        grids=np.array([float(grid)]),
        integration=INTEGRATIONS.index(integration),
    )
    limit = np.inf if force_limit is None else require_number("force_limit", force_limit, above=0)
    law = fixed_point_law([controller], np.array([limit]), lost)
    law = law._replace(force_from_estimate=bool(force_from_estimate))
    filters = packed_filters([controller])
    runs, _ = close_loop(filters, law, controller.model, plant, course, start[:, None], [trajectory])
    return runs[0]


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
def packed_filters(controllers: list[Controller]) -> tuple:
    """Filters of coordinates side by side, each array with a row for every one, and their model."""
    packed = [each.signal_filter.packed() for each in controllers]
    rows = (np.array(each) for each in zip(*(one[1:] for one in packed), strict=True))
    return Packed(packed[0].kind, *rows), model_of(controllers[0].signal_filter)


@checked
def fixed_point_law(controllers: list[Controller], force_limits: np.ndarray, lost: str) -> Law:
    """What the loop takes of the controllers, beside filters and model."""
    first = controllers[0].signal_filter
    predicts = isinstance(first, UnscentedKalman | ExtendedKalman)
    loss = HOLD if require_choice("lost", lost, LOSSES) == "hold" else SKIP if predicts else EXTEND
    return Law(
        loss,
        bool(first.error_from_measurement),
        False,
        np.array([each.kinematics.gains for each in controllers]),
        np.array([each.transformation.packed for each in controllers]),
        force_limits,
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, 0)),
    )
