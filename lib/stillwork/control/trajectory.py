"""Nominal trajectories with exact first and second derivatives."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Fraction, Positive, Vector, within
from stillwork.base.checks import InputError, require_array, require_number, require_samples
from stillwork.base.validation import by_value, check_fields, checked


@by_value
@dataclass(frozen=True)
class Trajectory:
    """Desired motion of a coordinate, sampled, with its first and second derivative."""

    sample_time: Positive  # s
    position: Vector  # q^N, m, shape (samples,)
    velocity: Vector = ()  # m/s, shape (samples,)
    acceleration: Vector = ()  # m/s^2, shape (samples,)

    @checked
    def __post_init__(self):
        check_fields(self)
        if len(self.position) < 2:
            raise InputError("position holds fewer than 2 samples; give a longer trajectory")
        for name, below in (("velocity", "position"), ("acceleration", "velocity")):
            values, base = getattr(self, name), getattr(self, below)
            if values.shape != base.shape:
                raise InputError(
                    f"{name} has shape {values.shape}, {below} has {base.shape}; a trajectory needs both "
                    "derivatives at every sample: record_trajectory() takes them from a record of positions"
                )
            # The trapezoid rule integrates a smooth derivative to about (its change a step) x sample_time.
            grown = np.cumsum((values[1:] + values[:-1]) / 2) * self.sample_time
            error = np.abs(base[1:] - base[0] - grown).max()
            allowed = self.sample_time * np.abs(np.diff(values)).sum() + 1e-9 * (1 + np.abs(base).max())
            if error > allowed:
                raise InputError(
                    f"{name} is not the derivative of {below}: integrated, it misses by {error:.3g}; "
                    "give exact derivatives, or let record_trajectory() take them"
                )

    @property
    def time(self) -> Float64[np.ndarray, " samples"]:
        """Times of the samples, s."""
        return np.arange(len(self.position)) * self.sample_time


@checked
def sampled(duration: float, sample_time: Positive) -> Float64[np.ndarray, " samples"]:
    """Sample times 0, sample_time, ... below `duration`, s."""
    require_number("duration", duration, above=2 * sample_time)
    return np.arange(require_samples("sample_time", duration / sample_time)) * sample_time


@checked
def sine_trajectory(
    amplitude: float = 1.0, frequency_hz: float = 0.2, duration: float = 12.0, sample_time: float = 1e-3
) -> Trajectory:
    """q = A sin(w t)."""
    phase, rate = _phase(frequency_hz, duration, sample_time)
    return Trajectory(
        sample_time,
        amplitude * np.sin(phase),
        amplitude * rate * np.cos(phase),
        -amplitude * rate**2 * np.sin(phase),
    )


@checked
def asin_trajectory(
    amplitude: float = 1.0,
    sharpness: Fraction = 0.98,
    frequency_hz: float = 0.2,
    duration: float = 12.0,
    sample_time: float = 1e-3,
) -> Trajectory:
    """q = A asin(k sin w t) / asin k: a sine for small k, a triangle with corners as k nears 1.

    The paper states only that its trajectory has "quasi edges" around which the derivative varies drastically;
    this one has them, with derivatives in closed form.

    Parameters
    ----------
    amplitude : float
        A, m.
    sharpness : float
        k, between 0 and 1.
    frequency_hz, duration, sample_time : float
        Hz, s, s.

    Returns
    -------
    Trajectory
        Position, velocity and acceleration at each sample.

    Raises
    ------
    InputError
        When the sharpness is not between 0 and 1, or the frequency not below half the sample rate.

    Examples
    --------
    >>> corner = control.asin_trajectory(amplitude=0.1, frequency_hz=1.0, duration=1.0)
    >>> float(corner.position.max().round(6))  # m
    0.1
    """
    phase, rate = _phase(frequency_hz, duration, sample_time)
    scale = amplitude / np.arcsin(sharpness)
    inner = 1 - (sharpness * np.sin(phase)) ** 2
    return Trajectory(
        sample_time,
        scale * np.arcsin(sharpness * np.sin(phase)),
        scale * sharpness * rate * np.cos(phase) / np.sqrt(inner),
        -scale * sharpness * rate**2 * (1 - sharpness**2) * np.sin(phase) / inner**1.5,
    )


@checked
def trapezoid_trajectory(
    amplitude: float = 1.0,
    rounding: Annotated[float, within(above=0.0, at_most=1.0)] = 0.5,
    frequency_hz: float = 0.2,
    duration: float = 12.0,
    sample_time: float = 1e-3,
) -> Trajectory:
    """A trapezoid between -A and A whose corners are rounded, so that the acceleration is continuous.

    Ramps and dwells take a quarter of the period each. At a corner, whose length is `rounding` of a ramp, the
    velocity follows 3 x^2 - 2 x^3.
    """
    phase, rate = _phase(frequency_hz, duration, sample_time)
    time, period = phase / rate, 2 * np.pi / rate
    ramp = period / 4
    corner = rounding * ramp
    speed = 2 * amplitude / ramp
    within = np.mod(time, period)
    # One period: up from the middle, dwell, down, dwell, up to the middle; each corner changes the velocity.
    corners = [(0.5, -speed), (1.5, -speed), (2.5, speed), (3.5, speed)]
    position, velocity, acceleration = speed * within, np.full_like(within, speed), np.zeros_like(within)
    for place, change in corners:
        x = np.clip((within - place * ramp) / corner + 0.5, 0, 1)
        beyond = np.maximum(within - place * ramp - corner / 2, 0)
        position += change * (corner * (x**3 - x**4 / 2) + beyond)
        velocity += change * (3 * x**2 - 2 * x**3)
        acceleration += change * 6 * x * (1 - x) / corner
    return Trajectory(sample_time, position, velocity, acceleration)


@checked
def record_trajectory(time: Vector, position: ArrayLike, sample_time: Positive = 1e-3) -> Trajectory:
    """A recorded motion as a trajectory: the quintic spline through the record, and its exact derivatives."""
    from scipy.interpolate import make_interp_spline

    position = require_array("position", position, shape=time.shape)
    if len(time) < 6 or np.any(np.diff(time) <= 0):
        raise InputError("time must rise from sample to sample, with at least 6 samples; sort the record")
    require_samples("sample_time", (time[-1] - time[0]) / sample_time)
    spline = make_interp_spline(time, position, k=5)
    at = time[0] + np.arange(int((time[-1] - time[0]) / sample_time * (1 + 1e-12)) + 1) * sample_time
    return Trajectory(sample_time, spline(at), spline(at, 1), spline(at, 2))


def _phase(frequency_hz, duration, sample_time):
    time = sampled(duration, sample_time)
    # From half the sample rate on the samples do not determine the motion between them.
    rate = 2 * np.pi * require_number("frequency_hz", frequency_hz, above=0, below=0.5 / sample_time)
    return rate * time, rate
