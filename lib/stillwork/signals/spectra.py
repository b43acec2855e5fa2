"""Spectra of measured signals, their power, and frequency responses from them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import signal

from stillwork.base.bounds import Positive, Vector
from stillwork.base.checks import InputError, pluralise, require_array, require_number, short_repr
from stillwork.base.extras import require_package
from stillwork.base.validation import by_value, check_fields, checked


@by_value
@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral densities of one or more channels."""

    frequencies_hz: Float64[np.ndarray, " frequencies"]  # rising
    density: Float64[np.ndarray, "channels frequencies"]  # unit of the signal squared per Hz
    averages: int  # segments averaged; half-overlapping ones are not independent

    def __post_init__(self):
        check_fields(self)
        if len(self.frequencies_hz) < 2 or self.density.shape[1:] != self.frequencies_hz.shape:
            raise InputError(
                "frequencies_hz holds fewer than 2 frequencies, or density has not one value at each"
            )

    @checked
    def power(self, low_hz: float, high_hz: float) -> Float64[np.ndarray, " channels"]:
        """Power of each channel between two frequencies.

        Parameters
        ----------
        low_hz, high_hz : float
            The two frequencies, within those of the spectrum.

        Returns
        -------
        ndarray, shape (channels,)
            In the squared unit of the signals.

        Raises
        ------
        InputError
            When the band is empty or leaves the spectrum.

        Examples
        --------
        >>> hum = 3 * np.sin(2 * np.pi * 50 * np.arange(20_000) / 1000)  # um, at 1 kHz
        >>> signals.estimate_spectrum(hum, sample_rate=1000.0, resolution_hz=0.5).power(60.0, 100.0).round(6)  # um^2
        array([0.])
        """
        return np.array([band_power(self.frequencies_hz, row, low_hz, high_hz) for row in self.density])


@by_value
@dataclass(frozen=True)
class ResponseEstimate:
    """Frequency response estimated from measured inputs and outputs (H1: noise at the outputs only)."""

    frequencies_hz: Float64[np.ndarray, " frequencies"]  # rising
    response: Complex128[np.ndarray, "outputs inputs frequencies"]  # output per input
    # multiple coherence: share of an output's power that all inputs together explain
    coherence: Float64[np.ndarray, "outputs frequencies"]
    # density that no linear filter of the inputs explains, i.e. the output noise, unbiased
    residual: Float64[np.ndarray, "outputs frequencies"]
    averages: int  # segments averaged

    def __post_init__(self):
        check_fields(self)

    def to_control(self):
        """The response as `control.FrequencyResponseData`, at rad/s.

        Returns
        -------
        control.FrequencyResponseData

        Raises
        ------
        MissingPackage
            When python-control is not installed.

        Examples
        --------
        >>> noise = np.random.default_rng(1).normal(size=20_000)
        >>> found = signals.estimate_response(noise, 2 * noise, sample_rate=1000.0, resolution_hz=1.0)
        >>> round(float(abs(found.to_control()(2j * np.pi * 100.0))), 6)
        2.0
        """
        return require_package("control").FrequencyResponseData(
            self.response, 2 * np.pi * self.frequencies_hz
        )


def response_arrays(response: Any, name: str = "file") -> dict[str, np.ndarray]:
    """A frequency response of python-control, or (frequencies in Hz, response), as a file would hold it."""
    if hasattr(response, "omega") and hasattr(response, "frdata"):
        return {"frequency (rad/s)": np.asarray(response.omega), "response": _one(response.frdata)}
    if hasattr(response, "frequencies_hz") and hasattr(response, "response"):
        return {"frequency (Hz)": response.frequencies_hz, "response": _one(response.response)}
    if isinstance(response, tuple) and len(response) == 2:
        hertz = require_array(f"{name}[0]", response[0], shape=(None,))
        return {
            "frequency (Hz)": hertz,
            "response": require_array(f"{name}[1]", response[1], shape=hertz.shape, dtype=complex),
        }
    raise InputError(
        f"{name} is {short_repr(response)}; give {'a path, ' * (name == 'file')}a control.FrequencyResponseData, or "
        "(frequencies in Hz, response)"
    )


def _one(response: Any) -> np.ndarray:
    """The only channel, or all of them with the frequencies first, as a file holds them."""
    values = np.asarray(response, complex)
    return values[0, 0] if values.shape[:2] == (1, 1) else np.moveaxis(values, -1, 0)


@checked
def estimate_spectrum(signals: ArrayLike, sample_rate: Positive, resolution_hz: float) -> Spectrum:
    """Welch's estimate of the power spectral density: Hann windows, half overlap, means removed.

    Parameters
    ----------
    signals : array_like, shape (channels, samples) or (samples,)
        Signals in any unit.
    sample_rate : float
        Samples per second.
    resolution_hz : float
        Spacing of the frequencies; a segment lasts its inverse.

    Returns
    -------
    Spectrum
        One-sided density of each signal, in its unit squared per Hz.

    Raises
    ------
    InputError
        When the signals hold NaN or are shorter than one segment.

    References
    ----------
    Welch, The use of fast Fourier transform for the estimation of power spectra (1967).

    Examples
    --------
    >>> error = 3 * np.sin(2 * np.pi * 50 * np.arange(20_000) / 1000)  # um, at 1 kHz
    >>> spectrum = signals.estimate_spectrum(error, sample_rate=1000.0, resolution_hz=0.5)
    >>> spectrum.power(40.0, 60.0).round(2)  # um^2: half the square of the amplitude
    array([4.5])
    """
    rows, length = _segments("signals", signals, sample_rate, resolution_hz)
    frequencies, density = signal.welch(rows, sample_rate, nperseg=length, detrend="constant")
    return Spectrum(frequencies, density, _averages(rows.shape[1], length))


