from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from experiments.isolation import load_twin
from stillwork.control import isolation_filters as shaping

SAMPLE_TIME = 2e-4
PRINTED = load_twin("rigid_body").feedforward
PATH, SHAPING = PRINTED.path, PRINTED.shaping
RESONANCE = shaping.FrequencyNotch(962.0)
CUTOFF = 4 * np.pi
FREQUENCIES = np.geomspace(0.05, 2400, 600)
Z = np.exp(2j * np.pi * FREQUENCIES * SAMPLE_TIME)
S = 2 / SAMPLE_TIME * (Z - 1) / (Z + 1)  # where Tustin's rule evaluates a continuous filter


def response(sections):
    return signal.freqz_sos(sections, FREQUENCIES, fs=1 / SAMPLE_TIME)[1]


def path_response(path):
    """Of (2) by Tustin's rule, without delay."""
    own = S**2 / (path.mass * S**2 + path.damping * S + path.stiffness)
    return own * path.actuator_pole / (S + path.actuator_pole)


def warped(frequency_hz):
    return 2 / SAMPLE_TIME * np.tan(np.pi * frequency_hz * SAMPLE_TIME)


def notch(s, frequency_hz, width, depth):
    w = warped(frequency_hz)
    return (s**2 + depth * width * w * s + w**2) / (s**2 + width * w * s + w**2)


def band(s):
    """The noise shaping of Section 4.2 without its suspension, written out."""
    high, low = warped(6.0), warped(300.0)
    result = s**3 / ((s + high) * (s**2 + high * s + high**2))
    result = result * low**3 / ((s + low) * (s**2 + low * s + low**2))
    for frequency, width in ((962.0, 1.0), (50.0, 0.1), (100.0, 0.1), (200.0, 0.1)):
        result = result * notch(s, frequency, width, 0.01)
    return result


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6])
def test_weak_integrator_is_eq_11(order):
    got = response(shaping.weak_integrator(order, CUTOFF, 1.0, SAMPLE_TIME))
    lowpass = (CUTOFF / (S + CUTOFF)) ** order
    # The difference of eq. (11) cancels below the cut-off: its own rounding is eps / |1 - L|.
    np.testing.assert_allclose(got, (1 - lowpass) / S, rtol=1e-9)


def test_noise_shaping_is_section_4_2():
    path = PATH
    got = response(shaping.noise_shaping(SHAPING, path, SAMPLE_TIME))
    expected = band(S) * S**2 / (1.4 * S**2 + 290 * S + 60e3)
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-12)


def test_inverse_times_path_is_the_noise_shaping():
    path, settings = PATH, SHAPING
    through = path_response(path)
    inverse = response(shaping.inverse_secondary_shaping(settings, path, SAMPLE_TIME))
    wanted = response(shaping.noise_shaping(settings, path, SAMPLE_TIME))
    np.testing.assert_allclose(inverse * through, wanted, rtol=1e-7)
    w_a = 2 * np.pi * 300
    np.testing.assert_allclose(inverse, band(S) * (S + w_a) / w_a, rtol=1e-7, atol=1e-10)


@pytest.mark.slow
@settings(derandomize=True)
@given(
    mass=st.floats(0.1, 100),
    damping=st.floats(1, 1e4),
    stiffness=st.floats(1e3, 1e6),
    pole=st.floats(50, 5e3),
)
def test_any_mode_is_inverted(mass, damping, stiffness, pole):
    path, settings = PATH, SHAPING
    mode = shaping.SecondaryPath(mass, damping, stiffness, pole)
    inverse = shaping.inverse_secondary_shaping(settings, path, SAMPLE_TIME, mode)
    product = response(inverse) * path_response(mode)
    wanted = response(shaping.noise_shaping(settings, path, SAMPLE_TIME))
    assert np.abs(product - wanted).max() < 1e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("order", [2, 3, 4])
def test_filters_have_their_poles_inside_and_none_at_minus_one(order):
    path, settings = PATH, replace(SHAPING, order=order)
    for design in (shaping.noise_shaping, shaping.inverse_secondary_shaping):
        poles = signal.sos2zpk(design(settings, path, SAMPLE_TIME))[1]
        assert np.abs(poles).max() < 1
        assert np.abs(poles + 1).min() > 0.1


def test_conditioning_matches_the_analogue_filter_in_the_band():
    sections = shaping.conditioning(SAMPLE_TIME, 0.1, 3000.0)
    inside = FREQUENCIES < 300
    jw = 2j * np.pi * FREQUENCIES[inside]
    high, low = 2 * np.pi * 0.1, 2 * np.pi * 3000
    analogue = jw**2 / (jw**2 + np.sqrt(2) * high * jw + high**2)
    analogue = analogue * low**2 / (jw**2 + np.sqrt(2) * low * jw + low**2)
    ratio = response(sections)[inside] / analogue
    assert np.abs(np.angle(ratio, deg=True)).max() < 0.2
    assert np.abs(np.abs(ratio) - 1).max() < 1e-3


def test_skyhook_is_eq_1():
    got = response(shaping.skyhook(225.0, SAMPLE_TIME, notch=RESONANCE))
    np.testing.assert_allclose(got, 225 / (S + 1) * notch(S, 962.0, 1.0, 0.01), rtol=1e-8)
    np.testing.assert_allclose(response(shaping.skyhook(225.0, SAMPLE_TIME)), 225 / (S + 1), rtol=1e-9)


def test_weak_integrator_is_controls_tustin():
    s = control.tf("s")
    lowpass = (CUTOFF / (s + CUTOFF)) ** 3
    continuous = control.minreal((1 - lowpass) / s, 1e-6, verbose=False)
    discrete = control.c2d(continuous, SAMPLE_TIME, "tustin")
    expected = discrete(Z)
    np.testing.assert_allclose(
        response(shaping.weak_integrator(3, CUTOFF, 1.0, SAMPLE_TIME)), expected, rtol=1e-4
    )
