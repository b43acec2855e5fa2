"""Convergence of the fixed point iteration: gain, linear stability, predicted and simulated limit cycles."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Count, NonNegative, Positive, Vector, at_least
from stillwork.base.checks import InputError, pluralise
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.fixed_point_linear import LinearLoop
from stillwork.control.transformation import FlowTransformation, Transformation, deform_packed


@checked
def iterate(
    transformation: Transformation,
    desired: float,
    steps: Count,
    *,
    response_gain: float = 1.0,
    start: float | None = None,
) -> Float64[np.ndarray, " steps"]:
    """The sequence deformed -> G(deformed, f(deformed), desired) for f(x) = gain x, m/s^2.

    Static: the desired acceleration is constant and measured without delay, as in Banach's theorem.
    """
    value = desired if start is None else start
    sequence, packed = np.empty(steps), transformation.packed
    for i in range(steps):
        sequence[i] = value
        value = deform_packed(packed, value, response_gain * value, desired, desired)
    return sequence


@by_value
@dataclass(frozen=True)
class Crossing:
    """A gain at which a pair of poles of the closed loop is on the unit circle."""

    local_gain: float
    frequency_hz: float

    def __post_init__(self):
        check_fields(self)


@by_value
@dataclass(frozen=True)
class StableRange:
    """Open range of `local_gain` in which the linear loop is stable; edges with the frequency found there.

    Without a stable gain both edges are None.
    """

    strongest: Crossing | None  # the more negative edge
    weakest: Crossing | None

    def __post_init__(self):
        check_fields(self)

    def __contains__(self, local_gain: float) -> bool:
        strongest, weakest = self.limits
        return bool(strongest < local_gain < weakest)

    @property
    def limits(self) -> tuple[float, float]:
        """Strongest and weakest gain; NaN without a stable gain."""
        if self.strongest is None or self.weakest is None:
            return np.nan, np.nan
        return self.strongest.local_gain, self.weakest.local_gain


@checked
def crossings(loop: LinearLoop, points: Annotated[int, at_least(10)] = 300) -> list[Crossing]:
    """All negative gains at which poles of a `linear_loop` cross the unit circle, strongest first.

    A crossing is where the open loop's frequency response is real: 1 = gain response. Sign changes are sought on a
    logarithmic grid of frequencies and refined after.
    """
    from scipy.optimize import brentq

    nyquist = np.pi / loop.sample_time
    rate = np.geomspace(nyquist * 1e-4, nyquist * (1 - 1e-9), points)
    phase = loop.response(rate).imag
    places = [
        brentq(lambda w: loop.response([w]).imag[0], rate[i], rate[i + 1], xtol=1e-9 * rate[i])
        for i in np.flatnonzero(phase[:-1] * phase[1:] < 0)
    ]
    found = []
    for place in [*places, nyquist]:
        real = float(loop.response([place]).real[0])
        if real < 0:
            found.append(Crossing(1 / real, float(place / (2 * np.pi))))
    return sorted(found, key=lambda crossing: crossing.local_gain)


@checked
def stable_range(loop: LinearLoop) -> StableRange:
    """The widest range of negative gains between two crossings in which all poles are inside the circle."""
    edges = _scanned_edges(loop) if loop.B.shape[1] > 1 else [*crossings(loop), Crossing(0.0, 0.0)]
    ranges = [
        (strong, weak)
        for strong, weak in pairwise(edges)
        if loop.radius((strong.local_gain + weak.local_gain) / 2) < 1
    ]
    if not ranges:
        return StableRange(None, None)
    return StableRange(*max(ranges, key=lambda edges: edges[1].local_gain - edges[0].local_gain))


def _scanned_edges(loop: LinearLoop) -> list[Crossing]:
    """Crossings of several coordinates, by the poles themselves: sought on a grid of gains from -10 to -1e-3."""
    from scipy.optimize import brentq

    gains = -np.geomspace(10.0, 1e-3, 161)
    excess = np.array([loop.radius(gain) for gain in gains]) - 1
    inner = [
        brentq(lambda gain: loop.radius(gain) - 1, gains[i], gains[i + 1], xtol=1e-9)
        for i in np.flatnonzero(excess[:-1] * excess[1:] < 0)
    ]
    edges = []
    for gain in (float(gains[0]), *inner, float(gains[-1])):
        poles = loop.poles(gain)
        angle = abs(np.angle(poles[np.abs(poles).argmax()]))
        edges.append(Crossing(gain, float(angle / (2 * np.pi * loop.sample_time))))
    return edges


@checked
def describing_function(amplitude: NonNegative) -> float:
    """Gain of sigma(x) = x / (1 + |x|) for the first harmonic of a sine of `amplitude`.

    (2 / pi) times the integral of sin^2 / (1 + amplitude sin) over half a period; 1 at zero, falling.
    """
    from scipy.integrate import quad

    value, _ = quad(lambda t: np.sin(t) ** 2 / (1 + amplitude * np.sin(t)), 0, np.pi, epsabs=1e-13)
    return float(2 / np.pi * value)


@checked
def random_gain(deviation: NonNegative) -> float:
    """Gain of the same sigmoid for a small signal buried in Gaussian noise of standard `deviation`.

    E[sigma'(x)], the random-input describing function: the linear gain reduced by noise.
    """
    from scipy.integrate import quad

    value, _ = quad(lambda x: np.exp(-(x**2) / 2) / (1 + deviation * x) ** 2, 0, 12, epsabs=1e-13, limit=200)
    return float(np.sqrt(2 / np.pi) * value)


@by_value
@dataclass(frozen=True)
class LimitCycle:
    """A predicted periodic motion. Amplitudes of the first harmonic."""

    frequency_hz: float
    iteration_error: float  # of response - desired, m/s^2
    position: float  # m
    velocity: float  # m/s
    stable: bool  # attracts its neighbours; an unstable one is the border of divergence

    def __post_init__(self):
        check_fields(self)


@checked
def limit_cycles(
    loop: LinearLoop, transformation: Transformation, region: StableRange | None = None
) -> list[LimitCycle]:
    """Limit cycles of the loop closed by (6), by the describing function, smallest amplitude first.

    Where the linear gain lies beyond the strongest stable one, the sigmoid holds the motion on a stable
    cycle; where the loop needs a minimum gain, a large motion reduces it too much: an unstable cycle, beyond which
    the loop diverges. `region`, if known, saves the search for the stable range.
    """
    from scipy.optimize import brentq

    if not isinstance(transformation, FlowTransformation):
        raise InputError("transformation (8) works in the linear part of its sigmoid; it has no limit cycle")
    linear, region = transformation.local_gain, region or stable_range(loop)
    if region.strongest is None or region.weakest is None:
        return []
    cycles = []
    for edge, stable in ((region.strongest, True), (region.weakest, False)):
        ratio = edge.local_gain / linear
        if not 0 < ratio < 1:
            continue
        reach = 4 / (np.pi * ratio)  # above the amplitude: for large x, the function stays below 4 / (pi x)
        scaled = brentq(lambda a, ratio=ratio: describing_function(a) - ratio, 0.0, reach)
        change = abs(edge.local_gain) * scaled * transformation.width
        rate = np.array([2 * np.pi * edge.frequency_hz])
        position, velocity = (
            float(abs(loop.response(rate, row)[0]) * change) for row in np.eye(len(loop.A))[:2]
        )
        error = float(scaled * transformation.width)
        cycles.append(LimitCycle(edge.frequency_hz, error, position, velocity, stable))
    return cycles


@by_value
@dataclass(frozen=True)
class Oscillation:
    """The strongest line in a record."""

    frequency_hz: float
    amplitude: float  # of that line, in the record's unit

    def __post_init__(self):
        check_fields(self)


@checked
def strongest_oscillation(values: Vector, sample_time: Positive) -> Oscillation:
    """Frequency and amplitude of the strongest sine in a record, refined between the FFT's lines."""
    from scipy.optimize import minimize_scalar

    if len(values) < 16:
        raise InputError(f"values holds {pluralise(len(values), 'sample')}; give 16 at least")
    window = np.hanning(len(values))
    weighted = (values - values.mean()) * window
    time = np.arange(len(values)) * sample_time

    def height(frequency):
        return abs(weighted @ np.exp(-2j * np.pi * frequency * time)) * 2 / window.sum()

    lines = np.fft.rfftfreq(len(values), sample_time)
    peak = int(np.abs(np.fft.rfft(weighted))[1:].argmax()) + 1
    ends, options = (lines[peak] - lines[1], lines[peak] + lines[1]), {"xatol": 1e-6 * lines[1]}
    best = minimize_scalar(lambda f: -height(f), bounds=ends, method="bounded", options=options)
    return Oscillation(float(best.x), float(height(best.x)))
