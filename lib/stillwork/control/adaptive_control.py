"""Adaptive control of a mechanism that is linear in its parameters, by Slotine and Li."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array
from stillwork.base.kernels import borrowing_kernel
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.fixed_point import (
    COLUMNS,
    DEFORMED,
    DESIRED,
    MEASURED,
    NO_INERTIA,
    NOT_FINITE,
    RUNNING,
    TOO_FAR,
    ControlledRun,
    ending,
    joint_motion,
    measure_position,
    plants_along,
    record_sample,
    require_disturbance,
    require_noise,
)
from stillwork.control.held_force import HELD_ROWS, move_mechanism_held
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.mechanism import Mechanism, forward_dynamics
from stillwork.control.trajectory import Trajectory
from stillwork.estimation.coordinate_filters import LowPass, MovingWindow, SavitzkyGolay, require_sample_time
from stillwork.estimation.filter_step import Packed, filter_step
from stillwork.estimation.filtering import UNIT_MASS

ROOM = 6  # vectors that `fill_regressor` uses, beside the inertia


@borrowing_kernel
def fill_regressor(inertia, bias, units, position, velocity, reference, acceleration, room, out):
    """out[:, j]: M_j acceleration + C_j(velocity) reference + g_j + friction_j(velocity) of a mechanism's j-th parameter.

    units: a row for each parameter, 1 at it. What is even in the velocity is weight and C(v) v, and C(v) w of Christoffel's
    symbols, symmetric in v and w, follows from it: ((v + w)^2 - (v - w)^2) / 4. What is odd is friction. `room`: workspace, (n + ROOM, n).
    """
    n = len(position)
    matrix, speed, there, back, part = room[:n], room[n], room[n + 1], room[n + 2], room[n + 3]
    for j in range(len(units)):
        inertia(position, units[j], matrix)
        for i in range(n):
            part[i], speed[i] = 0.0, 0.0
            for k in range(n):
                part[i] += matrix[i, k] * acceleration[k]
        bias(position, speed, units[j], there)  # weight
        for i in range(n):
            part[i] += there[i]
        for sign in (1.0, -1.0, 0.0):  # v + w, v - w, v
            for i in range(n):
                speed[i] = velocity[i] + sign * reference[i]
            bias(position, speed, units[j], there)
            for i in range(n):
                speed[i] = -speed[i]
            bias(position, speed, units[j], back)
            for i in range(n):
                if sign == 0.0:
                    part[i] += (there[i] - back[i]) / 2.0
                else:
                    part[i] += sign * (there[i] + back[i]) / 8.0
        for i in range(n):
            out[i, j] = part[i]


@checked
def regressor(
    mechanism: Mechanism,
    position: ArrayLike,
    velocity: ArrayLike,
    reference: ArrayLike,
    acceleration: ArrayLike,
) -> Float64[np.ndarray, "coordinates parameters"]:
    """Y of M(q) a + C(q, v) w + g(q) + friction(v) = Y p, a column for each parameter of a mechanism that is linear in them.

    Parameters
    ----------
    mechanism : Mechanism
        Linear in its parameters p; friction is the part odd in the velocity.
    position, velocity, reference, acceleration : array_like, shape (coordinates,)
        q, v, w and a; with w = v the result is the force for the acceleration a. C is that of Christoffel's symbols: M' - 2 C is skew.

    Returns
    -------
    ndarray, shape (coordinates, parameters)

    Raises
    ------
    InputError
        When there is not one of each for every coordinate.

    References
    ----------
    Slotine and Li, Applied Nonlinear Control (1991), section 9.2.

    Examples
    --------
    >>> def inertia(position, parameters, out):
    ...     out[:] = parameters[0]
    >>> def bias(position, velocity, parameters, out):
    ...     out[:] = parameters[1] * velocity
    >>> cart = control.Mechanism(inertia, bias, 1, [2.0, 0.5])  # kg, N s/m
    >>> control.regressor(cart, [0.0], [3.0], [3.0], [1.0])
    array([[1., 3.]])
    """
    n = mechanism.coordinates
    given = [
        require_array(name, each, shape=(n,))
        for name, each in (
            ("position", position),
            ("velocity", velocity),
            ("reference", reference),
            ("acceleration", acceleration),
        )
    ]
    return _regressor(mechanism, *map(np.ascontiguousarray, given))


def _regressor(mechanism, *motion):
    n, count = mechanism.coordinates, len(mechanism.parameters)
    out = np.zeros((n, count))
    fill_regressor(*mechanism.compiled[:2], np.eye(count), *motion, np.zeros((n + ROOM, n)), out)
    return out


@by_value
@dataclass(frozen=True)
class SlotineLi:
    """Slotine and Li's law: u = Y(q, q', w, w') p + K s with s = w - q', and p' = Gamma Y' s.

    w = q'_N + 2 Lambda e + Lambda^2 int e with one integral, q'_N + Lambda e without. With a true model of this form and true
    measurements s' M s / 2 + (p - p_true)' Gamma^-1 (p - p_true) / 2 falls at the rate s' K s.

    Attributes
    ----------
    signal_filter : LowPass, MovingWindow or SavitzkyGolay
        Estimates the velocity of every measured coordinate.
    kinematics : KinematicDesign
        Of order 1: the decay of the error when s = 0.
    model : Mechanism
        Linear in its parameters, which are the initial estimate; friction is the part odd in the velocity.
    feedback : array_like, shape (coordinates,)
        K, N s/m or N m s.
    adaptation : array_like, shape (parameters,)
        Gamma; 0 does not adapt a parameter.

    Raises
    ------
    InputError
        When the model is not linear in its parameters, or sizes do not fit.

    References
    ----------
    Slotine and Li, On the adaptive control of robot manipulators, Int. J. Robotics Research 6(3), 1987.

    Examples
    --------
    >>> def inertia(position, parameters, out):
    ...     out[:] = parameters[0]
    >>> def bias(position, velocity, parameters, out):
    ...     out[:] = parameters[1] * velocity
    >>> guess = control.Mechanism(inertia, bias, 1, [2.0, 0.5])
    >>> law = control.SlotineLi(estimation.LowPass(), control.KinematicDesign(10.0, order=1), guess, [20.0], [1.0, 1.0])
    >>> law.adaptation
    array([1., 1.])
    """

    signal_filter: LowPass | MovingWindow | SavitzkyGolay
    kinematics: KinematicDesign
    model: Mechanism
    feedback: ArrayLike
    adaptation: ArrayLike

    def __post_init__(self):
        check_fields(self)
        model = self.model
        for name, count in (("feedback", model.coordinates), ("adaptation", len(model.parameters))):
            values = require_array(name, getattr(self, name), shape=(count,))
            if np.any(values < 0):
                raise InputError(f"{name} holds a negative number; give gains of at least 0")
            object.__setattr__(self, name, np.ascontiguousarray(values))
        if self.kinematics.order != 1:
            raise InputError(f"kinematics has order {self.kinematics.order}; s is a velocity: use 1")
        place = np.linspace(0.3, 0.7, model.coordinates)
        force = model.force(place, -place, 1.0 + place)
        if not np.allclose(
            _regressor(model, place, -place, -place, 1.0 + place) @ model.parameters,
            force,
            rtol=1e-6,
            atol=1e-9 * np.abs(force).max(),
        ):
            raise InputError(
                "model is not linear in its parameters; give lumped ones, such as the mass times the square of a length"
            )


@by_value
@dataclass(frozen=True)
class AdaptiveRun:
    """A simulated run: the coordinates, of which `desired` and `deformed` are w', and the parameters."""

    coordinates: list[ControlledRun]
    parameters: Float64[np.ndarray, "parameters samples"]


