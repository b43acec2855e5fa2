import numpy as np
import pytest

from experiments.fixedpoint import Noise, steady_errors
from notebooks.fixedpoint.differentiation_noise import (
    correlations,
    difference_quotient,
    kalman_over_low_pass,
    quotient_autocorrelation,
    quotient_covariance,
    quotient_cross_correlation,
    quotient_trial,
    rejects_gaussian,
)
from stillwork.control.fixed_point_linear import linear_filter
from stillwork.estimation.coordinate_filters import UnscentedKalman

SAMPLE_TIME = 1e-3


def test_covariance_of_quotient_and_position(rng):
    error = 1e-4 * rng.standard_normal(300_000)
    found = np.cov(np.vstack([difference_quotient(error, SAMPLE_TIME), error[1:]]))
    assert found == pytest.approx(quotient_covariance(1e-4, SAMPLE_TIME), rel=0.02)


def test_correlations_of_white_error(rng):
    found = correlations(rng.logistic(size=200_000), SAMPLE_TIME)
    spread = 4 / np.sqrt(200_000)
    for lag, own, cross in zip(found.lags, found.quotient, found.cross, strict=True):
        assert own == pytest.approx(quotient_autocorrelation(int(lag)), abs=spread)
        assert cross == pytest.approx(quotient_cross_correlation(int(lag)), abs=spread)


@pytest.mark.parametrize("kind", ["gaussian", "logistic"])
def test_quotient_trial(kind, rng):
    """Mean 0, variance 2 (s / dt)^2 and correlation 1 / sqrt 2, each within five standard errors."""
    found = quotient_trial(rng, Noise(kind, 3e-5), 100_000, SAMPLE_TIME)
    assert found["mean"] == pytest.approx(0.0, abs=5e-5)  # the sum of quotients telescopes
    assert found["variance"] == pytest.approx(2.0, rel=0.04)
    assert found["correlation"] == pytest.approx(np.sqrt(0.5), abs=0.02)


def test_encoder_and_logistic_noise_are_told_from_gaussian(rng):
    assert not rejects_gaussian(rng.standard_normal(5000))
    assert rejects_gaussian(rng.logistic(size=5000))
    assert rejects_gaussian(rng.uniform(size=5000))


@pytest.mark.slow
def test_steady_errors_against_a_long_run(rng):
    """The believed and the true covariance, by simulating the filter's error with the noise that it gets."""
    F = np.array([[0.95, -0.05], [0.95e-3, 1.0 - 0.05e-3]])
    Q, R = np.diag([1e-2, 1e-9]), np.diag([2e-2, 1e-8])
    found = steady_errors(F, Q, R, 1e-4, SAMPLE_TIME)
    n, k = 1e-4 * rng.standard_normal(80_001), found.gain
    w = rng.standard_normal((80_001, 2)) * np.sqrt(np.diag(Q))
    e, errors = np.zeros(2), []
    for i in range(1, 80_001):
        v = np.array([(n[i] - n[i - 1]) / SAMPLE_TIME, n[i]])
        e = (np.eye(2) - k) @ (F @ e + w[i]) - k @ v
        errors.append(e)
    assert np.cov(np.array(errors[1000:]).T) == pytest.approx(found.true, rel=0.05, abs=1e-9)


def test_gain_is_the_filter_s(approximate):
    """The same steady gain as in the linear form of the unscented filter, which iterates its own way."""
    kalman = UnscentedKalman(approximate)
    linear = linear_filter(kalman, SAMPLE_TIME)
    from stillwork.estimation.plant import partial_derivatives

    by_q, by_v, _ = partial_derivatives(approximate, 0.0, 0.0, 0.0)
    row = np.array([1 + SAMPLE_TIME * by_v, SAMPLE_TIME * by_q])
    F = np.array([row, SAMPLE_TIME * row + [0, 1]])
    gain = steady_errors(F, kalman.process, kalman.noise, 1e-4, SAMPLE_TIME).gain
    assert linear.B[:2, 0] == pytest.approx(gain @ [1 / SAMPLE_TIME, 1.0], rel=1e-9)


def test_white_and_independent_noise_is_what_the_filter_believes():
    """With negligible noise of its own making the true error is what the process noise leaves."""
    F, Q, R = np.diag([0.9, 0.8]), np.diag([1.0, 2.0]), np.diag([0.5, 0.7])
    found = steady_errors(F, Q, R, 0.0, SAMPLE_TIME)
    assert (np.linalg.eigvalsh(found.computed - found.true) > 0).all()


def test_a_kalman_filter_of_first_order_computes_what_the_scalar_riccati_equation_has():
    rate, deviation = 1e-5, 1e-4
    before = (rate**2 + np.sqrt(rate**4 + 4 * rate**2 * deviation**2)) / 2  # positive root of P^2 = q (P + r)
    found = kalman_over_low_pass(1, rate, deviation, 1e-3, seed=3, samples=20_000)
    assert found["computed"] == pytest.approx(
        np.sqrt(before * deviation**2 / (before + deviation**2)), rel=1e-9
    )
    assert found["kalman"] == pytest.approx(found["computed"], rel=0.1)
    assert found["ratio"] == found["kalman"] / found["low pass"] < 1
