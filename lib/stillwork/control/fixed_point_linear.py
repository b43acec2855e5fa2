"""The closed loop near an operating point as a linear system, built from formulas, not from the kernels."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Positive, one_of
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import by_value, check_fields, checked, user_callback
from stillwork.control.adaptation_loop import INTEGRATIONS
from stillwork.control.fixed_point import Controller
from stillwork.control.fixed_point_mechanism import require_alike
from stillwork.control.mechanism import Mechanism
from stillwork.control.transformation import DisturbanceObserver
from stillwork.estimation.coordinate_filters import (
    Filter,
    LowPass,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
    require_sample_time,
)
from stillwork.estimation.filter_step import end_point_weights
from stillwork.estimation.plant import Plant, partial_derivatives, slope
from stillwork.estimation.riccati import covariance_root, discrete_gain


@by_value
@dataclass(frozen=True)
class LinearFilter:
    """x+ = A x + B [z, u]; estimate of (position, velocity, acceleration) = C x + D [z, u].

    z is the measured position of this sample, u the force since the last one.
    """

    A: Float64[np.ndarray, "states states"]
    B: Float64[np.ndarray, "states 2"]
    C: Float64[np.ndarray, "3 states"]
    D: Float64[np.ndarray, "3 2"]

    def __post_init__(self):
        check_fields(self)
        if not len(self.A) == self.A.shape[1] == len(self.B) == self.C.shape[1]:
            raise InputError(
                f"A, B, C have shapes {self.A.shape}, {self.B.shape}, {self.C.shape}, which do not fit together"
            )

    @checked(infinite=True)
    def response(self, rate: ArrayLike, sample_time: float) -> np.ndarray:
        """Frequency responses from z to the three estimates at angular frequencies, rad/s, shape (rates, 3)."""
        z = np.exp(1j * np.atleast_1d(require_array("rate", rate)) * sample_time)[:, None, None]
        inputs = np.broadcast_to(self.B[:, :1], (len(z), len(self.A), 1))
        states = np.linalg.solve(z * np.eye(len(self.A)) - self.A, inputs)[..., 0]
        return states @ self.C.T + self.D[:, 0]


@checked
def linear_filter(
    signal_filter: Filter, sample_time: float, position: float = 0.0, velocity: float = 0.0
) -> LinearFilter:
    """A filter near an operating point; for a Kalman filter in its steady state there."""
    require_sample_time(signal_filter, sample_time)
    if isinstance(signal_filter, MovingWindow):
        fit = end_point_weights(signal_filter.length + 1, 1)[::-1]
        rows, row = [], fit
        for _ in range(3):
            rows.append(row)
            row = np.convolve(np.convolve(row, [1 / sample_time, -1 / sample_time]), fit)
        return _finite_impulse_response(rows)
    if isinstance(signal_filter, SavitzkyGolay):
        n, degree = signal_filter.samples, signal_filter.degree
        return _finite_impulse_response(
            [end_point_weights(n, degree, order)[::-1] / sample_time**order for order in range(3)]
        )
    if isinstance(signal_filter, LowPass):
        w = signal_filter.bandwidth
        A = np.eye(3) + sample_time * np.array([[0, 1, 0], [0, 0, 1], [-(w**3), -3 * w**2, -3 * w]])
        B = sample_time * np.array([[0.0, 0.0], [0.0, 0.0], [w**3, 0.0]])
        return LinearFilter(A, B, A, B)
    slopes = _slopes(signal_filter.plant, position, velocity)
    if isinstance(signal_filter, UnscentedKalman):
        return _linear_unscented(signal_filter, slopes, sample_time)
    return _linear_extended(signal_filter, slopes, sample_time)


def _finite_impulse_response(rows) -> LinearFilter:
    length = max(len(row) for row in rows)
    weights = np.array([np.pad(row, (0, length - len(row))) for row in rows])
    A, B = np.eye(length - 1, k=-1), np.zeros((length - 1, 2))
    B[:1, 0] = 1.0
    return LinearFilter(A, B, weights[:, 1:].copy(), np.column_stack([weights[:, 0], np.zeros(3)]))


@checked
def semi_implicit_motion(slopes: tuple[float, ...], sample_time: Positive) -> tuple[np.ndarray, np.ndarray]:
    """F and the column of the force of x = [velocity, position] in the semi-implicit model (10)."""
    by_position, by_velocity, by_force = slopes
    row = np.array([1 + sample_time * by_velocity, sample_time * by_position])
    column = sample_time * by_force * np.array([1.0, sample_time])
    return np.array([row, sample_time * row + [0.0, 1.0]]), column


def _linear_unscented(signal_filter, slopes, sample_time) -> LinearFilter:
    F, push = semi_implicit_motion(slopes, sample_time)
    Q, R = signal_filter.process, signal_filter.noise
    if signal_filter.literal:  # innovation about the previous estimate: z - x, not z - F x
        P = np.eye(2) * signal_filter.initial_variance
        for _ in range(100_000):
            K = P @ np.linalg.inv(P + R)
            last, P = P, F @ P @ F.T + Q - K @ P
            if np.abs(P - last).max() < 1e-15 * np.abs(P).max():
                break
        forward = F - K
    else:
        K = _steady_gain(F, Q, np.eye(2), R)
        forward = (np.eye(2) - K) @ F
        push = (np.eye(2) - K) @ push
    # States: velocity, position, last measurement; the measurement is [(z - last) / dt, z].
    A = np.vstack([np.column_stack([forward, -K[:, 0] / sample_time]), np.zeros(3)])
    B = np.vstack([np.column_stack([K[:, 0] / sample_time + K[:, 1], push]), [1.0, 0.0]])
    now = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1 / sample_time, 0.0, 0.0]])
    by_position, by_velocity, by_force = slopes
    if signal_filter.model_acceleration:
        now[2] = by_velocity, by_position, 0.0
    C, D = now @ A, now @ B
    if signal_filter.model_acceleration:
        D[2, 1] += by_force
    else:
        C[2, 0] -= 1 / sample_time  # acceleration: difference of the velocity estimate
    return LinearFilter(A, B, C, D)


def _linear_extended(signal_filter, slopes, sample_time) -> LinearFilter:
    motion, push = semi_implicit_motion(slopes, sample_time)
    F = np.eye(3)
    F[:2, :2] = motion
    F[:2, 2] = sample_time * np.array([1.0, sample_time])
    H = np.array([[0.0, 1.0, 0.0]])
    packed = signal_filter.packed()
    K = _steady_gain(F, packed.process, H, packed.noise)
    left = np.eye(3) - K @ H
    A = left @ F
    B = np.column_stack([K[:, 0], left @ np.append(push, 0.0)])
    by_position, by_velocity, by_force = slopes
    now = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [by_velocity, by_position, 1.0]])
    D = now @ B
    D[2, 1] += by_force
    return LinearFilter(A, B, now @ A, D)


def _steady_gain(F, Q, H, R) -> np.ndarray:
    gain = discrete_gain(F, covariance_root(Q), H, 1.0, R).filter_gain
    assert gain is not None
    return gain


def _slopes(plant: Plant, position: float, velocity: float):
    """Partial derivatives of the acceleration where it is zero."""
    force = user_callback(plant.force)(position, velocity, 0.0, plant.parameters)
    return partial_derivatives(plant, position, velocity, force)


def _slope_matrices(plant: Plant | Mechanism, position: np.ndarray, velocity: np.ndarray):
    """The same, a matrix each: rows are accelerations."""
    if isinstance(plant, Plant):
        return [np.array([[each]]) for each in _slopes(plant, float(position[0]), float(velocity[0]))]
    point = [position, velocity, plant.force(position, velocity, np.zeros_like(position))]

    def moved(axis, column):
        def acceleration(value):
            each = [part.copy() for part in point]
            each[axis][column] = value
            return plant.acceleration(*each)

        return slope(acceleration, float(point[axis][column]))

    return [np.array([moved(axis, k) for k in range(len(position))]).T for axis in range(3)]


@by_value
@dataclass(frozen=True)
class LinearLoop:
    """The loop cut open at the transformation: x+ = A x + B c, s = C x.

    c is the change of the deformed acceleration, s = response - desired, both in m/s^2: the transformation
    closes the loop with c = local_gain s. The first two states are the true position and velocity. Of several
    coordinates every state, c and s are as many numbers as there are coordinates, side by side.
    """

    A: Float64[np.ndarray, "states states"]
    B: Float64[np.ndarray, "states coordinates"]
    C: Float64[np.ndarray, "coordinates states"]
    sample_time: float  # s

    def __post_init__(self):
        check_fields(self)

    @cached_property
    def _schur(self) -> tuple[np.ndarray, np.ndarray]:
        from scipy.linalg import schur

        return schur(self.A, output="complex")

    @checked(infinite=True)
    def response(self, rate: ArrayLike, row: np.ndarray | None = None) -> np.ndarray:
        """Frequency response from c to s (or to ``row @ x``) at angular frequencies `rate`, rad/s; of one coordinate.

        By back substitution in Schur's form, all frequencies at once.
        """
        z = np.exp(1j * np.atleast_1d(require_array("rate", rate)) * self.sample_time)
        triangular, basis = self._schur
        drive = basis.conj().T @ self.B[:, 0]
        states = np.zeros((len(z), len(drive)), dtype=complex)
        for k in range(len(drive) - 1, -1, -1):
            known = states[:, k + 1 :] @ triangular[k, k + 1 :]
            states[:, k] = (drive[k] + known) / (z - triangular[k, k])
        return states @ (basis.T @ (self.C[0] if row is None else row))

    @checked(infinite=True)
    def radius(self, local_gain: float) -> float:
        """Spectral radius of the closed loop; stable below 1."""
        return float(np.abs(self.poles(local_gain)).max())

    @checked(infinite=True)
    def poles(self, local_gain: float) -> np.ndarray:
        """Eigenvalues of the closed loop."""
        return np.linalg.eigvals(self.A + local_gain * self.B @ self.C)


def _motion(by_position, by_velocity, by_force, sample_time, integration):
    """What a sample makes of [position, velocity] and of the force that is held."""
    from scipy.linalg import expm

    size = len(by_position)
    nothing, one = np.zeros((size, size)), np.eye(size)
    if integration == "exact":
        rates = np.block(
            [[nothing, one, nothing], [by_position, by_velocity, by_force], [nothing, nothing, nothing]]
        )
        moved = expm(sample_time * rates)[: 2 * size]
        return moved[:, : 2 * size], moved[:, 2 * size :]
    speed = np.hstack([sample_time * by_position, one + sample_time * by_velocity])
    force = sample_time * by_force
    place = np.hstack([one, nothing]) + sample_time * speed
    return np.vstack([place, speed]), np.vstack([sample_time * force, force])


@checked
def linear_loop(
    plant: Plant | Mechanism,
    controller: Controller | list[Controller],
    sample_time: float,
    position: ArrayLike = 0.0,
    velocity: ArrayLike = 0.0,
    integration: Annotated[str, one_of(INTEGRATIONS[:2])] = "exact",
) -> LinearLoop:
    """The loop of `simulate` or `simulate_mechanism` near an operating point (m and m/s).

    `integration` is theirs: ``exact``, the plant under a force that is held for a sample, or ``semi-implicit``. Of
    controllers that differ the loop's local gain is that of the first coordinate; those of the others keep their ratio to it.
    """
    count = getattr(plant, "coordinates", 1)
    controllers = list(controller) if isinstance(controller, list) else [controller] * count
    require_alike(controllers, count)
    controller = controllers[0]
    if isinstance(controller.transformation, DisturbanceObserver):
        raise InputError("controller uses a DisturbanceObserver; the linear loop exists for (6) and (8)")
    place, speed = (
        require_array(name, np.atleast_1d(values), shape=(count,))
        for name, values in (("position", position), ("velocity", velocity))
    )
    several = isinstance(plant, Mechanism)
    # For a mechanism the filters assume unit masses, which are the same everywhere.
    at = (0.0, 0.0) if several else (float(place[0]), float(speed[0]))
    devices = [linear_filter(each.signal_filter, sample_time, *at) for each in controllers]
    A, B, C, D = (np.array([getattr(device, name) for device in devices]) for name in "ABCD")
    by_position, by_velocity, by_force = _slope_matrices(plant, place, speed)
    model_position, model_velocity, model_force = _slope_matrices(controller.model, place, speed)
    gains = np.array([each.kinematics.gains for each in controllers]).T
    integrals = controller.kinematics.integrals
    ratios = [each.transformation.local_gain / controller.transformation.local_gain for each in controllers]
    motion, push = _motion(by_position, by_velocity, by_force, sample_time, integration)
    first = 4 + integrals  # position, velocity, deformed, force, integrals, filter
    states = first + A.shape[1]

    def each_of(matrices, columns):  # a matrix and a column for every coordinate
        return np.einsum("jab,bj->aj", matrices, columns)

    def step(x, change):
        inputs = np.array([x[0], x[2 if several else 3]])
        estimate = each_of(C, x[first:]) + each_of(D, inputs)
        seen = x[0] if controller.signal_filter.error_from_measurement else estimate[0]
        chain = [-seen]
        for j in range(integrals):
            chain.append(x[4 + j] + sample_time * chain[j])
        desired = (gains[:-1] * np.array(chain)[::-1]).sum(axis=0) - gains[-1] * estimate[1]
        deformed = x[2] + change
        force = np.linalg.solve(model_force, deformed - model_position @ seen - model_velocity @ estimate[1])
        moved = (motion @ x[:2].ravel() + push @ force).reshape(2, count)
        after = np.array([*moved, deformed, force, *chain[1:]])
        after = np.concatenate([after, each_of(A, x[first:]) + each_of(B, inputs)])
        return after.ravel(), estimate[2] - desired

    size = states * count
    columns = [step(unit.reshape(states, count), np.zeros(count)) for unit in np.eye(size)]
    motions = np.column_stack([column for column, _ in columns])
    pushes = np.column_stack([step(np.zeros((states, count)), unit)[0] for unit in np.diag(ratios)])
    outputs = np.column_stack([output for _, output in columns])
    return LinearLoop(motions, pushes, outputs, float(sample_time))
