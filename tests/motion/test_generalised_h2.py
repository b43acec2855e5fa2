import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import linalg

from notebooks.motion.generalised_h2 import (
    error_system,
    generalised_h2_norm,
    inequality_margins,
    predictor_gains,
    response_peak,
    settled_covariance,
)


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


def test_the_inequalities_hold_above_the_norm_and_for_no_matrices_below_it():
    _, model = problem(0)
    system = error_system(*model, predictor_gains(*model))
    norm = generalised_h2_norm(system).norm
    n, m = system.f.shape[1], system.d.shape[2]
    for part in (1.001, 0.999):
        first, second = inequality_margins(system, part * norm)
        assert (second > 0) == (part > 1)
        assert first > 0
        # The inequalities as they are printed, from the same recursion.
        level, k = part * norm, []
        p = 1e-9 * np.abs(system.d[0] @ system.d[0].T).max() * np.eye(n)
        slack = p
        for f, d in zip(system.f, system.d, strict=True):
            after = (1 + 1e-9) * (f @ p @ f.T + d @ d.T) + slack
            now, then = level * np.linalg.inv(p), level * np.linalg.inv(after)
            printed = np.block(
                [
                    [then, then @ f, then @ d],
                    [f.T @ then, now, np.zeros((n, m))],
                    [d.T @ then, np.zeros((m, n)), level * np.eye(m)],
                ]
            )
            size = np.sqrt(np.diag(printed))
            assert np.linalg.eigvalsh(printed / np.outer(size, size))[0] > -1e-9
            eye, none = np.eye(n), np.zeros((n, n))
            k.append(
                np.linalg.eigvalsh(
                    np.block([[then, none, eye], [none, eye, none], [eye, none, level * eye]])
                )[0]
            )
            p = after
        assert (min(k) > 0) == (part > 1)


def test_the_recursion_settles_at_the_algebraic_solution():
    rng = np.random.default_rng(3)
    a, g, c = 0.9 * np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=(3, 1)), rng.normal(size=(1, 3))
    q, r = np.array([[2.0]]), np.array([[0.5]])
    found = settled_covariance(a, g, c, q, r, np.eye(3), 500)
    wanted = linalg.solve_discrete_are(a.T, c.T, g @ q @ g.T, r)
    np.testing.assert_allclose(found, wanted, rtol=1e-10)


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
