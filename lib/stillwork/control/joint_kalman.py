"""An extended Kalman filter over all coordinates of a mechanism together, with a disturbance of each."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array
from stillwork.base.kernels import borrowing_kernel
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.mechanism import Mechanism, forward_dynamics
from stillwork.estimation.extended import JACOBIAN, OBSERVATION, correct_extended, predict_extended
from stillwork.estimation.filter_step import Packed
from stillwork.estimation.gaussian import BLOCKS, COVARIANCE, ESTIMATE, EXPECTED, MEANS, MEASURED, PAST

JOINT = 5  # beside the filters of one coordinate


@by_value
@dataclass(frozen=True)
class JointKalman:
    """The extended Kalman filter with disturbance states of a whole mechanism, measured by its positions alone.

    The state is [velocities, positions, disturbances], the disturbances random walks of the accelerations. Where
    `ExtendedKalman` of each coordinate uses the commanded acceleration, this one has the coupled model and the forces.

    Attributes
    ----------
    model : Mechanism
        Model of the filter.
    disturbance_step : array_like, shape () or (coordinates,)
        Standard deviation of a disturbance's change in one sample, m/s^2 or rad/s^2: one for all, or one for each.
    noise_deviation : array_like, shape () or (coordinates,)
        Standard deviation of a measured position, m or rad.
    velocity_step : array_like, shape () or (coordinates,)
        Standard deviation of other changes of a velocity in one sample, m/s or rad/s.
    initial_deviation : array_like, shape (3,) or (3, coordinates)
        Standard deviations of positions, velocities and disturbances at the first measurement.

    Raises
    ------
    InputError
        When a deviation or step is negative, or there is not one for each coordinate.

    References
    ----------
    Anderson and Moore, Optimal Filtering (1979), chapter 8.

    Examples
    --------
    >>> def inertia(position, parameters, out):
    ...     out[:] = parameters[0] * np.eye(2)
    >>> def bias(position, velocity, parameters, out):
    ...     out[:] = 0.0, 9.81 * parameters[0]
    >>> load = control.Mechanism(inertia, bias, 2, [3.0])
    >>> control.JointKalman(load, noise_deviation=[1e-3, 2e-3]).packed().noise.diagonal()  # m^2
    array([1.e-06, 4.e-06])
    """

    model: Mechanism
    disturbance_step: ArrayLike = 1.0
    noise_deviation: ArrayLike = 1e-4
    velocity_step: ArrayLike = 0.0
    initial_deviation: ArrayLike = (1e-2, 1.0, 10.0)
    error_from_measurement = False

    def __post_init__(self):
        check_fields(self)
        count = self.model.coordinates
        for name, shape in (
            ("disturbance_step", (count,)),
            ("noise_deviation", (count,)),
            ("velocity_step", (count,)),
            ("initial_deviation", (3, count)),
        ):
            values = require_array(name, getattr(self, name))
            if values.shape not in (shape, shape[:-1]):
                raise InputError(
                    f"{name} has shape {values.shape}; give shape {shape[:-1]}, or {shape} for {count} coordinates"
                )
            least = np.min(values, initial=np.inf)
            if least < 0 or (name == "noise_deviation" and least == 0):
                above = "positive numbers" if name == "noise_deviation" else "standard deviations"
                raise InputError(f"{name} holds {least:g}; give {above}")
            spread = np.broadcast_to(values[..., None] if values.ndim < len(shape) else values, shape)
            object.__setattr__(self, name, spread.copy())

    @checked
    def packed(self) -> Packed:
        """What the kernels take.

        Returns
        -------
        Packed
            For the kernel of `simulate_mechanism`.

        Examples
        --------
        >>> def inertia(position, parameters, out):
        ...     out[:] = parameters[0] * np.eye(2)
        >>> def bias(position, velocity, parameters, out):
        ...     out[:] = 0.0, 0.0
        >>> control.JointKalman(control.Mechanism(inertia, bias, 2, [3.0])).packed().process.shape
        (6, 6)
        """
        count = self.model.coordinates
        steps = np.concatenate([self.velocity_step, np.zeros(count), self.disturbance_step])
        work = np.zeros((BLOCKS, max(5, 3 * count), 3 * count))
        noise = np.diag(np.square(self.noise_deviation))
        return Packed(JOINT, np.square(self.initial_deviation).ravel(), np.diag(steps**2), noise, work)


@borrowing_kernel
def joint_extended_step(device, inertia, bias, plant, sample_time, measured, force, estimate, room):
    """One sample of all coordinates; NaN is a missing measurement. `room`: workspace, (2 n + 5, n).

    Central differences over a millionth of an estimate or of its deviation, as of one coordinate.
    """
    _, options, process, noise, work = device
    n = len(measured)
    means, jacobian, covariance = work[MEANS], work[JACOBIAN], work[COVARIANCE]
    speed, place, change, aside, dynamics = room[0], room[1], room[2], room[3], room[4:]
    if means[PAST, 0] == 0.0:
        means[PAST, 0] = 1.0
        for i in range(n):
            means[ESTIMATE, i] = estimate[i, 1]
            means[ESTIMATE, n + i] = measured[i] - sample_time * estimate[i, 1]
            for kind in range(3):
                at = (1 - kind if kind < 2 else kind) * n + i  # the options begin with the position
                covariance[at, at] = options[kind * n + i]
    for i in range(n):
        speed[i], place[i] = means[ESTIMATE, i], means[ESTIMATE, n + i]
    for k in range(3 * n):
        for i in range(3 * n):
            jacobian[i, k] = 1.0 if i == k else 0.0
    for k in range(2 * n):
        state = speed if k < n else place
        at = k if k < n else k - n
        held = state[at]
        step = 1e-6 * max(abs(held), max(0.0, covariance[k, k]) ** 0.5)
        if step > 0.0:
            state[at] = held + step
            if not forward_dynamics(inertia, bias, plant, place, speed, force, dynamics, change):
                return False
            state[at] = held - step
            if not forward_dynamics(inertia, bias, plant, place, speed, force, dynamics, aside):
                return False
            state[at] = held
            for i in range(n):
                jacobian[i, k] += sample_time * (change[i] - aside[i]) / (2.0 * step)
    for i in range(n):
        jacobian[i, 2 * n + i] = sample_time
        for k in range(3 * n):
            jacobian[n + i, k] += sample_time * jacobian[i, k]
    if not forward_dynamics(inertia, bias, plant, place, speed, force, dynamics, change):
        return False
    for i in range(n):
        means[ESTIMATE, i] += sample_time * (change[i] + means[ESTIMATE, 2 * n + i])
        means[ESTIMATE, n + i] += sample_time * means[ESTIMATE, i]
    predict_extended(work, process, 3 * n)
    seen = 0
    for i in range(n):
        if not np.isnan(measured[i]):
            means[MEASURED, seen], means[EXPECTED, seen] = measured[i], means[ESTIMATE, n + i]
            for k in range(3 * n):
                work[OBSERVATION, seen, k] = 1.0 if k == n + i else 0.0
            seen += 1
    if seen > 0 and not correct_extended(work, noise, 3 * n, seen):
        return False
    for i in range(n):
        speed[i], place[i] = means[ESTIMATE, i], means[ESTIMATE, n + i]
    if not forward_dynamics(inertia, bias, plant, place, speed, force, dynamics, change):
        return False
    for i in range(n):
        estimate[i, 0], estimate[i, 1] = place[i], speed[i]
        estimate[i, 2] = change[i] + means[ESTIMATE, 2 * n + i]
    return True
