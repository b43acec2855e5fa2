"""Filters with one interface: from the noisy coordinate to position, velocity and acceleration.

A filter is a frozen description that packs itself for the kernel in `stillwork.estimation.filter_step`, which
runs over a record or inside the controller's loop.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Count, NonNegative, Positive, at_least
from stillwork.base.checks import InputError, require_array, require_count, require_number
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.estimation.extended import plant_extended_step
from stillwork.estimation.filter_step import (
    EXTENDED,
    LOW_PASS,
    SAVITZKY_GOLAY,
    UNSCENTED,
    WINDOW,
    Packed,
    end_point_weights,
)
from stillwork.estimation.gaussian import BLOCKS, COVARIANCE, require_covariance
from stillwork.estimation.plant import Plant
from stillwork.estimation.unscented import SigmaPoints, plant_unscented_step


def _packed(kind, options, work_shape, process=((),), noise=((),)):
    arrays = [np.ascontiguousarray(value, dtype=np.float64) for value in (options, process, noise)]
    return Packed(kind, *arrays, np.zeros(work_shape))


@by_value
@dataclass(frozen=True)
class MovingWindow:
    """Section II.A: three cascaded affine fits over `length` + 1 samples, read at the newest sample."""

    length: Count = 12  # L of the paper; the window holds L + 1 samples
    error_from_measurement = True  # which position the controller compares with the nominal one

    def __post_init__(self):
        check_fields(self)

    @checked
    def packed(self) -> Packed:
        return _packed(WINDOW, end_point_weights(self.length + 1, 1), (2, 3, self.length + 1))


@by_value
@dataclass(frozen=True)
class LowPass:
    """Section II.B: (bandwidth + d/dt)^3 filtered = bandwidth^3 measured, by Euler's rule.

    Attributes
    ----------
    bandwidth : float
        lambda of (7), rad/s.
    from_zero : bool
        Start from zero regardless of the first measurement; else from the first measurement, at the velocity and acceleration
        assumed then.

    Raises
    ------
    InputError
        When the bandwidth is not positive.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control,
    section II.B.

    Examples
    --------
    >>> held = [estimation.filter_signal(estimation.LowPass(100.0, zero), np.ones(1000)) for zero in (False, True)]
    >>> [each.position[10].round(2) for each in held], [each.position[-1].round(6) for each in held]
    ([np.float64(1.0), np.float64(0.09)], [np.float64(1.0), np.float64(1.0)])
    """

    bandwidth: Positive = 350.0
    from_zero: bool = False
    error_from_measurement = True

    def __post_init__(self):
        check_fields(self)

    @checked
    def packed(self) -> Packed:
        """What the kernels take.

        Returns
        -------
        Packed
            For the kernel of `filter_signal`.

        Examples
        --------
        >>> estimation.LowPass(100.0).packed().options  # rad/s, and whether from zero
        array([100.,   0.])
        """
        return _packed(LOW_PASS, [self.bandwidth, self.from_zero], (1, 1, 4))


@by_value
@dataclass(frozen=True)
class SavitzkyGolay:
    """Least-squares polynomial over the latest samples; its value and derivatives at the newest one."""

    samples: int = 15  # in the window
    degree: Annotated[int, at_least(2)] = 2  # of the polynomial, 2 at least: an acceleration is needed
    sample_time: Positive = 1e-3  # s; the weights of the derivatives depend on it
    error_from_measurement = True

    def __post_init__(self):
        check_fields(self)
        require_count("samples", self.samples, at_least=self.degree + 1)

    @checked
    def packed(self) -> Packed:
        rows = [
            end_point_weights(self.samples, self.degree, order) / self.sample_time**order
            for order in range(3)
        ]
        return _packed(SAVITZKY_GOLAY, np.concatenate(rows), (2, 1, self.samples))


@by_value
@dataclass(frozen=True)
class FilterState:
    """State of a Kalman filter after a sample, from `start` and `step`."""

    estimate: Float64[np.ndarray, "3"]  # position in m, velocity in m/s, acceleration in m/s^2
    work: Float64[np.ndarray, "blocks rows columns"]  # the kernel's: covariance and last measurement

    def __post_init__(self):
        check_fields(self)

    @property
    def covariance(self) -> Float64[np.ndarray, "states states"]:
        """By velocity, position and, in the extended filter, the disturbance; zero before the first measurement."""
        size = self.work.shape[2]
        return self.work[COVARIANCE, :size, :size].copy()


class _KalmanFilter:
    # Both Kalman filters one sample at a time.
    plant: Plant

    def packed(self) -> Packed:
        raise NotImplementedError

    @checked
    def start(self, velocity: float = 0.0) -> FilterState:
        """State before the first sample.

        Parameters
        ----------
        velocity : float
            Presumed then, m/s.

        Returns
        -------
        FilterState
            For `step`.

        Raises
        ------
        InputError
            When the velocity is no number.

        Examples
        --------
        >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
        >>> estimation.UnscentedKalman(slide).start(velocity=1.0).estimate  # m, m/s, m/s^2
        array([0., 1., 0.])
        """
        return FilterState(np.array([0.0, velocity, 0.0]), self.packed().work)

    @checked
    def step(
        self, state: FilterState, measured: ArrayLike, force: float = 0.0, *, sample_time: Positive = 1e-3
    ) -> FilterState:
        """State after one sample; the numbers of `filter_signal`.

        Parameters
        ----------
        state : FilterState
            From `start` or the sample before; it is left as it is.
        measured : float
            Position in m; NaN where it is missing, then the filter predicts.
        force : float
            That acted since the sample before, N.
        sample_time : float
            Since the sample before, s.

        Returns
        -------
        FilterState
            The estimate after it, and what the filter needs for the next.

        Raises
        ------
        InputError
            For a first measurement that is missing, numbers that cannot be used, or a covariance that is no longer
            positive definite.

        Examples
        --------
        >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
        >>> kalman = estimation.UnscentedKalman(slide)
        >>> state = kalman.step(kalman.start(velocity=1.0), 0.001)
        >>> kalman.step(state, np.nan).estimate[:2].round(6)  # a lost sample, a millisecond on: m, m/s
        array([0.002, 1.   ])
        """
        measured = float(require_array("measured", measured, shape=(), missing=True))
        if math.isnan(measured) and not state.work.any():
            raise InputError("measured is NaN at the first sample; start with one that was measured")
        kind, options, process, noise, fresh = self.packed()
        if state.work.shape != fresh.shape:
            raise InputError(f"state is none of {type(self).__name__}; give one of its own start or step")
        advance = plant_unscented_step if kind == UNSCENTED else plant_extended_step
        acceleration, _, parameters = self.plant.compiled
        given = acceleration, parameters, sample_time, measured, force
        estimate, work = state.estimate.copy(), state.work.copy()
        definite = advance(options, process, noise, work, *given, estimate)
        if not (definite and np.isfinite(estimate).all()):
            raise InputError(
                "the covariance stops being positive definite, or the estimate finite; raise process or noise, or check "
                "that the model fits the record"
            )
        return FilterState(estimate, work)


@by_value
@dataclass(frozen=True)
class UnscentedKalman(_KalmanFilter):
    """Section II.C: state [velocity, position], measured as [difference quotient, position].

    Attributes
    ----------
    plant : Plant
        The model that the filter believes in.
    process : array_like, shape (2, 2) or (2,)
        Q, by velocity and position: m^2/s^2 and m^2.
    noise : array_like, shape (2, 2) or (2,)
        R, likewise.
    initial_variance : float
        Variance of both states at the first measurement.
    literal : bool
        Correct with points around the previous estimate, as (14) is printed.
    points : SigmaPoints
        Scaling, Table II.
    model_acceleration : bool
        Give the acceleration of the model at the estimate, not the difference of the velocity estimate.

    Raises
    ------
    InputError
        When a covariance is not positive definite.

    References
    ----------
    Issa, Al-Bkree and Tar, On certain noise filtering techniques in fixed point iteration-based adaptive control,
    section II.C.

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> kalman = estimation.UnscentedKalman(slide)
    >>> state = kalman.start(velocity=1.0)
    >>> for position in (0.001, 0.002, np.nan, 0.004):  # m, each millisecond; one is lost
    ...     state = kalman.step(state, position)
    >>> state.estimate[:2].round(6)  # position and velocity
    array([0.004, 1.   ])
    """

    plant: Plant
    process: ArrayLike = (1e-1, 1e-3)
    noise: ArrayLike = (1e-2, 1e-3)
    initial_variance: Positive = 1e-3
    literal: bool = False
    points: SigmaPoints = field(default_factory=SigmaPoints)
    model_acceleration: bool = False
    error_from_measurement = False

    def __post_init__(self):
        check_fields(self)
        object.__setattr__(self, "process", require_covariance("process", self.process, 2))
        object.__setattr__(self, "noise", require_covariance("noise", self.noise, 2))

    @checked
    def packed(self) -> Packed:
        """What the kernels take.

        Returns
        -------
        Packed
            For the kernel of `filter_signal`.

        Examples
        --------
        >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
        >>> estimation.UnscentedKalman(slide, noise=(1e-2, 1e-6)).packed().noise.diagonal()
        array([1.e-02, 1.e-06])
        """
        options = [*self.points.weights(2), float(self.literal), self.initial_variance]
        options.append(float(self.model_acceleration))
        return _packed(UNSCENTED, options, (BLOCKS, 5, 2), self.process, self.noise)


@by_value
@dataclass(frozen=True)
class ExtendedKalman(_KalmanFilter):
    """Extended Kalman filter with a disturbance state, measured by the position alone.

    Not in the paper. The disturbance is the model's error as an acceleration, a random walk.

    Attributes
    ----------
    plant : Plant
        The model that the filter believes in.
    disturbance_step : float
        Standard deviation of the disturbance's change in one sample, m/s^2.
    noise_deviation : float
        Standard deviation of the measured position, m.
    velocity_step : float
        Standard deviation of other changes of the velocity in one sample, m/s.
    initial_deviation : tuple of float
        Standard deviations of position, velocity and disturbance at the first measurement.

    Raises
    ------
    InputError
        When a deviation or step is negative.

    References
    ----------
    Anderson and Moore, Optimal Filtering (1979), chapter 8.

    Examples
    --------
    >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
    >>> time = 1e-3 * np.arange(2000)  # s
    >>> found = estimation.filter_signal(estimation.ExtendedKalman(slide), time**2)  # an unmodelled force acts
    >>> float(found.acceleration[-1].round(3))  # m/s^2
    2.0
    """

    plant: Plant
    disturbance_step: NonNegative = 1.0
    noise_deviation: Positive = 1e-4
    velocity_step: NonNegative = 0.0
    initial_deviation: tuple[float, float, float] = (1e-2, 1.0, 10.0)
    error_from_measurement = False

    def __post_init__(self):
        check_fields(self)
        require_initial_deviation(self.initial_deviation)

    @checked
    def packed(self) -> Packed:
        """What the kernels take.

        Returns
        -------
        Packed
            For the kernel of `filter_signal`.

        Examples
        --------
        >>> slide = estimation.Plant(lambda q, v, f, p: f / p[0], lambda q, v, a, p: p[0] * a, [2.0])
        >>> estimation.ExtendedKalman(slide, noise_deviation=1e-3).packed().noise.round(9)  # m^2
        array([[1.e-06]])
        """
        process = np.diag([self.velocity_step**2, 0.0, self.disturbance_step**2])
        options = np.square(np.asarray(self.initial_deviation, dtype=float))
        return _packed(EXTENDED, options, (BLOCKS, 5, 3), process, [[self.noise_deviation**2]])


@checked
def require_initial_deviation(deviation: tuple[float, float, float]) -> None:
    """Refuse negative standard deviations of position, velocity and disturbance at the start."""
    if np.any(require_array("initial_deviation", deviation, shape=(3,)) < 0):
        raise InputError("initial_deviation holds a negative number; give standard deviations")


def require_sample_time(signal_filter, sample_time: float) -> float:
    """Return a sample time at which a filter can run, else raise `InputError`."""
    require_number("sample_time", sample_time, above=0)
    own = getattr(signal_filter, "sample_time", sample_time)  # its weights hold one
    if own != sample_time:
        raise InputError(
            f"sample_time is {sample_time:g} s, the filter was made for {own:g} s; use one of them"
        )
    bandwidth = getattr(signal_filter, "bandwidth", 0.0)
    if bandwidth * sample_time >= 2:
        raise InputError(
            f"bandwidth is {bandwidth:g} rad/s; Euler's rule with steps of {sample_time:g} s requires less than "
            f"{2 / sample_time:g} rad/s, or it diverges"
        )
    return float(sample_time)


Filter = MovingWindow | LowPass | SavitzkyGolay | UnscentedKalman | ExtendedKalman
