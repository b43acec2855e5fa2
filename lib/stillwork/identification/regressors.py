"""Regressors of FIR models from measured records, and bounds from what is known of their noise."""

from typing import Annotated

import numpy as np

from stillwork.base.bounds import Count, Fraction, Natural, NonNegative, Vector, within
from stillwork.base.checks import (
    InputError,
    require_memory,
    require_samples,
)
from stillwork.base.validation import checked
from stillwork.signals.spectra import Spectrum


@checked
def fir_regressors(signal: Vector, taps: Count) -> np.ndarray:
    """Columns (u_t, u_(t-1), ..., u_(t-taps+1)), for y_t = sum over k of x_k u_(t-k).

    Parameters
    ----------
    signal : array_like, shape (samples,)
        Input u; taken as zero before the record.
    taps : int
        Length of the impulse response.

    Returns
    -------
    ndarray, shape (taps, samples)

    Raises
    ------
    InputError
        When the signal is not a finite list of numbers.

    References
    ----------
    Ljung, System Identification (1999), section 4.2.

    Examples
    --------
    >>> identification.fir_regressors([1.0, 2.0, 3.0], taps=2)
    array([[1., 2., 3.],
           [0., 1., 2.]])
    """
    require_memory("taps", taps, len(signal))
    columns = np.zeros((taps, len(signal)))
    for lag, row in enumerate(columns):
        row[lag:] = signal[: max(len(signal) - lag, 0)]
    return columns


@checked
def exponential_bound(row: NonNegative, forgetting: Fraction, samples: Count | None = None) -> float:
    """Bound eta on the 2-norm of the exponentially weighted perturbation, Section 5.

    epsilon sqrt(sum of forgetting^j over the samples); without `samples` its limit epsilon / sqrt(1 - forgetting).
    """
    memory = 1 / (1 - forgetting)
    if samples is not None:
        memory *= 1 - forgetting**samples
    return float(row * np.sqrt(memory))


@checked
def exponential_weights(
    rows: Count, forgetting: Annotated[float, within(above=0.0, at_most=1.0)]
) -> np.ndarray:
    """Weights of the rows of A and b, oldest first: forgetting^((t - j) / 2)."""
    require_memory("rows", rows)
    return forgetting ** (np.arange(rows - 1, -1, -1) / 2)


@checked
def noise_bound(deviation: NonNegative, unknowns: Count, forgetting: Fraction) -> float:
    """Typical 2-norm of the weighted perturbation when its entries are independent noise.

    deviation (sqrt(m) + sqrt(unknowns)) with m = 1 / (1 - forgetting) effective rows: the expected norm
    of a random matrix (Davidson and Szarek 2001, Theorem II.13, an upper bound on it). The guaranteed
    bound of `exponential_bound` grows as sqrt(m unknowns) and is then needlessly large.
    """
    return float(deviation * (1 / np.sqrt(1 - forgetting) + np.sqrt(unknowns)))


@checked
def coloured_noise_bound(
    noise: Spectrum,
    taps: Count,
    forgetting: Fraction,
    *,
    coverage: Fraction = 0.975,
    draws: Count = 200,
    seed: Natural = 0,
) -> float:
    """Bound that the 2-norm of the weighted perturbation of FIR regressors by noise of known density rarely exceeds.

    A quantile over realisations of the noise; `noise_bound` is for white noise. How far the norm scatters below it is
    a matter of bandwidth times memory, 1 / (1 - forgetting) in s: from 80 on, such as 400 Hz and 0.2 s, 95 % of the
    norms exceed 0.8 of the bound; a narrower band scatters more, however well its density is known.

    Parameters
    ----------
    noise : Spectrum
        Density of one channel, from 0 to half the sample rate, such as `estimate_spectrum` of a sensor at rest.
    taps : int
        Length of the impulse response.
    forgetting : float
        lambda, between 0 and 1.
    coverage : float
        Share of the realisations that stay below.
    draws : int
        Realisations.
    seed : int
        Seed of the random numbers.

    Returns
    -------
    float
        In the unit of the noise.

    Raises
    ------
    InputError
        For a spectrum of several channels, or a memory that takes too many samples.

    Examples
    --------
    >>> rest = np.random.default_rng(1).standard_normal(64_000)  # m/s^2, of a sensor at rest, at 3.2 kHz
    >>> spectrum = signals.estimate_spectrum(np.diff(rest), sample_rate=3200.0, resolution_hz=50.0)
    >>> round(identification.coloured_noise_bound(spectrum, taps=4, forgetting=0.99, draws=50))  # m/s^2
    22
    """
    if len(noise.density) != 1:
        raise InputError(f"noise has {len(noise.density)} channels; give the spectrum of one")
    rng = np.random.default_rng(seed)
    rows = require_samples("forgetting", np.ceil(7 / (1 - forgetting)))  # older ones count for a thousandth
    length = rows + taps - 1
    lines = np.linspace(0, noise.frequencies_hz[-1], length // 2 + 1)
    density = np.interp(lines, noise.frequencies_hz, noise.density[0])
    scale = np.sqrt(density * noise.frequencies_hz[-1] * length / 2)
    weights = exponential_weights(rows, forgetting)[::-1, None]
    norms = np.empty(draws)
    for draw in range(draws):
        parts = rng.standard_normal((2, len(lines)))
        signal = np.fft.irfft(scale * (parts[0] + 1j * parts[1]), length)
        norms[draw] = np.linalg.norm(weights * np.lib.stride_tricks.sliding_window_view(signal, taps), 2)
    return float(np.quantile(norms, coverage))
