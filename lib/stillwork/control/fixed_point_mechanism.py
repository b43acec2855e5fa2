"""The controller's loop on a plant with several coordinates: each has its own filter, (1) and (6) or (8)."""

import warnings
from dataclasses import replace
from functools import partial
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.bounds import one_of
from stillwork.base.checks import InputError, require_array, require_number
from stillwork.base.validation import checked
from stillwork.control.adaptation_loop import INTEGRATIONS
from stillwork.control.controlled_run import (
    ControlledRun,
    close_loop,
    joint_start,
    make_course,
    require_disturbance,
    require_noise,
)
from stillwork.control.fixed_point import Controller, fixed_point_law, packed_filters, warn_long_steps
from stillwork.control.mechanism import Mechanism, iteration_radius, response_gains
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import ContractionWarning, warn_outside_contraction
from stillwork.estimation.coordinate_filters import require_sample_time
from stillwork.estimation.plant import slope


@checked(missing=True)
def simulate_mechanism(
    plant: Mechanism,
    controller: Controller | list[Controller],
    trajectories: list[Trajectory],
    noise: ArrayLike | None = None,
    *,
    resolution: ArrayLike = 0.0,
    grid: ArrayLike = 0.0,
    integration: Annotated[str, one_of(INTEGRATIONS)] = "exact",
    start: ArrayLike | None = None,
    bound: float = 10.0,
    lost: str = "predict",
    force_limits: ArrayLike | None = None,
    disturbance: ArrayLike | None = None,
    change: tuple[float, ArrayLike] | None = None,
) -> list[ControlledRun]:
    """Drive a plant with several coordinates along one trajectory each; `control.simulate` is for a single coordinate.

    Filter, (1) and the transformation work in each coordinate separately; the models couple them. A Kalman filter's
    plant is driven by its coordinate's deformed acceleration, which the approximate model commands: give the
    filter `estimation.filtering.UNIT_MASS`.

    Parameters
    ----------
    plant : Mechanism
        The exact model.
    controller : Controller or list of Controller
        One for all coordinates, or one for each, where a coordinate in m and one in rad need different numbers: of the
        transformation, of the kinematics and of a filter of one kind. Its `model` is a Mechanism.
    trajectories : list of Trajectory
        One for each coordinate, of one length and sample time.
    noise : array_like, shape (coordinates, samples), optional
        Added to the measured positions; NaN where a sample is lost.
    resolution, grid : array_like, shape () or (coordinates,)
        Encoders, as in `control.simulate`; one for all, or one for each.
    integration : str
        As in `control.simulate`.
    start : array_like, shape (2, coordinates), optional
        Initial positions and velocities; by default on the trajectories.
    bound : float
        As in `control.simulate`, for each coordinate.
    lost : str
        ``predict`` or ``hold``, as in `control.simulate`.
    force_limits : array_like, shape (coordinates,), optional
        Largest force or torque of each actuator. Where one is at its limit nothing is integrated in that coordinate, and
        the deformed accelerations are set back to what the limited forces command of the approximate model.
    disturbance : array_like, shape (coordinates, samples), optional
    change : tuple of float and array_like, optional
        As in `control.simulate`.

    Returns
    -------
    list of ControlledRun
        One for each coordinate, all with the same `diverged_at` and `cause`.

    Raises
    ------
    InputError
        When models, trajectories, noise or limits do not fit together; the message names them.

    Warns
    -----
    ContractionWarning
        When the transformation cannot contract even with perfect measurements.
    IntegrationWarning
        As from `control.simulate`, of the free motion around the start.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control,
    (1), (6) and (8).

    Examples
    --------
    >>> def inertia(position, parameters, out):
    ...     out[0, 0], out[1, 1], out[0, 1], out[1, 0] = parameters[0], parameters[0], 0.0, 0.0
    >>> def bias(position, velocity, parameters, out):
    ...     out[0], out[1] = 0.0, 9.81 * parameters[0]
    >>> load, guess = (control.Mechanism(inertia, bias, 2, [mass]) for mass in (3.0, 2.5))
    >>> parts = estimation.LowPass(), control.FlowTransformation(-3.0, 30.0), control.KinematicDesign(10.0), guess
    >>> sine = control.asin_trajectory(amplitude=0.1, sharpness=0.5, duration=1.0)
    >>> along, up = control.simulate_mechanism(load, control.Controller(*parts), [sine, sine])
    >>> bool(np.abs(along.position_error).max() < 2e-3 and np.abs(up.position_error).max() < 2e-2)  # m
    True
    """
    count = plant.coordinates
    controllers = list(controller) if isinstance(controller, list) else [controller] * count
    require_alike(controllers, count)
    controller = controllers[0]
    model = controller.model
    if not isinstance(model, Mechanism):
        raise InputError(
            "the controller's model is a Plant; give it a Mechanism, or drive the plant with simulate"
        )
    start = joint_start(trajectories, count, start)
    shape = count, len(trajectories[0].position)
    for each in controllers:
        require_sample_time(each.signal_filter, trajectories[0].sample_time)
    forces = np.full(count, np.inf)
    if force_limits is not None:
        forces = require_array("force_limits", force_limits, shape=(count,))
        if np.any(forces <= 0):
            raise InputError(f"force_limits is {forces}; give numbers above 0")
    _warn_outside_convergence(plant, controllers, start[0])
    if integration != "exact":
        warn_long_steps(_fastest_rate(plant, start), trajectories[0].sample_time)
    noise, disturbance = require_noise(noise, shape), require_disturbance(disturbance, shape)
    course = make_course(plant, trajectories, noise, disturbance, change, bound)._replace(
        resolutions=_one_each("resolution", resolution, count),
        grids=_one_each("grid", grid, count),
        integration=INTEGRATIONS.index(integration),
    )
    for value in course.resolutions:
        require_number("resolution", value, at_least=0)
    law = fixed_point_law(controllers, forces, lost)
    runs, _ = close_loop(packed_filters(controllers), law, model, plant, course, start, trajectories)
    return runs


