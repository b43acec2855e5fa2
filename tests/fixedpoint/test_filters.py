"""Every filter against its naive twin, scipy or filterpy, on the same data."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from scipy.signal import savgol_coeffs

from naive import fixedpoint as naive
from stillwork.base.checks import InputError
from stillwork.estimation import LowPass, filter_signal
from stillwork.estimation.coordinate_filters import (
    ExtendedKalman,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
)
from stillwork.estimation.filter_step import end_point_weights, filter_step
from stillwork.estimation.filtering import model_of
from stillwork.estimation.unscented import SigmaPoints

SAMPLE_TIME = 1e-3
LOST = (1, 50, 51, 52, 100, 102, 398, 399)


@pytest.fixture
def record(approximate, rng):
    """A noisy motion and a force that explains part of it."""
    time = np.arange(400) * SAMPLE_TIME
    measured = 0.5 * np.sin(3 * time) + 0.1 * np.sin(40 * time) + 1e-4 * rng.standard_normal(400)
    force = 20 * np.cos(3 * time) + rng.standard_normal(400)
    return measured, force


def twins(approximate):
    p = approximate.parameters
    kalman = UnscentedKalman(approximate)
    return {
        "window": (MovingWindow(), naive.MovingWindow(12, SAMPLE_TIME)),
        "short window": (MovingWindow(1), naive.MovingWindow(1, SAMPLE_TIME)),
        "low pass": (LowPass(), naive.LowPass(350.0, SAMPLE_TIME, past=1000)),
        "low pass from zero": (LowPass(from_zero=True), naive.LowPass(350.0, SAMPLE_TIME)),
        "Savitzky-Golay": (SavitzkyGolay(15, 3, SAMPLE_TIME), naive.SavitzkyGolay(15, 3, SAMPLE_TIME)),
        "UKF": (kalman, naive.PlantUnscented(p, kalman.process, kalman.noise, 1e-3, SAMPLE_TIME)),
        "literal UKF": (
            UnscentedKalman(approximate, literal=True),
            naive.PlantUnscented(p, kalman.process, kalman.noise, 1e-3, SAMPLE_TIME, literal=True),
        ),
    }


NAMES = [
    "window",
    "short window",
    "low pass",
    "low pass from zero",
    "Savitzky-Golay",
    "UKF",
    "literal UKF",
]


@pytest.mark.parametrize("name", NAMES)
def test_naive_twin(name, approximate, record):
    measured, force = record
    fast, slow = twins(approximate)[name]
    found = filter_signal(fast, measured, force, sample_time=SAMPLE_TIME, start_velocity=1.5)
    last, expected = 0.0, []
    for z, u in zip(measured, force, strict=True):
        expected.append(np.array(slow(z, last, np.array([0.0, 1.5, 0.0]))))
        last = u
    expected = np.array(expected).T
    for got, want in zip((found.position, found.velocity, found.acceleration), expected, strict=True):
        # The unscented weights of 1e4 cost four digits, differences over 1 ms three more a derivative.
        assert np.abs(got - want).max() < 1e-9 * max(1.0, np.abs(want).max())


@pytest.mark.parametrize(("samples", "degree"), [(5, 2), (25, 3), (61, 4)])
@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_savitzky_golay_weights(samples, degree, derivative):
    expected = savgol_coeffs(samples, degree, derivative, pos=samples - 1, use="dot")
    found = end_point_weights(samples, degree, derivative)
    assert found == pytest.approx(expected, rel=1e-8, abs=1e-12)


def test_the_low_pass_starts_from_what_is_presumed():
    """As after a long past of that velocity, whatever position was presumed; an acceleration is there at once."""
    measured = 2.0 - 0.7 * np.arange(300) * SAMPLE_TIME
    twin, device = naive.LowPass(90.0, SAMPLE_TIME, past=2000), LowPass(90.0).packed()
    estimate = np.array([5.0, -0.7, 0.0])
    found, expected = [], []
    for z in measured:
        assert filter_step(device, *model_of(LowPass()), SAMPLE_TIME, z, 0.0, estimate)
        found.append(estimate.copy())
        expected.append(twin(z, 0.0, np.array([2.0, -0.7, 0.0])))
    assert np.abs(np.array(found) - expected).max() < 1e-9
    estimate, device = np.array([5.0, -0.7, 3.0]), LowPass(90.0).packed()
    assert filter_step(device, *model_of(LowPass()), SAMPLE_TIME, 2.0, 0.0, estimate)
    assert estimate[1:] == pytest.approx([-0.7, 3.0])


@pytest.mark.parametrize("lost", [(), LOST])
def test_unscented_is_filterpy_s(lost, approximate, record):
    """filterpy draws its points anew around the prediction, as the corrected (14) does."""
    measured, force = record
    measured[list(lost)] = np.nan
    p, kalman = approximate.parameters, UnscentedKalman(approximate)

    def move(x, dt, u):
        velocity = x[0] + dt * naive.oscillator(p, x[1], x[0], u)
        return np.array([velocity, x[1] + dt * velocity])

    points = MerweScaledSigmaPoints(2, 1e-2, 1e-3, 0.0)
    peer = UnscentedKalmanFilter(2, 2, SAMPLE_TIME, lambda x: x, move, points)
    peer.x, peer.P = np.array([0.0, measured[0]]), 1e-3 * np.eye(2)
    peer.Q, peer.R = kalman.process, kalman.noise
    found = filter_signal(kalman, measured, force)
    last_z, last_u, expected = measured[0], 0.0, []
    for z, u in zip(measured, force, strict=True):
        peer.predict(u=last_u)
        if not np.isnan(z) and np.isnan(last_z):  # no difference quotient yet: the position alone
            peer.update(np.array([z]), R=kalman.noise[1:, 1:], hx=lambda x: x[1:])
        elif not np.isnan(z):
            peer.update(np.array([(z - last_z) / SAMPLE_TIME, z]))
        expected.append(peer.x.copy())
        last_z, last_u = z, u
    expected = np.array(expected)
    assert np.abs(found.velocity - expected[:, 0]).max() < 1e-9
    assert np.abs(found.position - expected[:, 1]).max() < 1e-9
    believed = filter_signal(replace(kalman, model_acceleration=True), measured, force)
    pushed = np.append(0.0, force[:-1])
    wanted = [naive.oscillator(p, q, v, u) for (v, q), u in zip(expected, pushed, strict=True)]
    assert believed.acceleration == pytest.approx(wanted, abs=1e-6)
    assert np.array_equal(believed.velocity, found.velocity)


@pytest.mark.parametrize("lost", [(), LOST])
def test_extended_is_filterpy_s(lost, approximate, record):
    measured, force = record
    measured[list(lost)] = np.nan
    m, k, a, b1, b2, d = p = approximate.parameters
    ours = ExtendedKalman(approximate)
    found = filter_signal(ours, measured, force)
    peer = ExtendedKalmanFilter(3, 1)
    peer.x, peer.P = np.array([0.0, measured[0], 0.0]), np.diag([1.0, 1e-4, 100.0])
    peer.Q, peer.R = ours.packed().process, ours.packed().noise
    H = np.array([[0.0, 1.0, 0.0]])
    last, expected = 0.0, []
    for z, u in zip(measured, force, strict=True):
        v, q, w = peer.x
        by_v = (b1 * (a**2 - q**2) - b2 - 2 * d * abs(v)) / m
        by_q = (-k - 2 * b1 * q * v) / m
        row = np.array([1 + SAMPLE_TIME * by_v, SAMPLE_TIME * by_q, SAMPLE_TIME])
        peer.F = np.array([row, SAMPLE_TIME * row + [0, 1, 0], [0, 0, 1]])
        velocity = v + SAMPLE_TIME * (naive.oscillator(p, q, v, last) + w)
        moved = np.array([velocity, q + SAMPLE_TIME * velocity, w])
        peer.x = moved
        peer.P = peer.F @ peer.P @ peer.F.T + peer.Q
        if not np.isnan(z):
            peer.update(np.array([z]), lambda x: H, lambda x: x[1:2])
        acceleration = naive.oscillator(p, peer.x[1], peer.x[0], last) + peer.x[2]
        expected.append([peer.x[1], peer.x[0], acceleration])
        last = u
    for got, want in zip(
        (found.position, found.velocity, found.acceleration), np.transpose(expected), strict=True
    ):
        assert np.abs(got - want).max() < 1e-9 * max(1.0, np.abs(want).max())


@pytest.mark.parametrize("kind", [UnscentedKalman, ExtendedKalman])
def test_a_step_gives_the_numbers_of_the_record(kind, approximate, record):
    measured, force = record
    measured[list(LOST)] = np.nan
    kalman = kind(approximate)
    found = filter_signal(kalman, measured, force, start_velocity=0.2)
    state, first = kalman.start(0.2), kalman.start(0.2)
    variances = []
    for k, z in enumerate(measured):
        state = kalman.step(state, z, force[k - 1] if k else 0.0)
        assert np.array_equal(state.estimate, [found.position[k], found.velocity[k], found.acceleration[k]])
        variances.append(state.covariance[1, 1])
    assert np.array_equal(
        variances[51:53], np.sort(variances[51:53])
    )  # the uncertainty grows while nothing is measured
    assert variances[52] > variances[53]
    assert not first.work.any()  # a step leaves the state that it is given


@pytest.mark.parametrize("size", [1, 2, 5])
def test_sigma_weights(size):
    spread, first, first_covariance, other = SigmaPoints(0.3, 2.0, 0.5).weights(size)
    expected = MerweScaledSigmaPoints(size, 0.3, 2.0, 0.5)
    assert first == pytest.approx(expected.Wm[0])
    assert first_covariance == pytest.approx(expected.Wc[0])
    assert other == pytest.approx(expected.Wm[1])
    assert spread == pytest.approx(0.09 * (size + 0.5))


def test_lost_definiteness_is_reported_with_the_sample(approximate):
    """The printed (14) with a large initial variance makes P indefinite in one step."""
    with pytest.raises(InputError, match=r"covariance.*sample 1\b"):
        filter_signal(UnscentedKalman(approximate, literal=True, initial_variance=1.0), np.zeros(10))