@checked
def estimate_response(
    inputs: ArrayLike, outputs: ArrayLike, sample_rate: Positive, resolution_hz: float
) -> ResponseEstimate:
    """Matrix of frequency responses from `inputs` to `outputs` by averaged cross spectra, H1 = S_yx S_xx^-1.

    Parameters
    ----------
    inputs, outputs : array_like, shape (channels, samples)
        Recorded together; the inputs must not be copies of each other.
    sample_rate : float
        Samples per second.
    resolution_hz : float
        Spacing of the frequencies; a segment lasts its inverse.

    Returns
    -------
    ResponseEstimate
        Responses over rising frequencies, with coherences, the residual's density and the number of averages.

    Raises
    ------
    InputError
        When lengths differ, or there are fewer segments than needed to separate the inputs.

    References
    ----------
    Bendat and Piersol, Random Data (2010), chapters 6, 7 and 9.

    Examples
    --------
    >>> force = np.random.default_rng(0).standard_normal((1, 20_000))  # N
    >>> estimate = signals.estimate_response(force, 2e-6 * force, sample_rate=1000.0, resolution_hz=1.0)
    >>> np.allclose(estimate.response, 2e-6)  # m/N: a spring
    True
    """
    x, length = _segments("inputs", inputs, sample_rate, resolution_hz)
    y, _ = _segments("outputs", outputs, sample_rate, resolution_hz)
    if x.shape[1] != y.shape[1]:
        raise InputError(
            f"outputs hold {pluralise(y.shape[1], 'sample')}, inputs {x.shape[1]}; record them together"
        )
    averages, count = _averages(x.shape[1], length), len(x)
    if averages <= 2 * count:
        raise InputError(
            f"{pluralise(averages, 'segment')} cannot separate {count} inputs; record longer or use a coarser resolution_hz"
        )
    frequencies, fx = _segment_spectra(x, sample_rate, length)
    _, fy = _segment_spectra(y, sample_rate, length)
    sxx = np.einsum("ifs,jfs->fij", fx, fx.conj()) / averages
    syx = np.einsum("ifs,jfs->fij", fy, fx.conj()) / averages
    syy = np.mean(np.abs(fy) ** 2, axis=2)
    # Scaled to ones on the diagonal, because inputs may differ in unit and level.
    scale = np.sqrt(np.einsum("fii->fi", sxx).real)
    if np.any(scale == 0):
        raise InputError("inputs: a channel is silent at some frequency; leave that channel out")
    scaled = sxx / (scale[:, :, None] * scale[:, None, :])
    if np.any(np.linalg.cond(scaled[1:-1]) > 1e10):
        raise InputError("inputs: two channels are copies of each other; leave one out")
    response = np.linalg.solve(scaled.transpose(0, 2, 1), (syx / scale[:, None, :]).transpose(0, 2, 1))
    response = response.transpose(0, 2, 1) / scale[:, None, :]
    explained = np.einsum("fij,fij->fi", response, syx.conj()).real.T
    # Each input takes one complex degree of freedom of the averages (Bendat and Piersol, section 9.3).
    residual = np.maximum(syy - explained, 0.0) * averages / (averages - count)
    return ResponseEstimate(
        frequencies,
        np.ascontiguousarray(response.transpose(1, 2, 0)),
        np.clip(explained / np.where(syy > 0, syy, 1), 0.0, 1.0),
        residual,
        averages,
    )


@checked
def band_power(frequencies_hz: Vector, density: ArrayLike, low_hz: float, high_hz: float) -> float:
    """Integral of a density between two frequencies (trapezoids; the ends are interpolated)."""
    f = frequencies_hz
    s = require_array("density", density, shape=f.shape)
    if np.any(np.diff(f) <= 0):
        raise InputError("frequencies_hz must rise from line to line; sort them, and give each only once")
    require_number("high_hz", high_hz, above=f[0], at_most=f[-1])
    require_number("low_hz", low_hz, at_least=f[0], below=high_hz)
    inside = f[(f > low_hz) & (f < high_hz)]
    grid = np.concatenate(([low_hz], inside, [high_hz]))
    return float(np.trapezoid(np.interp(grid, f, s), grid))


def _segments(name: str, signals: ArrayLike, sample_rate: float, resolution_hz: float):
    rows = np.atleast_2d(require_array(name, signals))
    if rows.ndim != 2:
        raise InputError(f"{name} has shape {rows.shape}; give (channels, samples)")
    require_number("resolution_hz", resolution_hz, above=0.0, below=sample_rate / 4)
    length = round(sample_rate / resolution_hz)
    if rows.shape[1] < length:
        raise InputError(
            f"{name} last {rows.shape[1] / sample_rate:.3g} s, a segment {length / sample_rate:.3g} s; "
            "record longer or use a coarser resolution_hz"
        )
    return rows, length


def _averages(samples: int, length: int) -> int:
    step = length - length // 2
    return (samples - length) // step + 1


def _segment_spectra(rows, sample_rate: float, length: int):
    """One-sided Fourier transform of every Hann-windowed segment, (channels, frequencies, segments)."""
    window = signal.get_window("hann", length)
    segments = np.lib.stride_tricks.sliding_window_view(rows, length, axis=1)[:, :: length - length // 2]
    spectra = np.fft.rfft(window * signal.detrend(segments, type="constant"), axis=2)
    spectra *= np.sqrt(2 / (sample_rate * np.sum(window**2)))
    spectra[..., 0] /= np.sqrt(2)  # no other half to fold in
    if length % 2 == 0:
        spectra[..., -1] /= np.sqrt(2)
    return np.fft.rfftfreq(length, 1 / sample_rate), spectra.transpose(0, 2, 1)