@checked(missing=True)
def simulate_adaptive(
    plant: Mechanism,
    law: SlotineLi,
    trajectories: list[Trajectory],
    noise: ArrayLike | None = None,
    *,
    start: ArrayLike | None = None,
    bound: float = 10.0,
    disturbance: ArrayLike | None = None,
    change: tuple[float, ArrayLike] | None = None,
) -> AdaptiveRun:
    """Drive a mechanism by Slotine and Li's law, the force held for a sample, as `simulate_mechanism` does by fixed points.

    Parameters
    ----------
    plant : Mechanism
        The exact model.
    law : SlotineLi
    trajectories : list of Trajectory
        One for each coordinate, of one length and sample time.
    noise : array_like, shape (coordinates, samples), optional
        Added to the measured positions; NaN where a sample is lost.
    start : array_like, shape (2, coordinates), optional
        Initial positions and velocities; by default on the trajectories.
    bound : float
        A position or velocity beyond `bound` times the trajectory's largest (at least 1) counts as diverged.
    disturbance : array_like, shape (coordinates, samples), optional
        Forces beside the commanded ones, each held for a sample.
    change : tuple of float and array_like, optional
        Time in s from which the plant has these parameters instead.

    Returns
    -------
    AdaptiveRun

    Raises
    ------
    InputError
        When models, trajectories or noise do not fit together.

    References
    ----------
    Slotine and Li, On the adaptive control of robot manipulators, Int. J. Robotics Research 6(3), 1987.

    Examples
    --------
    >>> def inertia(position, parameters, out):
    ...     out[0, 0] = parameters[0]
    >>> def bias(position, velocity, parameters, out):
    ...     out[0] = parameters[1] * velocity[0]
    >>> cart, guess = (control.Mechanism(inertia, bias, 1, [mass, 0.5]) for mass in (3.0, 2.0))
    >>> design = estimation.LowPass(), control.KinematicDesign(10.0, order=1)
    >>> law = control.SlotineLi(*design, guess, [60.0], [20.0, 20.0])
    >>> sine = control.asin_trajectory(amplitude=0.1, sharpness=0.5, duration=5.0)
    >>> run = control.simulate_adaptive(cart, law, [sine])
    >>> bool(np.abs(run.coordinates[0].position_error[-1000:]).max() < 1e-3)  # m
    True
    """
    count = plant.coordinates
    if law.model.coordinates != count:
        raise InputError(f"law has a model of {law.model.coordinates} coordinates; give one of {count}")
    nominal, start, limits = joint_motion(trajectories, count, start, bound)
    samples = nominal.shape[-1]
    sample_time = require_sample_time(law.signal_filter, trajectories[0].sample_time)
    noise = require_noise(noise, (count, samples))
    guess = np.array(law.model.parameters, dtype=float)
    parameters = len(guess)
    record = np.full((count, len(COLUMNS), samples), np.nan)
    history = np.full((parameters, samples), np.nan)
    device = law.signal_filter.packed()
    stand_in, _, nothing = UNIT_MASS.compiled
    done, status = _adaptive_loop(
        device,
        np.tile(device.work, (count, 1, 1, 1)),
        stand_in,
        nothing,
        (law.kinematics.gains, law.feedback, law.adaptation, guess),
        *law.model.compiled[:2],
        np.eye(parameters),
        *plant.compiled[:2],
        *plants_along(plant.parameters, change, sample_time),
        require_disturbance(disturbance, (count, samples)),
        sample_time,
        nominal,
        noise,
        np.array(start),
        np.vstack([start, nominal[:, 2, 0]]).T.copy(),
        (np.zeros((count, len(law.kinematics.gains))), np.zeros((count, 4)), np.zeros((count, parameters))),
        np.zeros((2 * count + 5 + ROOM + HELD_ROWS, count)),
        limits,
        record,
        history,
    )
    ended = ending(status, done * sample_time, "a coordinate left its bound")
    runs = [ControlledRun(each, *rows, **ended) for each, rows in zip(trajectories, record, strict=True)]
    return AdaptiveRun(runs, history)


