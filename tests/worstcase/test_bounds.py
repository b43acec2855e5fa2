"""Bounds from data: of noise with a known spectrum."""

import numpy as np
import pytest
from scipy import signal

from stillwork.identification import coloured_noise_bound, fir_regressors
from stillwork.signals import estimate_spectrum
from stillwork.signals.spectra import Spectrum

RATE, TAPS, FORGETTING = 3200.0, 32, 1 - 1 / 640  # Hz; a memory of 0.2 s


def sample_noise(rng, band_hz, samples):
    """White noise through a band-pass, in the time domain, settled."""
    sections = signal.butter(4, band_hz, "bandpass", fs=RATE, output="sos")
    return signal.sosfilt(sections, rng.standard_normal(samples + 2000))[2000:]


def weighted_norm(noise):
    errors = fir_regressors(noise, TAPS)[:, TAPS - 1 :]
    weights = FORGETTING ** np.arange(errors.shape[1] - 1, -1, -1)
    return np.sqrt(np.linalg.eigvalsh((errors * weights) @ errors.T)[-1])


def shares(bands, records):
    """Of so many records a band: the share under a bound from another record, and over 0.8 of it."""
    rng = np.random.default_rng(20)
    under = []
    for band in bands:
        rest = estimate_spectrum(sample_noise(rng, band, 64_000), RATE, 10.0)
        bound = coloured_noise_bound(rest, TAPS, FORGETTING)
        under += [weighted_norm(sample_noise(rng, band, 6000)) / bound for _ in range(records)]
    return np.mean(np.array(under) <= 1), np.mean(np.array(under) > 0.8)


@pytest.mark.slow
def test_the_bound_of_coloured_noise_holds_and_is_no_larger_than_it_must():
    """200 records of bands of 400 Hz and more, 80 and more times the inverse of the memory."""
    under, over = shares([(100.0, 1500.0), (100.0, 600.0), (400.0, 800.0), (1000.0, 1400.0)], 50)
    assert under >= 0.95
    assert over >= 0.95


@pytest.mark.slow
def test_the_norm_of_narrow_noise_scatters_more_than_a_fifth():
    under, over = shares([(400.0, 450.0)], 100)
    assert under > 0.85
    assert over < 0.9


def test_the_bound_follows_the_unit_and_the_seed():
    frequencies = np.linspace(0, 1600, 30)
    spectrum, louder = (
        Spectrum(frequencies, size * (1 + frequencies[None] / 1e3), 1) for size in (1e-3, 4e-3)
    )
    bound = coloured_noise_bound(spectrum, 5, 0.95, draws=20)
    assert coloured_noise_bound(louder, 5, 0.95, draws=20) == pytest.approx(2 * bound, rel=1e-12)
    assert coloured_noise_bound(spectrum, 5, 0.95, draws=20) == bound
    assert coloured_noise_bound(spectrum, 5, 0.95, draws=20, seed=1) != bound


def test_the_bound_of_one_tap_is_that_of_a_weighted_sum_of_squares():
    """White noise of variance 2: mean m and variance 2 / (1 - lambda^2) of the sum, near its normal limit."""
    spectrum = Spectrum(np.array([0.0, 0.5]), np.full((1, 2), 4.0), 1)
    found = coloured_noise_bound(spectrum, 1, 0.999, coverage=0.5, draws=400) ** 2 / 2
    deviation = np.sqrt(2 / (1 - 0.999**2))
    assert found == pytest.approx(
        1000, abs=1 + 3 * 1.25 * deviation / 20
    )  # of the median of 400, and what 7 memories cut off
