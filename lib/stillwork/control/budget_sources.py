"""Sources of an error budget: white and 1/f noise, quantisers, floors, measured spectra, filters, periodic signals."""

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.bounds import NonNegative, Positive, Vector
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import checked
from stillwork.control.budget import KNOWN, Source
from stillwork.lti.state_space import StateModel
from stillwork.signals.criteria import criterion_density
from stillwork.signals.spectra import Spectrum

LEAST = 1e-12  # of the power of a signal that repeats itself: lines with less are left out


@checked
def white(name: str, place: str, unit: str, level: NonNegative, corner_hz: NonNegative = 0.0) -> Source:
    """White noise of `level` unit/sqrt(Hz), one-sided, with a 1/f part that equals it at `corner_hz`: a sensor, an amplifier."""
    return Source(name, (place,), unit, lambda f: level**2 * (1 + corner_hz / np.maximum(f, 1e-12)))


@checked
def quantiser(name: str, place: str, unit: str, step: Positive, rate_hz: Positive) -> Source:
    """Rounding to multiples of `step` at `rate_hz`, as white noise of variance step^2 / 12: an ADC, a DAC, an encoder."""
    return white(name, place, unit, step / np.sqrt(6 * rate_hz))


@checked
def criterion_floor(name: str, place: str, criterion: str) -> Source:
    """A floor that just meets a vibration criterion such as ``VC-D`` in every band, as acceleration (m/s^2)."""
    return Source(
        name, (place,), "m/s^2", lambda f: criterion_density(criterion, f), knots_hz=np.array([8.0])
    )


@checked
def tabulated(
    name: str, place: str, unit: str, frequencies_hz: Vector, density: ArrayLike, averages: int = 0
) -> Source:
    """A density in unit^2/Hz at rising frequencies, interpolated linearly; of Welch's estimate with its number of `averages`.

    The averages are taken as half-overlapping Hann windows, whose squared correlation is 1/36.
    """
    f = frequencies_hz
    s = require_array("density", density, shape=f.shape)
    if len(f) < 2 or np.any(np.diff(f) <= 0) or f[0] < 0:
        raise InputError(f"{name}: frequencies_hz must rise from 0 or above; sort them")
    if np.any(s < 0):
        raise InputError(f"{name}: density is negative; give a power spectral density")
    freedom = 2 * averages / (1 + (averages - 1) / averages / 18) if averages else KNOWN
    resolution = float(np.diff(f).min()) if averages else 0.0
    ends = float(f[0]), float(f[-1])
    return Source(
        name,
        (place,),
        unit,
        lambda at: np.interp(at, f, s),
        ends,
        f,
        freedom=freedom,
        resolution_hz=resolution,
    )


@checked
def measured(name: str, place: str, unit: str, spectrum: Spectrum) -> Source:
    """The first channel of an estimated spectrum, with the uncertainty of its averages."""
    known = spectrum.frequencies_hz > 0
    f, rows = spectrum.frequencies_hz[known], spectrum.density[:, known]
    return tabulated(name, place, unit, f, rows[0], spectrum.averages)


@checked
def shaped(name: str, places: tuple[str, ...], unit: str, filter: StateModel) -> Source:
    """White noise of unit intensity (one in two-sided unit^2/Hz) through a continuous filter, correlated over several places."""

    def density(f: np.ndarray) -> np.ndarray:
        response = filter.frequency_response(2 * np.pi * f)
        return 2 * np.einsum("ikf,jkf->ijf", response, response.conj())

    return Source(name, places, unit, density)


@checked
def periodic(name: str, place: str, unit: str, period: ArrayLike, sample_rate: Positive) -> Source:
    """A periodic signal, such as the error of a feedforward over a scan or a ripple, as its Fourier series.

    Its mean is left out, and lines with less than `LEAST` of the power.
    """
    signal = _whole_period(name, period)
    amplitudes = 2 * np.abs(np.fft.rfft(signal)) / len(signal)
    if len(signal) % 2 == 0:
        amplitudes[-1] /= np.sqrt(
            2
        )  # half the samples see it at its peak: its power is the amplitude squared
    amplitudes[0] = 0.0
    lines = np.flatnonzero(amplitudes**2 > LEAST * np.sum(amplitudes**2))
    spacing = sample_rate / len(signal)
    return Source(
        name, (place,), unit, tones=tuple((float(k * spacing), float(amplitudes[k])) for k in lines)
    )


def _whole_period(name: str, period: ArrayLike) -> np.ndarray:
    signal = require_array("period", period, ndim=1)
    if len(signal) < 3 or not np.ptp(signal):
        raise InputError(f"{name}: period is constant or shorter than 3 samples; give one whole period")
    return signal


@checked
def setpoint(
    name: str, period: ArrayLike, sample_rate: Positive, mass: NonNegative, advance: float = 0.0
) -> Source:
    """A periodic setpoint and the force mass x acceleration that is fed forward, at the two places of a machine.

    It acts at ``setpoint`` and ``stage drive`` of a `FloorMachine`: the error that remains is due to what the feedforward does
    not include, a wrong `mass`, the delay of the command, the stage's modes and the reaction on the frame.

    Parameters
    ----------
    name : str
    period : array_like, shape (samples,)
        Positions over one whole period, m, so that the last sample is followed by the first.
    sample_rate : float
        Hz.
    mass : float
        kg, the stage's mass assumed by the feedforward; 0: no feedforward.
    advance : float
        s, by which the feedforward is ahead of the setpoint, to compensate the delay.
    """
    positions = _whole_period(name, period)
    spacing = sample_rate / len(positions)
    lines = np.arange(1, (len(positions) + 1) // 2)
    sizes = 2 * np.fft.rfft(positions)[lines] / len(positions)
    omega = 2 * np.pi * spacing * lines
    forces = -mass * omega**2 * sizes * np.exp(1j * omega * advance)
    tones = tuple(
        (float(f), complex(size), complex(force))
        for f, size, force in zip(spacing * lines, sizes, forces, strict=True)
    )
    return Source(name, ("setpoint", "stage drive"), "m, N", tones=tones)
