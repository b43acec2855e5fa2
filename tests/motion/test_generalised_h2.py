import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.motion.energy_to_peak import (
    ErrorSystem,
    error_system,
    generalised_h2_norm,
    predictor_gains,
    response_peak,
)
from stillwork.base.checks import InputError


def problem(seed, samples=12, n=3, outputs=1):
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(n, n)) / np.sqrt(n)
    return rng, (
        a,
        rng.normal(size=(n, 2)),
        rng.normal(size=(samples, outputs, n)),
        np.eye(2),
        0.3 * np.eye(outputs),
    )


def stacked_norm(system):
    """The definition: the largest singular value of the map from all noises to the error at each sample."""
    samples, n, noises = system.d.shape
    largest = 0.0
    rows = np.zeros((n, samples * noises))
    for k in range(samples):
        rows = system.f[k] @ rows
        rows[:, k * noises : (k + 1) * noises] += system.d[k]
        largest = max(largest, np.linalg.svd(rows, compute_uv=False)[0])
    return largest


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6))
def test_norm_is_the_largest_singular_value_of_the_stacked_map(seed):
    _, parts = problem(seed)
    system = error_system(*parts, predictor_gains(*parts))
    assert generalised_h2_norm(system).norm == pytest.approx(stacked_norm(system), rel=1e-10)


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6))
def test_the_worst_disturbance_reaches_the_norm_and_no_other_exceeds_it(seed):
    rng, parts = problem(seed)
    system = error_system(*parts, predictor_gains(*parts))
    found = generalised_h2_norm(system)
    assert np.linalg.norm(found.worst) == pytest.approx(1, rel=1e-12)
    assert response_peak(system, found.worst) == pytest.approx(found.norm, rel=1e-10)
    for _ in range(20):
        other = rng.normal(size=found.worst.shape)
        assert response_peak(system, other / np.linalg.norm(other)) <= found.norm * (1 + 1e-12)


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), size=st.floats(1e-4, 1.0))
def test_no_other_gains_have_a_smaller_norm(seed, size):
    """Theorem 5.5.1: the Gramian of any predictor exceeds that of the Kalman predictor, sample by sample."""
    rng, parts = problem(seed)
    best = predictor_gains(*parts)
    optimal = generalised_h2_norm(error_system(*parts, best))
    other = generalised_h2_norm(error_system(*parts, best + size * rng.normal(size=best.shape)))
    scale = np.abs(other.gramians).max()
    for ours, theirs in zip(optimal.gramians, other.gramians, strict=True):
        assert np.linalg.eigvalsh(theirs - ours)[0] >= -1e-12 * scale
    assert optimal.norm <= other.norm * (1 + 1e-12)


def test_gramians_are_the_covariances_of_the_riccati_recursion():
    """(5.37) as printed, from a known state."""
    _, (a, g, c, q, r) = problem(4)
    found = generalised_h2_norm(error_system(a, g, c, q, r, predictor_gains(a, g, c, q, r)))
    p = np.zeros((3, 3))
    for k, row in enumerate(c):
        gain = a @ p @ row.T @ np.linalg.inv(row @ p @ row.T + r)
        p = g @ q @ g.T + a @ p @ a.T - gain @ row @ p @ a.T
        np.testing.assert_allclose(found.gramians[k + 1], p, rtol=1e-10, atol=1e-12)


def test_semidefinite_program_finds_the_same_gain():
    """One step of Lemma 5.5.2 by a convex solver: the least P(k+1) over all gains."""
    import cvxpy as cp

    _, (a, g, c, q, r) = problem(7, samples=3)
    gains = predictor_gains(a, g, c, q, r)
    p = generalised_h2_norm(error_system(a, g, c, q, r, gains)).gramians[2]
    gain = cp.Variable((3, 1))
    following = cp.Variable((3, 3), symmetric=True)
    rows = cp.hstack(
        [(a - gain @ c[2]) @ np.linalg.cholesky(p), g @ np.linalg.cholesky(q), -gain * np.sqrt(r[0, 0])]
    )
    size = rows.shape[1]
    whole = cp.bmat([[following, rows], [rows.T, np.eye(size)]])
    cp.Problem(cp.Minimize(cp.trace(following)), [whole >> 0]).solve(solver=cp.CLARABEL)
    np.testing.assert_allclose(gain.value, gains[2], rtol=1e-3, atol=1e-4)


def test_bad_input_is_named():
    _, (a, g, c, q, r) = problem(1)
    with pytest.raises(InputError, match="gains"):
        error_system(a, g, c, q, r, np.zeros((2, 3, 1)))
    with pytest.raises(InputError, match="sensor is not positive definite"):
        error_system(a, g, c, q, -r, np.zeros((12, 3, 1)))
    growing = ErrorSystem(np.full((400, 1, 1), 1e3), np.ones((400, 1, 1)))
    with pytest.raises(InputError, match="grows without bound"):
        generalised_h2_norm(growing)
