"""Setpoints of third and fourth order: jerk or snap is piecewise constant, everything else its exact integral."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Positive, Vector
from stillwork.base.checks import InputError, require_array, require_number, require_samples
from stillwork.base.validation import by_value, check_fields, checked

HALVINGS = 60  # of the largest velocity that a short move reaches: to the last digit of any that matters


@by_value
@dataclass(frozen=True)
class Setpoint:
    """A sampled setpoint; between samples the snap is constant, so every row is exact."""

    sample_time: Positive  # s
    derivatives: Float64[np.ndarray, "5 samples"]  # position, velocity, acceleration, jerk, snap (SI)
    scan: tuple[float, float]  # s, start and end of the scanning phase
    acceleration_end: float  # s, where the constant velocity begins

    @checked
    def __post_init__(self):
        check_fields(self)
        rows = self.derivatives
        # Positions are sums of many steps: allow them the rounding of the longest one.
        backwards = np.diff(rows[0], prepend=rows[0, :1]) < -1e-12 * np.abs(rows[0]).max()
        if np.any(rows[1] < -1e-9 * max(np.abs(rows[1]).max(), 1e-300)) or np.any(backwards):
            raise InputError("derivatives: the setpoint moves backwards; a scan needs a monotone position")
        end = (rows.shape[1] - 1) * self.sample_time
        if not 0 <= self.scan[0] < self.scan[1] <= end * (1 + 1e-9):
            raise InputError(
                f"scan is {self.scan}; give its start and its end in s, within the {end:g} s of the move"
            )

    @property
    def time(self) -> Float64[np.ndarray, " samples"]:
        """Seconds from the start of the move."""
        return np.arange(self.derivatives.shape[1]) * self.sample_time

    @property
    def scanning(self) -> np.ndarray:
        """Mask of the samples in the scanning phase, both ends included."""
        slack = 1e-6 * self.sample_time
        return (self.time >= self.scan[0] - slack) & (self.time <= self.scan[1] + slack)


@checked
def from_snap(
    segments: Vector, durations: ArrayLike, sample_time: Positive
) -> Float64[np.ndarray, "5 samples"]:
    """Position, velocity, acceleration, jerk and snap at every sample, from constant-snap segments."""
    if not len(segments):
        raise InputError("segments is empty; give the snap of at least one segment in m/s^4")
    durations = require_array("durations", durations, shape=segments.shape)
    require_samples("sample_time", float(np.sum(durations / sample_time)))
    counts = np.rint(durations / sample_time).astype(int)
    if np.any(counts < 1) or np.any(np.abs(counts * sample_time - durations) > 1e-9 * durations):
        raise InputError(
            f"durations must be positive multiples of sample_time = {sample_time:g} s; choose one that divides them"
        )
    rows, state = [], np.zeros(4)
    for snap, count in zip(segments, counts, strict=True):
        t = np.arange(count + 1) * sample_time
        whole = np.array([*_integrated(t, state, snap), np.full(count + 1, snap)])
        rows.append(whole[:, :-1])
        state = whole[:4, -1]
    return np.hstack([*rows, np.append(state, 0.0)[:, None]])


def _integrated(t, state, s) -> tuple:
    """Position, velocity, acceleration and jerk a time t after they were `state`, while the snap stays s."""
    p, v, a, j = state
    return (
        p + t * (v + t * (a / 2 + t * (j / 6 + t * s / 24))),
        v + t * (a + t * (j / 2 + t * s / 6)),
        a + t * (j + t * s / 2),
        j + t * s,
    )


@checked
def point_to_point(
    snap: float,
    jerk: float,
    acceleration: float,
    velocity: float,
    cruise: Positive,
    settling: float,
    sample_time: float,
) -> Setpoint:
    """Fourth-order move: accelerate within the limits, cruise, decelerate (Fig. 3.32).

    Segment times follow the usual rules for symmetric fourth-order profiles: the snap segment is the longest
    that no limit forbids, then the jerk plateau, then the acceleration plateau.

    Parameters
    ----------
    snap, jerk, acceleration, velocity : float
        Limits in SI units, all reached where they can be.
    cruise, settling : float
        Length of the constant-velocity phase, and of the settling at its start (s).
    sample_time : float
        Sample time (s).

    Returns
    -------
    Setpoint
        Position and its first four derivatives at every sample.

    Raises
    ------
    InputError
        When a limit is not positive, the settling is longer than the cruise, or `sample_time` does not divide
        the segments.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), Fig. 3.32.

    Examples
    --------
    >>> move = control.point_to_point(1e4, 100.0, 2.0, 0.1, cruise=0.02, settling=0.005, sample_time=1e-3)
    >>> float(move.derivatives[1].max().round(6))  # m/s
    0.1
    """
    require_number("settling", settling, at_least=0.0, below=cruise)
    t_snap, t_jerk, t_acceleration = segment_times(snap, jerk, acceleration, velocity)
    signs, times = [], []
    for sign, plateau, middle in ((1, t_jerk, t_acceleration), (-1, t_jerk, 0.0)):
        signs += [sign, 0, -sign, 0]
        times += [t_snap, plateau, t_snap, middle]
    moving = [(s * snap, t) for s, t in zip(signs, times, strict=True) if t > 1e-12]
    rise = float(sum(t for _, t in moving))
    segments = [*moving, (0.0, cruise), *((-s, t) for s, t in moving)]
    snaps, times = np.array(segments).T
    derivatives = from_snap(snaps, times, sample_time)
    return Setpoint(sample_time, derivatives, (rise + settling, rise + cruise), rise)


@checked
def segment_times(snap: float, jerk: float, acceleration: float, velocity: float) -> tuple[float, ...]:
    """Lengths of the snap, jerk-plateau and acceleration-plateau segments (s)."""
    limits = MoveLimits(velocity, acceleration, jerk, snap)
    t_snap, t_jerk, t_acceleration, _ = _segments(limits, velocity)
    return tuple(0.0 if t < 1e-9 * t_snap else float(t) for t in (t_snap, t_jerk, t_acceleration))


@by_value
@dataclass(frozen=True)
class MoveLimits:
    """Limits of a setpoint.

    Parameters
    ----------
    velocity, acceleration, jerk : float
        In the same unit of length or angle.
    snap : float
        Infinite by default: moves of third order.

    Raises
    ------
    InputError
        When one is not positive.

    Examples
    --------
    >>> control.MoveLimits(velocity=0.2, acceleration=5.0, jerk=500.0).snap
    inf
    """

    velocity: Positive
    acceleration: Positive
    jerk: Positive
    snap: Positive = np.inf

    def __post_init__(self):
        check_fields(self, infinite=("snap",))


def _segments(limits: MoveLimits, top: float) -> tuple[float, float, float, float]:
    """Lengths of the segments from rest to the velocity `top`, and the jerk that they reach."""
    jerk, acceleration, t_snap = limits.jerk, limits.acceleration, 0.0
    if limits.snap < np.inf:
        by_others = min(np.sqrt(acceleration / limits.snap), np.cbrt(top / (2 * limits.snap)))
        t_snap = min(jerk / limits.snap, by_others)
        jerk = limits.snap * t_snap
    # Acceleration limit: jerk (t_snap + t_jerk); velocity limit: that times (2 t_snap + t_jerk).
    by_acceleration = acceleration / jerk - t_snap
    by_velocity = (np.sqrt(t_snap * t_snap + 4 * top / jerk) - 3 * t_snap) / 2
    t_jerk = max(min(by_acceleration, by_velocity), 0.0)
    peak = jerk * (t_snap + t_jerk)
    t_acceleration = max(top / peak - 2 * t_snap - t_jerk, 0.0)
    return float(t_snap), float(t_jerk), float(t_acceleration), float(jerk)


@checked
def largest_of(limits: MoveLimits) -> Float64[np.ndarray, "4"]:
    """Largest velocity, acceleration, jerk and snap of a long move: the values reached, which may be less than the limits."""
    return np.abs(_knots(limits, limits.velocity)[:, 2:]).max(axis=0)


def _knots(limits: MoveLimits, top: float) -> np.ndarray:
    t_snap, t_jerk, t_acceleration, jerk = _segments(limits, top)
    snap = limits.snap if limits.snap < np.inf else 0.0
    lengths = (t_snap, t_jerk, t_snap, t_acceleration, t_snap, t_jerk, t_snap)
    jerks, snaps = (0.0, 1, 1, 0, 0, -1, -1, 0), (1.0, 0, -1, 0, -1, 0, 1, 0)
    knots = np.zeros((8, 6))
    for k in range(8):
        knots[k, 4:] = jerk * jerks[k], snap * snaps[k]
        if k < 7:
            begin, *start, now = knots[k]
            knots[k + 1, :4] = begin + lengths[k], *_integrated(lengths[k], start, now)[:3]
    knots[7, 3] = 0.0
    return knots