def _one_each(name: str, values: ArrayLike, count: int) -> np.ndarray:
    values = require_array(name, values)
    if values.shape not in ((), (count,)):
        raise InputError(
            f"{name} has shape {values.shape}; give one number, or one for each of {count} coordinates"
        )
    return np.resize(values, count)


def _warn_outside_convergence(plant, controllers, position) -> None:
    model = controllers[0].model
    gains = [controller.transformation.local_gain for controller in controllers]
    if len(set(gains)) == 1:
        warn_outside_contraction(controllers[0].transformation, response_gains(plant, model, position)[-1])
    elif (radius := iteration_radius(plant, model, position, gains)) > 1 + 1e-9:  # 1 where a gain is 0
        warnings.warn(
            f"with the local gains {', '.join(f'{gain:.4g}' for gain in gains)} the iteration has a spectral radius of {radius:.4g} "
            "where it starts; it will not converge: lower the gains",
            ContractionWarning,
            stacklevel=5,
        )


def _fastest_rate(plant, start) -> float:
    """Largest eigenvalue of the free motion around a start, 1/s."""
    state, n = start.ravel(), plant.coordinates

    def acceleration(value, k):
        moved = state.copy()
        moved[k] = value
        return plant.acceleration(moved[:n], moved[n:], np.zeros(n))

    slopes = [slope(partial(acceleration, k=k), float(state[k])) for k in range(2 * n)]
    motion = np.vstack([np.eye(n, 2 * n, n), np.transpose(slopes)])
    return float(np.abs(np.linalg.eigvals(motion)).max())


# What a filter of one coordinate has in its unit, or for it: controllers side by side may differ in these.
OF_COORDINATE = (
    "bandwidth",
    "process",
    "noise",
    "initial_variance",
    "disturbance_step",
    "noise_deviation",
    "velocity_step",
    "initial_deviation",
)


def _alike_filters(one, other) -> bool:
    if type(one) is not type(other):
        return one == other
    return (
        replace(one, **{name: getattr(other, name) for name in OF_COORDINATE if hasattr(one, name)}) == other
    )


@checked
def require_alike(controllers: list[Controller], count: int) -> None:
    """Refuse controllers of `count` coordinates that differ in more than numbers of filter, transformation and kinematics."""
    alike = len(controllers) == count and all(
        _alike_filters(controller.signal_filter, controllers[0].signal_filter)
        and controller.model == controllers[0].model
        and controller.kinematics.integrals == controllers[0].kinematics.integrals
        for controller in controllers
    )
    if not alike:
        raise InputError(
            f"controller holds {len(controllers)}; give one, or one for each of {count} coordinates, with the same kind of filter, "
            "model and number of integrals"
        )
