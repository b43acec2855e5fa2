"""Adaptive control of a mechanism that is linear in its parameters, by Slotine and Li."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.adaptation_loop import EXTEND, Law
from stillwork.control.controlled_run import (
    ControlledRun,
    close_loop,
    joint_start,
    make_course,
    require_disturbance,
    require_noise,
)
from stillwork.control.kinematics import KinematicDesign
from stillwork.control.mechanism import Mechanism
from stillwork.control.regressor import regressor_at
from stillwork.control.trajectory import Trajectory
from stillwork.estimation.coordinate_filters import LowPass, MovingWindow, SavitzkyGolay, require_sample_time
from stillwork.estimation.filter_step import Packed
from stillwork.estimation.filtering import model_of


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
            regressor_at(model, place, -place, -place, 1.0 + place) @ model.parameters,
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
    start = joint_start(trajectories, count, start)
    shape = count, len(trajectories[0].position)
    require_sample_time(law.signal_filter, trajectories[0].sample_time)
    noise, disturbance = require_noise(noise, shape), require_disturbance(disturbance, shape)
    course = make_course(plant, trajectories, noise, disturbance, change, bound)
    device = law.signal_filter.packed()
    options, process, sensor, work = (np.array([each] * count) for each in device[1:])
    filters = Packed(device.kind, options, process, sensor, work), model_of(law.signal_filter)
    parts = Law(
        EXTEND,
        True,
        False,
        np.array([law.kinematics.gains] * count),
        np.zeros((count, 4)),
        np.full(count, np.inf),
        np.asarray(law.feedback),
        np.asarray(law.adaptation),
        np.eye(np.size(law.model.parameters)),
    )
    return AdaptiveRun(*close_loop(filters, parts, law.model, plant, course, start, trajectories))