@borrowing_kernel
def _adaptive_loop(
    device,
    devices_work,
    filter_acceleration,
    filter_plant,
    law,
    model_inertia,
    model_bias,
    units,
    inertia,
    bias,
    plants,
    changed,
    disturbance,
    sample_time,
    nominal,
    noise,
    motion,
    estimate,
    state,
    work,
    limits,
    record,
    history,
):
    """Fill `record` (coordinates x COLUMNS x samples) and `history`; returns the samples done and how it ended."""
    n, samples = noise.shape
    kind, options, process, sensor, _ = device
    gains, feedback, adaptation, parameters = law
    chain, memory, columns = state
    position, velocity = motion[0], motion[1]
    seen, speed, reference, wanted, sliding = work[0], work[1], work[2], work[3], work[4]
    force, acceleration = work[5], work[6]
    rows, room = work[7 : 7 + HELD_ROWS], work[7 + HELD_ROWS :]
    integrals, length = len(gains) - 1, sample_time
    for i in range(samples):
        plant = plants[0] if i < changed else plants[1]
        for j in range(n):
            measured = measure_position(
                (0.0, 0.0, 1), position[j], noise[j, i], sample_time, estimate[j, 1], memory[j, MEASURED]
            )
            own = Packed(kind, options, process, sensor, devices_work[j])
            filter_step(own, filter_acceleration, filter_plant, sample_time, measured, 0.0, estimate[j])
            chain[j, 0] = nominal[j, 0, i] - measured
            slip = nominal[j, 1, i] - estimate[j, 1]
            reference[j] = nominal[j, 1, i] + gains[integrals] * chain[j, 0]
            wanted[j] = nominal[j, 2, i] + gains[integrals] * slip
            for k in range(1, integrals + 1):
                chain[j, k] += sample_time * chain[j, k - 1]
                reference[j] += gains[integrals - k] * chain[j, k]
                wanted[j] += gains[integrals - k] * chain[j, k - 1]
            seen[j], speed[j], sliding[j] = measured, estimate[j, 1], reference[j] - estimate[j, 1]
            memory[j, MEASURED], memory[j, DESIRED], memory[j, DEFORMED] = measured, wanted[j], wanted[j]
        fill_regressor(model_inertia, model_bias, units, seen, speed, reference, wanted, room, columns)
        for j in range(n):
            force[j] = feedback[j] * sliding[j]
            for k in range(len(parameters)):
                force[j] += columns[j, k] * parameters[k]
            if not np.isfinite(force[j]):
                return i, NOT_FINITE
        for k in range(len(parameters)):
            history[k, i] = parameters[k]
            for j in range(n):
                parameters[k] += sample_time * adaptation[k] * columns[j, k] * sliding[j]
        for j in range(n):
            seen[j] = force[j] + disturbance[j, i]  # what acts
        if not forward_dynamics(inertia, bias, plant, position, velocity, seen, room, acceleration):
            return i, NO_INERTIA
        for j in range(n):
            record_sample(
                record[j], i, position[j], velocity[j], acceleration[j], estimate[j], memory[j], force[j]
            )
        length = move_mechanism_held(
            inertia, bias, plant, position, velocity, seen, sample_time, length, room, rows
        )
        if length == 0.0:
            return i, NO_INERTIA
        for j in range(n):
            if not (abs(position[j]) < limits[j, 0] and abs(velocity[j]) < limits[j, 1]):
                return i, TOO_FAR
    return samples, RUNNING
