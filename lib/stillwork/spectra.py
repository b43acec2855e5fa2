"""Spectra of measured signals, frequency responses from them, and the published vibration limits."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import signal

from stillwork.checks import InputError, require_array, require_choice, require_number

# One-third-octave band at f: from 2^(-1/6) f to 2^(1/6) f.
BAND_EDGE = 2.0 ** (1 / 6)
BAND_WIDTH = BAND_EDGE - 1 / BAND_EDGE

# Root-mean-square velocity per one-third-octave band, m/s: Amick, Gendreau, Busch and Gordon, "Evolving criteria
# for research facilities: vibration", SPIE 5933 (2005), and IEST-RP-CC012; H to M continue by halves.
_LEVELS = {
    **dict(
        zip(
            (f"VC-{letter}" for letter in "ABCDEFGHIJKLM"),
            np.array([50, 25, 12.5, 6.25, 3.12, 1.56, 0.78, 0.39, 0.195, 0.097, 0.048, 0.024, 0.012]) * 1e-6,
            strict=True,
        )
    ),
    "ISO workshop": 800e-6,  # ISO 2631-2 guide levels
    "ISO office": 400e-6,
    "ISO residence": 200e-6,
    "ISO operating theatre": 100e-6,
}
# Ungar and Gordon's names of 1983 for the first five.
_LEVELS.update({f"BBN-{letter}": _LEVELS[f"VC-{letter}"] for letter in "ABCDE"})
CRITERIA = tuple(_LEVELS)

# Peterson, USGS open-file report 93-322 (1993): from period P_i on, A_i + B_i log10(P) dB re 1 (m/s^2)^2/Hz.
_NOISE_MODELS = {
    "NLNM": (
        (
            0.1,
            0.17,
            0.4,
            0.8,
            1.24,
            2.4,
            4.3,
            5,
            6,
            10,
            12,
            15.6,
            21.9,
            31.6,
            45,
            70,
            101,
            154,
            328,
            600,
            1e4,
        ),
        (-162.36, -166.7, -170, -166.4, -168.6, -159.98, -141.1, -71.36, -97.26, -132.18, -205.27)
        + (-37.65, -114.37, -160.58, -187.5, -216.47, -185, -168.34, -217.43, -258.28, -346.88),
        (5.64, 0, -8.3, 28.9, 52.48, 29.81, 0, -99.77, -66.49, -31.57, 36.16, -104.33, -47.1, -16.28)
        + (0, 15.7, 0, -7.61, 11.9, 26.6, 48.75),
    ),
    "NHNM": (
        (0.1, 0.22, 0.32, 0.8, 3.8, 4.6, 6.3, 7.9, 15.4, 20, 354.8),
        (-108.73, -150.34, -122.31, -116.85, -108.48, -74.66, 0.66, -93.37, 73.54, -151.52, -206.66),
        (-17.23, -80.5, -23.87, 32.51, 18.08, -32.95, -127.18, -22.42, -162.98, 10.01, 31.63),
    ),
}
NOISE_MODELS = tuple(_NOISE_MODELS)


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral densities of one or more channels.

    Attributes
    ----------
    frequencies_hz : ndarray, shape (frequencies,)
        Rising.
    density : ndarray, shape (channels, frequencies)
        Unit of the signal squared per Hz.
    averages : int
        Segments averaged; half-overlapping ones are not independent.
    """

    frequencies_hz: Float64[np.ndarray, " frequencies"]
    density: Float64[np.ndarray, "channels frequencies"]
    averages: int

    @property
    def cumulative(self) -> Float64[np.ndarray, "channels frequencies"]:
        """Power from the lowest frequency up to and including each bin (Parseval: the last is the power)."""
        return np.cumsum(self.density, axis=1) * (self.frequencies_hz[1] - self.frequencies_hz[0])

    def power(self, low_hz: float, high_hz: float) -> Float64[np.ndarray, " channels"]:
        """Power of each channel between two frequencies."""
        return np.array([band_power(self.frequencies_hz, row, low_hz, high_hz) for row in self.density])


@dataclass(frozen=True)
class ResponseEstimate:
    """Frequency response estimated from measured inputs and outputs (H1: noise at the outputs only).

    Attributes
    ----------
    frequencies_hz : ndarray, shape (frequencies,)
        Rising.
    response : ndarray, shape (outputs, inputs, frequencies)
        Output per input.
    coherence : ndarray, shape (outputs, frequencies)
        Multiple coherence: share of an output's power that all inputs together explain.
    residual : ndarray, shape (outputs, frequencies)
        Density that no linear filter of the inputs explains, i.e. the output noise, unbiased.
    averages : int
        Segments averaged.
    """

    frequencies_hz: Float64[np.ndarray, " frequencies"]
    response: Complex128[np.ndarray, "outputs inputs frequencies"]
    coherence: Float64[np.ndarray, "outputs frequencies"]
    residual: Float64[np.ndarray, "outputs frequencies"]
    averages: int


