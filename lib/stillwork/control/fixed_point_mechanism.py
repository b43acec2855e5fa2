"""The controller's loop on a plant with several coordinates: each has its own filter, (1) and (6) or (8)."""

import warnings
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.algebra import copy_vector
from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.base.kernels import borrowing_kernel
from stillwork.base.validation import checked
from stillwork.control.fixed_point import (
    COLUMNS,
    DEFORMED,
    EXACT,
    INTEGRATIONS,
    MEASURED,
    NO_INERTIA,
    NOT_DEFINITE,
    NOT_FINITE,
    RUNNING,
    SEEN,
    SEMI_IMPLICIT,
    TOO_FAR,
    ControlledRun,
    Controller,
    command_step,
    ending,
    joint_motion,
    measure_position,
    packed_parts,
    plants_along,
    record_sample,
    require_disturbance,
    require_noise,
    warn_long_steps,
)
from stillwork.control.held_force import HELD_ROWS, move_mechanism_held
from stillwork.control.joint_kalman import JOINT, JointKalman, joint_extended_step
from stillwork.control.mechanism import (
    Mechanism,
    forward_dynamics,
    inverse_dynamics,
    iteration_radius,
    response_gains,
)
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import ContractionWarning, warn_outside_contraction
from stillwork.estimation.coordinate_filters import require_sample_time
from stillwork.estimation.filter_step import Packed, filter_step
from stillwork.estimation.filtering import UNIT_MASS, model_of
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
    integration: str = "exact",
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
    filter `estimation.filtering.UNIT_MASS`. `JointKalman` filters all coordinates together, with the forces.

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
    nominal, start, limits = joint_motion(trajectories, count, start, bound)
    samples = nominal.shape[-1]
    for each in controllers:
        sample_time = require_sample_time(each.signal_filter, trajectories[0].sample_time)
    noise = require_noise(noise, (count, samples))
    require_choice("integration", integration, INTEGRATIONS)
    forces = np.full(count, np.inf)
    if force_limits is not None:
        forces = require_array("force_limits", force_limits, shape=(count,))
        if np.any(forces <= 0):
            raise InputError(f"force_limits is {forces}; give numbers above 0")
    _warn_outside_convergence(plant, controllers, start[0])
    if integration != "exact":
        warn_long_steps(_fastest_rate(plant, start), sample_time)
    encoders = []
    for name, values in (("resolution", resolution), ("grid", grid)):
        values = require_array(name, values)
        if values.shape not in ((), (count,)):
            raise InputError(
                f"{name} has shape {values.shape}; give one number, or one for each of {count} coordinates"
            )
        encoders.append(np.resize(values, count))
    for value in encoders[0]:
        require_number("resolution", value, at_least=0)
    packed = [
        packed_parts(each, *encoder, lost)
        for each, encoder in zip(controllers, zip(*encoders, strict=True), strict=True)
    ]
    parts = (
        packed[0][0],
        np.array([each[1] for each in packed]),
        np.array([each[2] for each in packed]),
        *encoders,
        packed[0][3][2],
    )
    record = np.full((count, len(COLUMNS), samples), np.nan)
    believed, own_model = model, (UNIT_MASS.compiled[0], UNIT_MASS.parameters)
    if not isinstance(controller.signal_filter, JointKalman):
        own_model = model_of(controller.signal_filter)
    else:
        believed = controller.signal_filter.model
        if believed.coordinates != count:
            raise InputError(
                f"the filter's model has {believed.coordinates} coordinates; give one of {count}"
            )
    done, status = _closed_mechanism(
        packed_filters(controllers),
        *believed.compiled,
        *own_model,
        parts,
        *plant.compiled[:2],
        *plants_along(plant.parameters, change, sample_time),
        require_disturbance(disturbance, (count, samples)),
        *model.compiled,
        sample_time,
        nominal,
        noise,
        forces,
        INTEGRATIONS.index(integration),
        np.array(start),
        np.vstack([start, nominal[:, 2, 0]]).T.copy(),  # rows in one piece, as for one coordinate
        np.zeros((count, len(controller.kinematics.gains) - 1)),
        np.zeros((count, 4)),
        np.zeros((2 * count + 12 + HELD_ROWS, count)),
        limits,
        record,
    )
    ended = ending(status, done * sample_time, "a coordinate left its bound")
    return [
        ControlledRun(trajectory, *rows, **ended)
        for trajectory, rows in zip(trajectories, record, strict=True)
    ]


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
    if isinstance(one, JointKalman) or type(one) is not type(other):
        return one == other
    return (
        replace(one, **{name: getattr(other, name) for name in OF_COORDINATE if hasattr(one, name)}) == other
    )


