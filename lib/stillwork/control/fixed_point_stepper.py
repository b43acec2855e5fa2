"""The controller's loop one sample at a time, for use with hardware."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import checked, user_callback
from stillwork.control.fixed_point import (
    DEFORMED,
    EXTEND,
    HOLD,
    MEASURED,
    SEEN,
    Controller,
    command_step,
    packed_parts,
)
from stillwork.control.fixed_point_mechanism import packed_filters, require_alike
from stillwork.control.joint_kalman import JOINT, JointKalman, joint_extended_step
from stillwork.control.mechanism import Mechanism
from stillwork.estimation.coordinate_filters import require_sample_time
from stillwork.estimation.filter_step import Packed, filter_step
from stillwork.estimation.filtering import model_of


class FixedPointStepper:
    """A `Controller` from the measurement to the force, with the same numbers as the simulation.

    Parameters
    ----------
    controller : Controller or list of Controller
        As in `control.simulate` for a model that is a Plant, as in `control.simulate_mechanism` for a Mechanism.
    sample_time : float
        s.
    start : array_like, shape (2, coordinates), optional
        Positions and velocities that the filters assume before the first sample; by default the nominal ones.
    force_limits : array_like, shape (coordinates,), optional
        Largest force or torque of each actuator. At its limit nothing is integrated, and the deformed accelerations are
        set back to what the limited forces command of the model.
    lost : str
        ``predict`` or ``hold``: how a lost sample is replaced, as in `control.simulate`.
    force_from_estimate : bool
        As in `control.simulate`; for a model that is a Plant.

    Attributes
    ----------
    estimate : ndarray, shape (coordinates, 3)
        Position, velocity and acceleration of each coordinate.
    deformed : ndarray, shape (coordinates,)
        Acceleration commanded of the model, m/s^2 or rad/s^2.
    samples : int
        Number of samples so far.

    Raises
    ------
    InputError
        When controllers, limits and start do not fit together.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control,
    Fig. 1.

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> parts = estimation.LowPass(), control.FlowTransformation(), control.KinematicDesign(10.0), slide
    >>> stepper = control.FixedPointStepper(control.Controller(*parts), sample_time=1e-3, force_limits=[5.0])
    >>> stepper.step([[0.0], [0.0], [1.0]], measured=[0.0]).round(3)  # N, for 1 m/s^2 of 2 kg
    array([2.])
    >>> stepper.step([[0.0], [0.0], [1.0]], measured=[np.nan]).shape  # a lost sample
    (1,)
    """

    @checked
    def __init__(
        self,
        controller: Controller | list[Controller],
        sample_time: float,
        start: ArrayLike | None = None,
        *,
        force_limits: ArrayLike | None = None,
        lost: str = "predict",
        force_from_estimate: bool = False,
    ):
        first = controller[0] if isinstance(controller, list) else controller
        self.model = first.model
        count = self.model.coordinates if isinstance(self.model, Mechanism) else 1
        controllers = list(controller) if isinstance(controller, list) else [controller] * count
        require_alike(controllers, count)
        for each in controllers:
            self.sample_time = require_sample_time(each.signal_filter, sample_time)
        self.force_limits = np.full(count, np.inf)
        if force_limits is not None:
            self.force_limits = require_array("force_limits", force_limits, shape=(count,))
            if np.any(self.force_limits <= 0):
                raise InputError(f"force_limits is {self.force_limits}; give numbers above 0")
        self._start = None if start is None else require_array("start", start, shape=(2, count))
        own, self._filters = first.signal_filter, packed_filters(controllers)
        if not isinstance(own, JointKalman):
            self._filter_model: tuple = model_of(own)
        elif isinstance(self.model, Mechanism) and own.model.coordinates == count:
            self._filter_model = own.model.compiled
        else:
            raise InputError(
                f"controller filters by a JointKalman of {own.model.coordinates} coordinates; give one of its model's, "
                "which is a Mechanism"
            )
        self._parts = [packed_parts(each, 0.0, 0.0, lost) for each in controllers]
        self._from_estimate = force_from_estimate
        self.samples = 0
        self._state: tuple[np.ndarray, ...] = (
            self._filters.work,
            np.zeros((count, 3)),
            np.zeros((count, len(first.kinematics.gains) - 1)),
            np.zeros((count, 4)),
            np.zeros(count),  # what pushes the filters
            np.zeros(count, bool),  # whether a force is at its limit
        )

    @property
    def estimate(self) -> Float64[np.ndarray, "coordinates 3"]:
        return self._state[1].copy()

    @property
    def deformed(self) -> Float64[np.ndarray, " coordinates"]:
        return self._state[3][:, DEFORMED].copy()

    @checked
    def step(self, nominal: ArrayLike, measured: ArrayLike) -> Float64[np.ndarray, " coordinates"]:
        """Force until the next sample; after an exception the state is unchanged.

        Parameters
        ----------
        nominal : array_like, shape (3, coordinates)
            Desired position, velocity and acceleration.
        measured : array_like, shape (coordinates,)
            Positions; NaN where a sample is lost, but not in the first.

        Returns
        -------
        ndarray, shape (coordinates,)
            N or N m.

        Raises
        ------
        InputError
            For numbers that do not fit, a filter whose covariance is no longer positive definite, or a force, or an
            acceleration under it, that is not finite.

        Examples
        --------
        >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
        >>> parts = estimation.LowPass(), control.FlowTransformation(), control.KinematicDesign(10.0), slide
        >>> stepper = control.FixedPointStepper(control.Controller(*parts), sample_time=1e-3)
        >>> stepper.step([[0.0], [0.0], [1.0]], measured=[0.0]).round(3)
        array([2.])
        """
        count = len(self.force_limits)
        nominal = require_array("nominal", nominal, shape=(3, count))
        measured = require_array("measured", measured, shape=(count,), missing=True)
        first = self.samples == 0
        if first and np.isnan(measured).any():
            raise InputError("measured is NaN at the first sample; start with one that was measured")
        kind, options, process, sensor, _ = self._filters
        state = tuple(part.copy() for part in self._state)
        works, estimate, chain, memory, push, held = state
        if first:
            estimate[:, :2] = nominal[:2].T if self._start is None else self._start.T
            estimate[:, 2] = nominal[2]
        measured = measured.copy()
        for j in np.flatnonzero(np.isnan(measured)):
            loss = self._parts[j][3][2]
            if loss in (HOLD, EXTEND):
                measured[j] = memory[j, MEASURED] + (
                    self.sample_time * estimate[j, 1] if loss == EXTEND else 0.0
                )
        definite = True
        if kind == JOINT:
            numbers = options[0], process[0], sensor[0], works[0], *self._filter_model
            room = np.zeros((2 * count + 5, count))
            definite = joint_extended_step(*numbers, self.sample_time, measured, push, estimate, room)
        else:
            for j in range(count):
                device = Packed(kind, options[j], process[j], sensor[j], works[j])
                numbers = self.sample_time, measured[j], push[j], estimate[j]
                definite = definite and filter_step(device, *self._filter_model, *numbers)
        if not definite:
            raise InputError("the filter's covariance is no longer positive definite; raise process or noise")
        for j, parts in enumerate(self._parts):
            wanted = tuple(nominal[:, j])
            command_step(
                parts, self.sample_time, wanted, measured[j], first, held[j], chain[j], estimate[j], memory[j]
            )
        place = estimate[:, 0] if self._from_estimate else memory[:, SEEN]
        force = self._force(place, estimate[:, 1], memory[:, DEFORMED])
        if not np.isfinite(force).all():
            raise InputError("the commanded force is not finite; check the model, and what was measured")
        held[:] = np.abs(force) > self.force_limits
        if held.any():
            force = np.clip(force, -self.force_limits, self.force_limits)
            memory[:, DEFORMED] = self._acceleration(place, estimate[:, 1], force)
            if not np.isfinite(memory[:, DEFORMED]).all():  # it would stay so
                raise InputError("the model's acceleration under the limited force is not finite; check it")
        push[:] = force if kind == JOINT or not isinstance(self.model, Mechanism) else memory[:, DEFORMED]
        self._state = state
        self.samples += 1
        return force

    def _force(self, position, velocity, acceleration) -> np.ndarray:
        model = self.model
        if isinstance(model, Mechanism):
            return model.force(position.copy(), velocity.copy(), acceleration.copy())
        numbers = float(position[0]), float(velocity[0]), float(acceleration[0])
        return np.array([user_callback(model.force)(*numbers, model.parameters)])

    def _acceleration(self, position, velocity, force) -> np.ndarray:
        model = self.model
        if isinstance(model, Mechanism):
            return model.acceleration(position.copy(), velocity.copy(), force)
        numbers = float(position[0]), float(velocity[0]), float(force[0])
        return np.array([user_callback(model.acceleration)(*numbers, model.parameters)])
