"""Filters of a self-tuned feedforward against floor vibration, after Beijen et al. (2018).

They are designed in continuous time and discretised with Tustin's rule. Every design returns second-order sections as
`scipy.signal.sosfilt` takes them. Products are formed from poles and zeros in continuous time, before Tustin's rule: terms
that cancel analytically are never subject to rounding.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64
from scipy import signal

from stillwork.base.bounds import Count, NonNegative, Positive, within
from stillwork.base.checks import InputError, require_number
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.discretisation import prewarped, tustin_sections

Sections = Float64[np.ndarray, "sections 6"]


@by_value
@dataclass(frozen=True)
class FrequencyNotch:
    """Notch (s² + depth width w s + w²) / (s² + width w s + w²)."""

    frequency_hz: Positive
    width: Positive = 1.0  # bandwidth over frequency
    depth: Annotated[float, within(at_least=0.0, at_most=1.0)] = 0.01  # gain at the frequency

    def __post_init__(self):
        check_fields(self)


@by_value
@dataclass(frozen=True)
class SecondaryPath:
    """One axis of the secondary path from actuator to platform acceleration."""

    mass: Positive  # m, kg
    damping: Positive  # d, N s/m
    stiffness: Positive  # k, N/m
    actuator_pole: Positive  # w_a, rad/s

    def __post_init__(self):
        check_fields(self)

    @property
    def suspension(self) -> list[float]:
        """Coefficients of m s² + d s + k, highest power first."""
        return [self.mass, self.damping, self.stiffness]


@by_value
@dataclass(frozen=True)
class NoiseShaping:
    """Band of interest N: Butterworth high-pass and low-pass with notches."""

    highpass_hz: Positive
    lowpass_hz: float
    order: Count
    notches: tuple[FrequencyNotch, ...] = ()

    def __post_init__(self):
        check_fields(self)
        require_number("lowpass_hz", self.lowpass_hz, above=self.highpass_hz)


@checked
def weak_integrator(order: Count, cutoff: Positive, beta: Positive, sample_time: Positive) -> Sections:
    """Normalised weak integrator beta H with H = (1 - (a / (s + a))^n) / s.

    Below the cut-off a (rad/s) the transmissibility is unaffected, to the order n. Powers of beta H are repeated applications of the filter.
    """
    # (s + a)^n = a^n has the roots a (w - 1) with w the n-th roots of unity; the one at s = 0 is the integrator.
    unity = np.exp(2j * np.pi * np.arange(1, order) / order)
    return tustin_sections(cutoff * (unity - 1), -cutoff * np.ones(order), beta, sample_time)


@checked
def weak_highpass(order: Count, cutoff: Positive, times: Count, sample_time: Positive) -> Sections:
    """High-pass 1 - (a / (s + a))^n, s times the weak integrator of unit beta, so many `times` one after another.

    Far above the cut-off a (rad/s) it differs from 1 by (a / s)^n only, which turns the phase less than a Butterworth
    high-pass does.

    Examples
    --------
    >>> sections = weak_highpass(3, 2 * np.pi, 2, 1e-3)
    >>> np.abs(signal.freqz_sos(sections, [0.0, 0.1, 10.0], fs=1e3)[1]).round(3)
    array([0.   , 0.074, 1.   ])
    """
    unity = np.exp(2j * np.pi * np.arange(1, order) / order)
    zeros = [0.0, *(cutoff * (unity - 1))]
    return tustin_sections(zeros * times, -cutoff * np.ones(order * times), 1.0, sample_time)


@checked
def noise_shaping(shaping: NoiseShaping, path: SecondaryPath, sample_time: Positive) -> Sections:
    """Noise shaping N = band x notches x s² / (m s² + d s + k) of the path."""
    zeros, poles, gain = _band(shaping, sample_time)
    poles = [*poles, *np.roots(path.suspension)]
    return tustin_sections([*zeros, 0, 0], poles, gain / path.mass, sample_time)


@checked
def inverse_secondary_shaping(
    shaping: NoiseShaping, path: SecondaryPath, sample_time: Positive, estimate: SecondaryPath | None = None
) -> Sections:
    """Filter N P2^-1 from platform acceleration to the filtered error.

    The suspension of N cancels that of P2, which leaves band x notches x (s + w_a) / w_a. The inverse alone has a
    double integrator, and with Tustin's rule a pole at z = -1; here neither ever appears, because the low-pass makes
    the product proper before it is discretised. An `estimate`, one mode of a full one, is inverted in place of the
    path in N.
    """
    estimate = estimate or path
    if shaping.order < 2:
        raise InputError(f"order is {shaping.order}; the inverse needs a low-pass of at least order 2")
    zeros, poles, gain = _band(shaping, sample_time)
    zeros = [*zeros, -estimate.actuator_pole]
    gain /= estimate.actuator_pole
    if estimate.suspension != path.suspension:
        zeros += list(np.roots(estimate.suspension))
        poles = [*poles, *np.roots(path.suspension)]
        gain *= estimate.mass / path.mass
    return tustin_sections(zeros, poles, gain, sample_time)


@checked
def conditioning(sample_time: Positive, highpass_hz: Positive, lowpass_hz: float) -> Sections:
    """Signal conditioner of the accelerometers: second-order high-pass and low-pass.

    An analogue low-pass may lie above half the sampling rate, so its corner cannot be prewarped.
    """
    require_number("lowpass_hz", lowpass_hz, above=highpass_hz)
    high = signal.buttap(2)[1] * 2 * np.pi * highpass_hz
    low = signal.buttap(2)[1] * 2 * np.pi * lowpass_hz
    return tustin_sections([0, 0], [*high, *low], (2 * np.pi * lowpass_hz) ** 2, sample_time)


@checked
def skyhook(
    gain: NonNegative, sample_time: Positive, cutoff: Positive = 1.0, notch: FrequencyNotch | None = None
) -> Sections:
    """Skyhook damping k_v / (s + w_i), with a notch; the actuator gets minus its output. The gain is in N s/m whatever the cut-off."""
    zeros, poles = _notches(() if notch is None else (notch,), sample_time)
    return tustin_sections(zeros, [-cutoff, *poles], gain, sample_time)


def _band(shaping: NoiseShaping, sample_time: float) -> tuple[list, list, float]:
    """Zeros, poles and gain of band-pass and notches in continuous time, corners prewarped."""
    prototype = signal.buttap(shaping.order)
    low = prewarped_corner("lowpass_hz", shaping.lowpass_hz, sample_time)
    high = prewarped_corner("highpass_hz", shaping.highpass_hz, sample_time)
    zeros, poles = _notches(shaping.notches, sample_time)
    poles = [*signal.lp2hp_zpk(*prototype, wo=high)[1], *low * prototype[1], *poles]
    return [*np.zeros(shaping.order), *zeros], poles, low**shaping.order


def _notches(notches: tuple[FrequencyNotch, ...], sample_time: float) -> tuple[list, list]:
    zeros, poles = [], []
    for notch in notches:
        frequency = prewarped_corner("frequency_hz", notch.frequency_hz, sample_time)
        # Width is a ratio of frequencies around the notch; the warp is a pure scaling there to first order.
        zeros += list(np.roots([1, notch.depth * notch.width * frequency, frequency**2]))
        poles += list(np.roots([1, notch.width * frequency, frequency**2]))
    return zeros, poles


@checked
def prewarped_corner(name: str, frequency_hz: float, sample_time: Positive) -> float:
    """Frequency, rad/s, that Tustin's rule moves to `frequency_hz`."""
    require_number(name, frequency_hz, below=0.5 / sample_time)
    return prewarped(np.array([2 * np.pi * frequency_hz]), sample_time).item()
