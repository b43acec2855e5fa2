import numpy as np
import pytest

from stillwork.control import asin_trajectory
from stillwork.control.trajectory import record_trajectory, sine_trajectory, trapezoid_trajectory

MAKERS = [sine_trajectory, asin_trajectory, trapezoid_trajectory]


@pytest.mark.parametrize("make", MAKERS)
def test_derivatives_are_exact(make):
    """The error of a central difference falls with the square of the sample time: the observed order is 2."""
    errors = []
    for sample_time in (1e-3, 5e-4):
        t = make(duration=5.0, sample_time=sample_time)
        velocity = (t.position[2:] - t.position[:-2]) / (2 * sample_time)
        errors.append(np.sqrt(np.mean((velocity - t.velocity[1:-1]) ** 2)))
        assert np.abs(velocity - t.velocity[1:-1]).max() < 2e-3
        bend = (t.position[2:] - 2 * t.position[1:-1] + t.position[:-2]) / sample_time**2
        assert np.sqrt(np.mean((bend - t.acceleration[1:-1]) ** 2)) < 2e-2
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("make", MAKERS)
def test_amplitude_and_period(make):
    t = make(amplitude=0.3, frequency_hz=0.5, duration=4.0)
    assert np.abs(t.position).max() == pytest.approx(0.3, rel=1e-6)
    assert t.position[2000:] == pytest.approx(t.position[:2000], abs=1e-9)
    assert abs(t.position[0]) < 1e-12


def test_asin_becomes_a_sine_and_a_triangle():
    assert asin_trajectory(sharpness=1e-4).position == pytest.approx(sine_trajectory().position, abs=1e-8)
    sharp = asin_trajectory(sharpness=1 - 1e-9, frequency_hz=0.25, duration=4.0)
    assert sharp.position[500] == pytest.approx(0.5, abs=1e-4)


def test_trapezoid_dwells():
    t = trapezoid_trajectory(rounding=0.4, frequency_hz=0.25, duration=4.0)
    assert t.velocity[1000] == 0 and t.position[1000] == pytest.approx(1.0)
    assert np.abs(np.diff(t.acceleration)).max() < 0.1  # continuous


def test_record_gives_back_a_motion():
    t = sine_trajectory(frequency_hz=1.0, duration=2.0)
    got = record_trajectory(t.time[::7], t.position[::7], 1e-3)
    n = len(got.position)
    assert got.position == pytest.approx(t.position[:n], abs=1e-8)
    assert got.velocity == pytest.approx(t.velocity[:n], abs=1e-5)
    assert got.acceleration[20:-20] == pytest.approx(t.acceleration[20 : n - 20], abs=1e-3)