@checked
def packed_filters(controllers: list[Controller]) -> Packed:
    """Filters of coordinates side by side, each array with a row for every one; of a `JointKalman` one row."""
    first = controllers[0].signal_filter
    filters = (
        [first]
        if isinstance(first, JointKalman)
        else [controller.signal_filter for controller in controllers]
    )
    packed = [each.packed() for each in filters]
    return Packed(
        packed[0].kind, *(np.array(rows) for rows in zip(*(each[1:] for each in packed), strict=True))
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


@borrowing_kernel
def _closed_mechanism(
    device,
    believed_inertia,
    believed_bias,
    believed_plant,
    filter_acceleration,
    filter_plant,
    parts,
    inertia,
    bias,
    plants,
    changed,
    disturbance,
    model_inertia,
    model_bias,
    model,
    sample_time,
    nominal,
    noise,
    force_limits,
    integration,
    motion,
    estimate,
    chain,
    memory,
    work,
    limits,
    record,
):
    """Fill `record` (coordinates x COLUMNS x samples); returns the samples done and how it ended."""
    count, samples = noise.shape
    kind, options, process, sensor, works = device
    from_measurement, transformations, gains, resolutions, grids, loss = parts
    position, velocity = motion[0], motion[1]
    force, acceleration, deformed, seen, speed, held = work[0], work[1], work[2], work[3], work[4], work[5]
    acting, rows, work, length = work[6], work[7 : 7 + HELD_ROWS], work[7 + HELD_ROWS :], sample_time
    measured = rows[0]
    for i in range(samples):
        plant = plants[0] if i < changed else plants[1]
        for j in range(count):
            measurement = resolutions[j], grids[j], loss
            measured[j] = measure_position(
                measurement, position[j], noise[j, i], sample_time, estimate[j, 1], memory[j, MEASURED]
            )
            if kind != JOINT:
                own = Packed(kind, options[j], process[j], sensor[j], works[j])
                if not filter_step(
                    own, filter_acceleration, filter_plant, sample_time, measured[j], deformed[j], estimate[j]
                ):
                    return i, NOT_DEFINITE
        if kind == JOINT and not joint_extended_step(
            options[0],
            process[0],
            sensor[0],
            works[0],
            believed_inertia,
            believed_bias,
            believed_plant,
            sample_time,
            measured,
            force,
            estimate,
            work,
        ):
            return i, NOT_DEFINITE
        for j in range(count):
            now = nominal[j, 0, i], nominal[j, 1, i], nominal[j, 2, i]
            command_step(
                (from_measurement, transformations[j], gains[j], (resolutions[j], grids[j], loss)),
                sample_time,
                now,
                measured[j],
                i == 0,
                held[j] > 0.0,
                chain[j],
                estimate[j],
                memory[j],
            )
            seen[j], deformed[j], speed[j] = memory[j, SEEN], memory[j, DEFORMED], estimate[j, 1]
        inverse_dynamics(model_inertia, model_bias, model, seen, speed, deformed, work, force)
        limited = False
        for j in range(count):
            if not np.isfinite(force[j]):
                return i, NOT_FINITE
            held[j] = 0.0
            if abs(force[j]) > force_limits[j]:
                force[j] = np.copysign(force_limits[j], force[j])
                held[j], limited = 1.0, True
        if limited:
            if not forward_dynamics(model_inertia, model_bias, model, seen, speed, force, work, deformed):
                return i, NO_INERTIA
            copy_vector(deformed, memory[:, DEFORMED])
        for j in range(count):
            acting[j] = force[j] + disturbance[j, i]
        if not forward_dynamics(inertia, bias, plant, position, velocity, acting, work, acceleration):
            return i, NO_INERTIA
        for j in range(count):
            record_sample(
                record[j], i, position[j], velocity[j], acceleration[j], estimate[j], memory[j], force[j]
            )
        if integration == EXACT:
            length = move_mechanism_held(
                inertia, bias, plant, position, velocity, acting, sample_time, length, work, rows
            )
            if length == 0.0:
                return i, NO_INERTIA
        for j in range(count):
            if integration != EXACT:
                before = velocity[j]
                velocity[j] += sample_time * acceleration[j]
                position[j] += sample_time * (velocity[j] if integration == SEMI_IMPLICIT else before)
            if not (abs(position[j]) < limits[j, 0] and abs(velocity[j]) < limits[j, 1]):
                return i, TOO_FAR
    return samples, RUNNING
