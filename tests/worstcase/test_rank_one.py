import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from notebooks.worstcase.time_updates import run_printed, update_eigenpairs


def check(values, vectors, row, forgetting=0.9, tolerance=1e-13):
    before = vectors.T @ np.diag(values) @ vectors
    expected = forgetting * before + np.outer(row, row)
    values, vectors = values.copy(), vectors.copy()
    update_eigenpairs(values, vectors, row, forgetting)
    scale = max(np.linalg.norm(expected, 2), 1e-300)
    assert (np.diff(values) >= 0).all()
    assert vectors @ vectors.T == pytest.approx(np.eye(len(row)), abs=tolerance)
    assert vectors.T @ np.diag(values) @ vectors == pytest.approx(expected, abs=tolerance * scale)
    assert values == pytest.approx(np.linalg.eigvalsh(expected), abs=tolerance * scale)
    return values, vectors


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.floats(0, 12), st.floats(-6, 6))
def test_update_agrees_with_a_full_eigendecomposition(seed, n, spread, size):
    rng = np.random.default_rng(seed)
    values = np.sort(10.0 ** (-spread * rng.random(n)))
    vectors = np.linalg.qr(rng.normal(size=(n, n)))[0]
    check(values, np.ascontiguousarray(vectors), 10.0**size * rng.normal(size=n))


@pytest.mark.parametrize(
    ("values", "row"),
    [
        ([0.0, 0.0, 0.0], [1.0, 2.0, 3.0]),  # first sample of all
        ([1.0, 1.0, 1.0], [1.0, 2.0, 3.0]),  # equal eigenvalues: two deflate
        ([1.0, 1.0 + 1e-16, 2.0], [1.0, 1.0, 1.0]),
        ([1.0, 1.0 + 1e-12, 2.0], [1.0, 1.0, 1.0]),  # close, not equal
        ([1.0, 2.0, 3.0], [0.0, 1.0, 0.0]),  # along an eigenvector
        ([1.0, 2.0, 3.0], [0.0, 0.0, 0.0]),  # nothing new
        ([1.0, 2.0, 3.0], [1.0, 1e-17, 1.0]),
        ([1.0, 2.0, 3.0], [1e-9, 1e-9, 1e-9]),  # roots next to their poles
        ([1e-20, 1.0, 1e20], [1.0, 1.0, 1.0]),
    ],
)
def test_update_in_the_cases_that_deflate(values, row):
    check(np.array(values), np.eye(3), np.array(row))


def test_a_thousand_updates_stay_orthogonal():
    rng = np.random.default_rng(0)
    values, vectors = np.zeros(30), np.eye(30)
    for _ in range(1000):
        update_eigenpairs(values, vectors, rng.normal(size=30), 0.98)
    assert vectors @ vectors.T == pytest.approx(np.eye(30), abs=1e-12)


@pytest.mark.parametrize("size", [1e-60, 1.0, 1e60])
def test_the_fast_recursion_is_the_exact_one(size):
    """On a record with a silence, in which all but one eigenvalue drown in rounding, and in any unit."""
    rng = np.random.default_rng(2)
    rows = size * rng.normal(size=(4, 120))
    rows[:, 60:70] = 0.0
    outputs = rows.sum(axis=0) + 0.3 * size * rng.normal(size=120)
    fast, exact = (run_printed(update, 0, rows, outputs, 0.5 * size, 0.9) for update in ("fast", "exact"))
    assert fast.estimates == pytest.approx(exact.estimates, abs=1e-6)
    assert np.array_equal(np.isinf(fast.alphas), np.isinf(exact.alphas))
