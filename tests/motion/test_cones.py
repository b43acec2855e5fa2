"""Convex programs in cones, against closed forms and against the same programs in cvxpy."""

import cvxpy as cp
import numpy as np
import pytest
from scipy import linalg

from stillwork.lti.cones import minimise


def symmetric(seed, order):
    matrix = np.random.default_rng(seed).normal(size=(order, order))
    return matrix + matrix.T


@pytest.mark.parametrize("order", [1, 2, 5])
def test_the_largest_eigenvalue_is_the_least_bound_of_a_matrix(order):
    matrix = symmetric(order, order)
    found, status = minimise([1.0], lambda x: [x[0] * np.eye(order) - matrix])
    assert status == "optimal"
    assert found[0] == pytest.approx(np.linalg.eigvalsh(matrix)[-1], abs=1e-7)


def test_the_least_matrix_of_a_lyapunov_inequality_solves_the_equation():
    rng = np.random.default_rng(2)
    a = rng.normal(size=(3, 3)) - 3 * np.eye(3)
    row, column = np.tril_indices(3)

    def unpacked(x):
        p = np.zeros((3, 3))
        p[row, column] = p[column, row] = x
        return p

    found, _ = minimise(
        (row == column).astype(float), lambda x: [-(a @ unpacked(x) + unpacked(x) @ a.T + np.eye(3))]
    )
    np.testing.assert_allclose(unpacked(found), linalg.solve_continuous_lyapunov(a, -np.eye(3)), atol=1e-6)


@pytest.mark.parametrize("seed", range(2))
def test_inequalities_and_cones_together_as_cvxpy_solves_them(seed):
    rng = np.random.default_rng(10 + seed)
    costs, terms = rng.normal(size=3), [symmetric(20 + 3 * seed + k, 4) for k in range(3)]
    rows, shift = rng.normal(size=(5, 3)), rng.normal(size=5)

    def whole(x):
        return sum(x[k] * terms[k] for k in range(3)) + 10 * np.eye(4)

    found, _ = minimise(costs, lambda x: [whole(x), np.r_[4.0, rows @ x - shift], 2 - x[:1]])
    x = cp.Variable(3)
    bounds = [whole(x) >> 0, cp.norm(rows @ x - shift) <= 4, x[0] <= 2]
    least = cp.Problem(cp.Minimize(costs @ x), bounds).solve(solver=cp.CLARABEL)
    assert costs @ found == pytest.approx(least, rel=1e-6, abs=1e-7)
    np.testing.assert_allclose(found, x.value, atol=1e-4)


def test_what_has_no_solution_has_none():
    found, status = minimise([1.0], lambda x: [x[:1] - 1, -x[:1]])
    assert found is None and status == "PrimalInfeasible"
