"""Fourth-order setpoints: snap is piecewise constant, everything else its exact integral."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array, require_number, require_samples
from stillwork.base.front_door import by_value, check_fields, checked


@by_value
@dataclass(frozen=True)
class Setpoint:
    """A sampled setpoint; between samples the snap is constant, so every row is exact."""

    sample_time: float  # s
    derivatives: Float64[np.ndarray, "5 samples"]  # position, velocity, acceleration, jerk, snap (SI)
    scan: tuple[float, float]  # s, start and end of the scanning phase
    acceleration_end: float  # s, where the constant velocity begins

    @checked
    def __post_init__(self):
        check_fields(self)
        require_number("sample_time", self.sample_time, above=0.0)
        rows = require_array("derivatives", self.derivatives, shape=(5, None))
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
    segments: ArrayLike, durations: ArrayLike, sample_time: float
) -> Float64[np.ndarray, "5 samples"]:
    """Position, velocity, acceleration, jerk and snap at every sample, from constant-snap segments."""
    segments = require_array("segments", segments, ndim=1)
    if not len(segments):
        raise InputError("segments is empty; give the snap of at least one segment in m/s^4")
    durations = require_array("durations", durations, shape=segments.shape)
    sample_time = require_number("sample_time", sample_time, above=0.0)
    require_samples("sample_time", float(np.sum(durations / sample_time)))
    counts = np.rint(durations / sample_time).astype(int)
    if np.any(counts < 1) or np.any(np.abs(counts * sample_time - durations) > 1e-9 * durations):
        raise InputError(
            f"durations must be positive multiples of sample_time = {sample_time:g} s; choose one that divides them"
        )
    rows, state = [], np.zeros(4)
    for snap, count in zip(segments, counts, strict=True):
        t = np.arange(count + 1) * sample_time
        p, v, a, j = state
        whole = np.array(
            [
                p + t * (v + t * (a / 2 + t * (j / 6 + t * snap / 24))),
                v + t * (a + t * (j / 2 + t * snap / 6)),
                a + t * (j + t * snap / 2),
                j + t * snap,
                np.full(count + 1, snap),
            ]
        )
        rows.append(whole[:, :-1])
        state = whole[:4, -1]
    return np.hstack([*rows, np.append(state, 0.0)[:, None]])


@checked
def point_to_point(
    snap: float,
    jerk: float,
    acceleration: float,
    velocity: float,
    cruise: float,
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
    require_number("cruise", cruise, above=0.0)
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
    limits = {"snap": snap, "jerk": jerk, "acceleration": acceleration, "velocity": velocity}
    for name, limit in limits.items():
        require_number(name, limit, above=0.0)
    t_snap = min(jerk / snap, np.sqrt(acceleration / snap), np.cbrt(velocity / (2 * snap)))
    top = snap * t_snap
    # Acceleration limit: top (t_snap + t_jerk); velocity limit: that times (2 t_snap + t_jerk).
    by_acceleration = acceleration / top - t_snap
    by_velocity = (-3 * t_snap + np.sqrt(t_snap**2 + 4 * velocity / top)) / 2
    t_jerk = max(min(by_acceleration, by_velocity), 0.0)
    peak = top * (t_snap + t_jerk)
    t_acceleration = max(velocity / peak - 2 * t_snap - t_jerk, 0.0)
    return tuple(0.0 if t < 1e-9 * t_snap else float(t) for t in (t_snap, t_jerk, t_acceleration))