def estimate_spectrum(signals: ArrayLike, sample_rate: float, resolution_hz: float) -> Spectrum:
    """Welch's estimate of the power spectral density: Hann windows, half overlap, means removed.

    Parameters
    ----------
    signals : array_like, shape (channels, samples) or (samples,)
        Signals in any unit.
    sample_rate : float
        Samples per second.
    resolution_hz : float
        Distance of the frequencies; a segment lasts its inverse.

    Raises
    ------
    InputError
        When the signals hold NaN or are shorter than one segment.
    """
    rows, length = _segments("signals", signals, sample_rate, resolution_hz)
    frequencies, density = signal.welch(rows, sample_rate, nperseg=length, detrend="constant")
    return Spectrum(frequencies, density, _averages(rows.shape[1], length))


def estimate_response(
    inputs: ArrayLike, outputs: ArrayLike, sample_rate: float, resolution_hz: float
) -> ResponseEstimate:
    """Matrix of frequency responses from `inputs` to `outputs` by averaged cross spectra, H1 = S_yx S_xx^-1.

    Parameters
    ----------
    inputs, outputs : array_like, shape (channels, samples)
        Recorded together; the inputs must not be copies of each other.
    sample_rate : float
        Samples per second.
    resolution_hz : float
        Distance of the frequencies; a segment lasts its inverse.

    Raises
    ------
    InputError
        When lengths differ, or there are fewer segments than needed to tell the inputs apart.

    References
    ----------
    Bendat and Piersol, Random Data (2010), chapters 6, 7 and 9.
    """
    x, length = _segments("inputs", inputs, sample_rate, resolution_hz)
    y, _ = _segments("outputs", outputs, sample_rate, resolution_hz)
    if x.shape[1] != y.shape[1]:
        raise InputError(f"outputs hold {y.shape[1]} samples, inputs {x.shape[1]}; record them together")
    averages, count = _averages(x.shape[1], length), len(x)
    if averages <= 2 * count:
        raise InputError(
            f"{averages} segments cannot tell {count} inputs apart; record longer or take a coarser resolution_hz"
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


def band_power(frequencies_hz: ArrayLike, density: ArrayLike, low_hz: float, high_hz: float) -> float:
    """Integral of a density between two frequencies (trapezoids; the ends are interpolated).

    Parameters
    ----------
    frequencies_hz, density : array_like, shape (frequencies,)
        On any rising grid.
    low_hz, high_hz : float
        Band, inside the grid.

    Raises
    ------
    InputError
        When the band leaves the grid.
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    s = require_array("density", density, shape=f.shape)
    require_number("low_hz", low_hz, at_least=f[0], below=high_hz)
    require_number("high_hz", high_hz, at_most=f[-1])
    inside = f[(f > low_hz) & (f < high_hz)]
    grid = np.concatenate(([low_hz], inside, [high_hz]))
    return float(np.trapezoid(np.interp(grid, f, s), grid))


def one_third_octave_velocity(
    frequencies_hz: ArrayLike, acceleration_density: ArrayLike
) -> tuple[Float64[np.ndarray, " bands"], Float64[np.ndarray, " bands"]]:
    """Root-mean-square velocity in the one-third-octave bands that the grid covers, from an acceleration PSD.

    Parameters
    ----------
    frequencies_hz : array_like, shape (frequencies,)
        Rising.
    acceleration_density : array_like, shape (frequencies,)
        (m/s^2)^2/Hz.

    Returns
    -------
    centres_hz, velocity : ndarray, shape (bands,)
        Centres 2^(k/3) Hz of the whole bands inside the grid that hold at least three of its points;
        rms velocity in m/s.
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    s = require_array("acceleration_density", acceleration_density, shape=f.shape)
    f, s = f[f > 0], s[f > 0]
    velocity_density = s / (2 * np.pi * f) ** 2
    first = np.ceil(3 * np.log2(f[0] * BAND_EDGE) - 1e-9)
    last = np.floor(3 * np.log2(f[-1] / BAND_EDGE) + 1e-9)
    bands = [
        (centre, band_power(f, velocity_density, max(low, f[0]), min(high, f[-1])))
        for centre in 2.0 ** (np.arange(first, last + 1) / 3)
        for low, high in [(centre / BAND_EDGE, centre * BAND_EDGE)]
        if np.count_nonzero((f >= low) & (f <= high)) >= 3
    ]
    if not bands:
        raise InputError("frequencies_hz covers no one-third-octave band; give a wider or finer grid")
    centres, powers = np.array(bands).T
    return centres, np.sqrt(powers)


def criterion_velocity(name: str, frequencies_hz: ArrayLike) -> Float64[np.ndarray, " frequencies"]:
    """Limit of a vibration criterion: rms velocity in m/s per one-third-octave band.

    Parameters
    ----------
    name : str
        ``VC-A`` to ``VC-M``, ``BBN-A`` to ``BBN-E`` (the earlier names of VC-A to VC-E) or an ISO level, e.g.
        ``ISO office``.
    frequencies_hz : array_like, shape (frequencies,)
        Hz. Flat from 8 Hz (VC-C and finer: 1 Hz) to 80 Hz and continued so beyond both ends, except that
        VC-A, VC-B and the ISO levels rise below 8 Hz with constant acceleration; they are defined from 4 Hz.

    Raises
    ------
    InputError
        When the name is unknown; the nearest is named.
    """
    require_choice("name", name, CRITERIA)
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    level = np.full(f.shape, _LEVELS[name])
    if _LEVELS[name] >= _LEVELS["VC-B"]:
        level *= np.maximum(1.0, 8.0 / np.where(f > 0, f, np.inf))
    return level


def criterion_density(name: str, frequencies_hz: ArrayLike) -> Float64[np.ndarray, " frequencies"]:
    """Acceleration PSD in (m/s^2)^2/Hz that just meets a vibration criterion in every band.

    The band at f is 0.2316 f wide: S_a = (2 pi f)^2 v^2 / (0.2316 f). See `criterion_velocity`.
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    return (2 * np.pi * criterion_velocity(name, f)) ** 2 * f / BAND_WIDTH


def criterion_met(centres_hz: ArrayLike, velocity: ArrayLike) -> str:
    """Finest of VC-A to VC-M that one-third-octave velocities meet in every band from 8 to 80 Hz, or ``none``."""
    f = require_array("centres_hz", centres_hz, ndim=1)
    v = require_array("velocity", velocity, shape=f.shape)
    judged = (f > 7.9) & (f < 81)
    if not judged.any():
        raise InputError("centres_hz holds no band from 8 to 80 Hz; the criteria cannot be judged")
    for name in reversed([name for name in CRITERIA if name.startswith("VC")]):
        if np.all(v[judged] <= criterion_velocity(name, f[judged])):
            return name
    return "none"


def ground_noise_model(name: str, frequencies_hz: ArrayLike) -> Float64[np.ndarray, " frequencies"]:
    """Peterson's (1993) low or high noise model of the quiet and noisy earth, (m/s^2)^2/Hz.

    Parameters
    ----------
    name : str
        ``NLNM`` or ``NHNM``.
    frequencies_hz : array_like, shape (frequencies,)
        1e-5 to 10 Hz.

    Raises
    ------
    InputError
        When the name is unknown or a frequency lies outside the model.
    """
    require_choice("name", name, NOISE_MODELS)
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    if np.any((f < 1e-5) | (f > 10)):
        raise InputError("frequencies_hz leaves 1e-5 to 10 Hz, where the model is defined; cut it there")
    start, constant, slope = (np.array(row, dtype=float) for row in _NOISE_MODELS[name])
    period = 1 / f
    segment = np.clip(np.searchsorted(start, period, side="right") - 1, 0, None)
    return 10 ** ((constant[segment] + slope[segment] * np.log10(period)) / 10)


def _segments(name: str, signals: ArrayLike, sample_rate: float, resolution_hz: float):
    rows = np.atleast_2d(require_array(name, signals))
    if rows.ndim != 2:
        raise InputError(f"{name} has shape {rows.shape}; give (channels, samples)")
    require_number("sample_rate", sample_rate, above=0)
    require_number("resolution_hz", resolution_hz, above=0, below=sample_rate / 4)
    length = round(sample_rate / resolution_hz)
    if rows.shape[1] < length:
        raise InputError(
            f"{name} last {rows.shape[1] / sample_rate:.3g} s, a segment {length / sample_rate:.3g} s; "
            "record longer or take a coarser resolution_hz"
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
