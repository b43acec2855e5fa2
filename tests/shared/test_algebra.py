"""The kernels' algebra against numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import linalg

from stillwork.base import algebra
from stillwork.base.kernels import kernel


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def definite(rng, n):
    factor = rng.standard_normal((n, n + 1))
    return factor @ factor.T


def test_products_are_numpys(rng):
    a, b = rng.standard_normal((3, 4)), rng.standard_normal((4, 2))
    x, start = rng.standard_normal(4), rng.standard_normal(3)
    out = start.copy()
    algebra.add_product(a, x, out)
    np.testing.assert_allclose(out, start + a @ x, rtol=1e-13)
    algebra.set_product(a, x, out)
    np.testing.assert_allclose(out, a @ x, rtol=1e-12)
    product = np.empty((3, 2))
    algebra.multiply(a, b, product)
    np.testing.assert_allclose(product, a @ b, rtol=1e-12)


@given(rows=st.integers(1, 5), columns=st.integers(1, 5), seed=st.integers(0, 1000))
def test_sums_of_products_are_numpys(rows, columns, seed):
    rng = np.random.default_rng(seed)
    a, x, y = (rng.standard_normal(size) for size in ((rows, columns), columns, rows))
    i, j = rng.integers(rows), rng.integers(columns)
    assert algebra.inner_product(a[i], x) == pytest.approx(a[i] @ x, abs=1e-13)
    assert algebra.plus_row(0.3, a, i, x) == pytest.approx(0.3 + a[i] @ x, abs=1e-13)
    assert algebra.minus_row(0.3, a, i, x) == pytest.approx(0.3 - a[i] @ x, abs=1e-13)
    assert algebra.plus_column(0.3, a, j, y) == pytest.approx(0.3 + a[:, j] @ y, abs=1e-13)
    size = min(rows, columns)
    left = np.tril(a, -1)[size - 1] @ x
    assert algebra.plus_left(0.3, a, size - 1, x) == pytest.approx(0.3 + left, abs=1e-13)
    assert algebra.minus_left(0.3, a, size - 1, x) == pytest.approx(0.3 - left, abs=1e-13)
    target = y.copy()
    algebra.add_scaled(0.7, a[:, j], target)
    np.testing.assert_allclose(target, y + 0.7 * a[:, j], rtol=0, atol=1e-14)


@pytest.mark.parametrize("precision", [np.float64, np.float32])
def test_projection_keeps_the_precision_of_the_matrix(precision, rng):
    matrix, vector = rng.standard_normal((3, 3)).astype(precision), rng.standard_normal(3).astype(precision)
    out = np.empty(3, precision)
    found = algebra.project(matrix, vector, precision(0.5), out)
    summed = precision(0.5)
    for i in range(3):
        total = precision(0)
        for j in range(3):
            total += matrix[i, j] * vector[j]
        assert out[i] == total
        summed += total * vector[i]
    assert found == summed


def test_a_state_moves_on_with_its_input(rng):
    a, b, x = rng.standard_normal((3, 3)), rng.standard_normal(3), rng.standard_normal(3)
    state = x.copy()
    algebra.advance_state(a, b, 0.7, state, np.empty(3))
    np.testing.assert_allclose(state, a @ x + 0.7 * b, rtol=1e-12)


def test_congruence_and_squares_are_symmetric_to_the_last_bit(rng):
    a, p, g = rng.standard_normal((5, 5)), definite(rng, 5), rng.standard_normal((5, 2))
    out = p.copy()
    algebra.congruence(a, out, np.empty((5, 5)), out)
    algebra.add_square(g, out)
    np.testing.assert_allclose(out, a @ p @ a.T + g @ g.T, rtol=1e-11)
    np.testing.assert_array_equal(out, out.T)


@given(states=st.integers(1, 6), outputs=st.integers(1, 4), seed=st.integers(0, 1000))
def test_measurements_in_turn_are_those_at_once(states, outputs, seed):
    rng = np.random.default_rng(seed)
    p, rows, noise = (
        definite(rng, states),
        rng.standard_normal((outputs, states)),
        rng.uniform(0.1, 2, outputs),
    )
    gain = p @ rows.T @ np.linalg.inv(rows @ p @ rows.T + np.diag(noise))
    left, found = p.copy(), np.zeros((states, outputs))
    algebra.take_in_turn(left, rows, noise, found, np.empty(states))
    scale = np.abs(p).max()
    np.testing.assert_allclose(found, gain, atol=1e-8 * np.abs(gain).max())
    np.testing.assert_allclose(left, (np.eye(states) - gain @ rows) @ p, atol=1e-9 * scale)


def test_factorisations_solve(rng):
    p, right = definite(rng, 5), rng.standard_normal(5)
    factor, pivots, half, solution = np.zeros((5, 5)), np.zeros(5), np.zeros(5), np.zeros(5)
    algebra.factorise(p, 0.3, right, factor, pivots, half, np.zeros(5))
    algebra.solve_backward(factor, pivots, half, solution)
    np.testing.assert_allclose(solution, np.linalg.solve(p + 0.3 * np.eye(5), right), rtol=1e-9)
    again = np.zeros(5)
    algebra.solve_forward(factor, right, again)
    np.testing.assert_array_equal(again, half)
    root = np.zeros((5, 5))
    assert algebra.cholesky_root(p, root, 5)
    np.testing.assert_allclose(root, linalg.cholesky(p, lower=True), rtol=1e-10, atol=1e-14)
    algebra.cholesky_solve(root, right, solution)
    np.testing.assert_allclose(solution, np.linalg.solve(p, right), rtol=1e-9)
    algebra.cholesky_solve(root, right, right)  # in place
    np.testing.assert_array_equal(right, solution)
    assert not algebra.cholesky_root(p - 2 * np.linalg.norm(p) * np.eye(5), root, 5)
    assert not algebra.cholesky_root(np.ones((2, 2)), root, 2)  # semidefinite: it has a root, but no inverse


def test_inlining_into_a_caller_keeps_every_bit(rng):
    p, rows = definite(rng, 4), rng.standard_normal((2, 4))

    @kernel
    def caller(covariance, rows, noise, gain, cross):
        algebra.take_in_turn(covariance, rows, noise, gain, cross)

    results = []
    for function in (algebra.take_in_turn, caller):
        left, gain = p.copy(), np.zeros((4, 2))
        function(left, rows, np.ones(2), gain, np.empty(4))
        results.append((left, gain))
    for one, other in zip(*results, strict=True):
        np.testing.assert_array_equal(one, other)
