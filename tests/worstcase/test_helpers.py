import numpy as np
import pytest
from scipy import signal

from stillwork.estimation.linear_fits import total_least_squares
from stillwork.identification import fir_regressors
from stillwork.identification.regressors import exponential_bound, noise_bound


def test_lags_beyond_the_record_are_zero():
    assert fir_regressors([1.0, 2.0], 5) == pytest.approx(np.array([[1, 2], [0, 1], [0, 0], [0, 0], [0, 0]]))


def test_fir_regressors_convolve():
    rng = np.random.default_rng(0)
    u, x = rng.normal(size=50), rng.normal(size=4)
    assert x @ fir_regressors(u, 4) == pytest.approx(signal.lfilter(x, [1.0], u), abs=1e-13)


def test_bounds_hold_for_perturbations_within_them():
    rng = np.random.default_rng(2)
    epsilon = 0.5
    rows = rng.normal(size=(400, 2))
    rows *= epsilon / np.linalg.norm(rows, axis=1, keepdims=True)
    for t in (1, 5, 400):
        weights = 0.95 ** (np.arange(t - 1, -1, -1) / 2)
        size = np.linalg.norm(weights[:, None] * rows[:t], 2)
        allowed = exponential_bound(epsilon, 0.95, t)
        assert size <= allowed * (1 + 1e-12)
        assert allowed <= exponential_bound(epsilon, 0.95)
    assert exponential_bound(0.25, 0.95) == pytest.approx(0.25 / np.sqrt(0.05))
    # the bound is attained when every row errs in the same direction
    weights = 0.95 ** (np.arange(9, -1, -1) / 2)
    same = np.linalg.norm(weights[:, None] * np.array([[0.3, 0.4]]), 2)
    assert same == pytest.approx(exponential_bound(0.5, 0.95, 10))


def test_noise_bound_is_the_norm_of_noise_and_below_the_guaranteed_one():
    rng = np.random.default_rng(3)
    weights = 0.99 ** (np.arange(1999, -1, -1) / 2)
    sizes = [np.linalg.norm(weights[:, None] * rng.normal(size=(2000, 20)), 2) for _ in range(20)]
    assert 0.8 * noise_bound(1.0, 20, 0.99) < np.mean(sizes) < noise_bound(1.0, 20, 0.99)
    assert noise_bound(1.0, 20, 0.99) < exponential_bound(np.sqrt(20), 0.99)


def test_total_least_squares_take_the_smallest_correction():
    rng = np.random.default_rng(4)
    A = rng.normal(size=(30, 3))
    b = A @ np.array([1.0, -2.0, 0.5]) + 0.1 * rng.normal(size=30)
    x = total_least_squares(A, b)
    # Closed form: (A'A - sigma^2 I) x = A'b with the smallest singular value of [A b]
    sigma = np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1]
    assert x == pytest.approx(np.linalg.solve(A.T @ A - sigma**2 * np.eye(3), A.T @ b))
    # of all corrections with which x solves the system, the smallest is (A x - b) [x; -1]' / (1 + |x|^2)
    assert np.linalg.norm(A @ x - b) / np.hypot(1, np.linalg.norm(x)) == pytest.approx(sigma)
