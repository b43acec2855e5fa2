"""Spectra against closed forms: white noise, sines, Parseval, known filters; and scipy's own estimators."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from stillwork.signals.spectra import band_power, estimate_response, estimate_spectrum

RATE = 1000.0


def noise(channels, seconds, seed=0):
    return np.random.default_rng(seed).standard_normal((channels, int(seconds * RATE)))


def test_white_noise_has_density_two_over_rate():
    spectrum = estimate_spectrum(3.0 * noise(1, 400), RATE, 1.0)
    # Half-overlapping Hann segments count about 0.95 each in a mean over all lines and segments.
    error = 1 / np.sqrt(0.5 * spectrum.averages * len(spectrum.frequencies_hz))
    assert spectrum.density[0, 2:-2].mean() == pytest.approx(9 * 2 / RATE, rel=4 * error)


def test_the_power_of_all_lines_is_the_variance():
    rows = noise(2, 200)
    spectrum = estimate_spectrum(rows, RATE, 0.5)
    assert spectrum.density.sum(axis=1) * 0.5 == pytest.approx(rows.var(axis=1), rel=5e-3)


@settings(max_examples=20, deadline=None)
@given(frequency=st.floats(20, 450), amplitude=st.floats(1e-6, 1e3))
def test_a_sine_carries_half_its_squared_amplitude(frequency, amplitude):
    t = np.arange(int(20 * RATE)) / RATE
    spectrum = estimate_spectrum(amplitude * np.sin(2 * np.pi * frequency * t), RATE, 1.0)
    assert spectrum.power(frequency - 5, frequency + 5)[0] == pytest.approx(amplitude**2 / 2, rel=1e-3)


def test_band_power_is_exact_for_a_straight_line():
    f = np.array([0.0, 1.0, 2.5, 7.0])
    assert band_power(f, 2 + 3 * f, 0.3, 6.1) == pytest.approx(2 * 5.8 + 1.5 * (6.1**2 - 0.3**2), rel=1e-12)


def mimo_filter(x):
    """Three known filters in a 2x2 matrix with one zero entry."""
    b, a = signal.butter(2, 80, fs=RATE)
    return np.array([signal.lfilter(b, a, x[0]) - 0.5 * x[1], 2 * np.roll(x[1], 1)]), (b, a)


def test_response_of_a_known_system_is_found_with_correlated_inputs():
    x = noise(2, 300)
    x[1] += 0.8 * x[0]
    y, (b, a) = mimo_filter(x)
    estimate = estimate_response(x, y, RATE, 1.0)
    z = np.exp(-2j * np.pi * estimate.frequencies_hz / RATE)
    truth = np.polyval(b[::-1], z) / np.polyval(a[::-1], z)
    band = slice(2, -2)
    # No output noise: what remains is leakage of the window.
    assert np.abs(estimate.response[0, 0] - truth)[band].max() < 5e-3
    assert np.abs(estimate.response[0, 1] + 0.5)[band].max() < 5e-3
    assert np.abs(estimate.response[1, 0])[band].max() < 5e-3
    assert np.abs(estimate.response[1, 1] - 2 * z)[band].max() < 2e-2
    assert estimate.coherence[:, band].min() > 0.999


@pytest.mark.slow
def test_residual_is_the_output_noise_even_with_few_averages():
    x = noise(2, 500)
    y, _ = mimo_filter(x)
    few = [
        estimate_response(x[:, a : a + 8000], (y + 0.3 * noise(2, 500, 1))[:, a : a + 8000], RATE, 1.0)
        for a in range(0, 480_000, 8000)
    ]
    residual = np.mean([e.residual[:, 5:-5].mean(axis=1) for e in few], axis=0)
    # Overlapping segments are worth fewer averages than counted: 15 count as about 14, hence 1 to 2 %.
    assert residual == pytest.approx(0.09 * 2 / RATE, rel=0.03)


def test_coherence_and_response_agree_with_scipy_for_one_input():
    x = noise(1, 60)
    y = signal.lfilter([1.0, 0.5], [1.0, -0.3], x) + noise(1, 60, 5)
    estimate = estimate_response(x, y, RATE, 2.0)
    f, coherence = signal.coherence(x[0], y[0], RATE, nperseg=500)
    _, cross = signal.csd(x[0], y[0], RATE, nperseg=500)
    _, power = signal.welch(x[0], RATE, nperseg=500)
    assert estimate.frequencies_hz == pytest.approx(f)
    assert estimate.coherence[0] == pytest.approx(coherence, rel=1e-9)
    # Constant detrending leaves rounding at 0 Hz, where the quotient means nothing.
    assert np.abs(estimate.response[0, 0] - cross / power)[1:].max() < 1e-9


@pytest.mark.parametrize("samples", [100, 111])
def test_coherent_and_residual_density_add_up_to_welchs(samples):
    """Up to both ends, where a line has no other half: at 0 Hz, and at the last one of even segments."""
    x = noise(1, 20)
    y = 2 * x + noise(1, 20, 5)
    estimate = estimate_response(x, y, RATE, RATE / samples)
    _, power = signal.welch(y[0], RATE, nperseg=samples)
    # One input takes one of the averages: the residual is unbiased.
    left = estimate.residual[0] * (1 - 1 / estimate.averages)
    assert left == pytest.approx(power * (1 - estimate.coherence[0]), rel=1e-9)
