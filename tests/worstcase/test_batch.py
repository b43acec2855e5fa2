import warnings
from dataclasses import fields

import cvxpy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from naive import worstcase as naive
from notebooks.worstcase.geometry import solve_cone_program
from stillwork.base.checks import InputError
from stillwork.estimation import min_max_solve
from stillwork.estimation.min_max import ZeroEstimateWarning, solve_silently, solve_sweep
from stillwork.estimation.secular import secular_function


def problem(seed, rows=12, unknowns=3, noise=1.0, conditioning=0.0):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(rows, unknowns)) * 10.0 ** np.linspace(0, -conditioning, unknowns)
    return A, A @ rng.normal(size=unknowns) + noise * rng.normal(size=rows)


def threshold(A, b):
    return np.linalg.norm(A.T @ b) / np.linalg.norm(b)


def cost(A, b, bound, x):
    return np.linalg.norm(A @ x - b) + bound * np.linalg.norm(x)


@pytest.mark.parametrize("share", [1e-9, 0.01, 0.5, 0.97, 1 - 1e-6])
@pytest.mark.parametrize("shape", [(5, 1), (40, 8)])
def test_solution_agrees_with_bisection(shape, share):
    A, b = problem(1, *shape, conditioning=1.0)
    bound = share * threshold(A, b)
    found = min_max_solve(A, b, bound)
    x, alpha = naive.min_max(A, b, bound)
    assert found.case == "regularised"
    tolerance = 1e-10 if 0.01 <= share <= 0.97 else 1e-5
    assert found.alpha == pytest.approx(alpha, rel=tolerance)
    assert found.estimate == pytest.approx(x, rel=tolerance)


@pytest.mark.parametrize("seed", range(2))
def test_cost_is_that_of_the_cone_program(seed):
    A, b = problem(seed, 20, 4)
    for share in (0.1, 0.5, 0.9, 1.5):
        bound = share * threshold(A, b)
        x = cvxpy.Variable(4)
        objective = cvxpy.norm(A @ x - b) + bound * cvxpy.norm(x)
        best = cvxpy.Problem(cvxpy.Minimize(objective)).solve(solver=cvxpy.CLARABEL)
        ours = solve_silently(A, b, bound).worst_case_residual
        assert ours == pytest.approx(best, rel=1e-7)
        assert ours <= best * (1 + 1e-9)
        assert solve_cone_program(A, b, bound)[1] == pytest.approx(best, rel=1e-7)


def test_worst_perturbation_attains_the_cost_and_random_ones_do_not_exceed_it():
    rng = np.random.default_rng(3)
    A, b = problem(3)
    bound = 0.4 * threshold(A, b)
    found = min_max_solve(A, b, bound)
    assert np.linalg.norm(found.perturbation, 2) == pytest.approx(bound, rel=1e-12)
    attained = np.linalg.norm((A + found.perturbation) @ found.estimate - b)
    assert attained == pytest.approx(found.worst_case_residual, rel=1e-12)
    for _ in range(300):
        dA = rng.normal(size=A.shape)
        dA *= bound / np.linalg.norm(dA, 2)
        assert np.linalg.norm((A + dA) @ found.estimate - b) <= found.worst_case_residual * (1 + 1e-12)


def test_newton_needs_few_evaluations_over_many_problems():
    counts = []
    for seed in range(63):  # every noise with every share
        A, b = problem(seed, 15, 5, noise=10.0 ** (seed % 9 - 6), conditioning=seed % 5)
        counts.append(solve_silently(A, b, threshold(A, b) * (0.005 + 0.99 * (seed % 7) / 7)).evaluations)
    assert max(counts) <= 12


# b in the column space of A


def consistent(seed, unknowns=3):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(6, unknowns)) * np.array([1.0, 0.3, 2.0])[:unknowns]
    x = rng.normal(size=unknowns)
    return A, A @ x, x


def test_consistent_data_give_least_squares_up_to_the_free_bound():
    A, b, x = consistent(0)
    U, S, _ = np.linalg.svd(A, full_matrices=False)
    c = U.T @ b
    free = np.linalg.norm(c / S) / np.linalg.norm(c / S**2)
    found = min_max_solve(A, b, 0.999 * free)
    assert found.free_bound == pytest.approx(free, rel=1e-10)
    assert found.case == "least squares"
    assert found.alpha == 0
    assert found.estimate == pytest.approx(x, rel=1e-10)


@pytest.mark.parametrize("place", [0.001, 0.5, 0.999])
def test_consistent_data_between_the_bounds_match_the_cone_program(place):
    A, b, _ = consistent(1)
    low = min_max_solve(A, b, 0.0)
    bound = low.free_bound + place * (low.threshold - low.free_bound)
    found = min_max_solve(A, b, bound)
    assert found.case == "regularised"
    assert found.alpha > 0
    assert found.worst_case_residual == pytest.approx(solve_cone_program(A, b, bound)[1], rel=1e-7)


def test_consistent_data_with_equal_singular_values_have_a_segment_of_solutions():
    A = np.array([[2.0, 0.0], [0.0, 2.0], [0.0, 0.0]])
    b = np.array([1.0, -3.0, 0.0])
    found = min_max_solve(A, b, 2.0)
    assert found.case == "segment"
    whole = cost(A, b, 2.0, found.estimate)
    assert whole == pytest.approx(cost(A, b, 2.0, 0.37 * found.estimate), rel=1e-14)
    assert whole == pytest.approx(np.linalg.norm(b), rel=1e-14)
    assert min_max_solve(A, b, 1.999).case == "least squares"
    assert solve_silently(A, b, 2.001).case == "zero"


def test_square_and_consistent_perturbation_attains_the_cost():
    A, b, _ = consistent(2)
    found = min_max_solve(A[:3], b[:3], 0.01)
    attained = np.linalg.norm((A[:3] + found.perturbation) @ found.estimate - b[:3])
    assert attained == pytest.approx(found.worst_case_residual, rel=1e-9)


def test_rank_deficient_data_give_the_shortest_solution():
    rng = np.random.default_rng(6)
    A = rng.normal(size=(10, 2)) @ rng.normal(size=(2, 4))
    b = rng.normal(size=10)
    bound = 0.3 * threshold(A, b)
    found = min_max_solve(A, b, bound)
    assert found.rank == 2
    assert found.worst_case_residual == pytest.approx(solve_cone_program(A, b, bound)[1], rel=1e-7)
    null = np.linalg.svd(A)[2][2:]
    assert np.abs(null @ found.estimate).max() < 1e-12
    assert min_max_solve(A, b, 0.0).estimate == pytest.approx(np.linalg.pinv(A) @ b, abs=1e-12)


def test_zero_data_are_answered_without_a_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert min_max_solve(np.ones((3, 1)), np.zeros(3), 1.0).case == "zero"
        assert min_max_solve(np.zeros((3, 2)), np.ones(3), 1.0).case == "zero"


def test_a_bound_above_the_threshold_warns_and_gives_zero():
    A, b = problem(7)
    with pytest.warns(ZeroEstimateWarning, match="zero"):
        found = min_max_solve(A, b, 1.01 * threshold(A, b))
    assert not found.estimate.any()
    assert found.alpha == np.inf
    assert found.worst_case_residual == pytest.approx(np.linalg.norm(b))


# invariants

seeds = st.integers(0, 2**32 - 1)
shares = st.floats(0.01, 0.99)


@settings(max_examples=50)
@given(seeds, shares, st.floats(-150, 150), st.floats(-150, 150))
def test_the_answer_does_not_depend_on_units(seed, share, unit_a, unit_b):
    A, b = problem(seed)
    p, q = 10.0**unit_a, 10.0**unit_b
    bound = share * threshold(A, b)
    first = min_max_solve(A, b, bound)
    second = min_max_solve(p * A, q * b, p * bound)
    assert second.estimate * (p / q) == pytest.approx(first.estimate, rel=1e-8)
    assert second.worst_case_residual / q == pytest.approx(first.worst_case_residual, rel=1e-9)


@settings(max_examples=50)
@given(seeds, shares)
def test_rotations_of_data_and_parameters_rotate_the_answer(seed, share):
    rng = np.random.default_rng(seed)
    A, b = problem(seed)
    Q = np.linalg.qr(rng.normal(size=(12, 12)))[0]
    W = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    bound = share * threshold(A, b)
    first = min_max_solve(A, b, bound)
    second = min_max_solve(Q @ A @ W, Q @ b, bound)
    assert W @ second.estimate == pytest.approx(first.estimate, rel=1e-8, abs=1e-12)
    assert second.alpha == pytest.approx(first.alpha, rel=1e-8)


@settings(max_examples=50)
@given(seeds)
def test_limits_are_least_squares_and_zero(seed):
    A, b = problem(seed)
    x = np.linalg.lstsq(A, b, rcond=None)[0]
    assert min_max_solve(A, b, 0.0).estimate == pytest.approx(x, rel=1e-9)
    assert min_max_solve(A, b, 1e-9).estimate == pytest.approx(x, rel=1e-5)
    assert not solve_silently(A, b, threshold(A, b) * (1 + 1e-9)).estimate.any()
    near = min_max_solve(A, b, threshold(A, b) * (1 - 1e-6)).estimate
    assert np.linalg.norm(near) < 1e-3 * np.linalg.norm(x)


# the secular function


def test_secular_function_and_slope_agree_with_normal_equations_and_differences():
    A, b = problem(8)
    f = secular_function(A, b, 0.7)
    alphas = np.geomspace(1e-3, 1e3, 13)
    assert f(alphas) == pytest.approx([naive.secular_value(A, b, 0.7, a) for a in alphas], rel=1e-11)
    h = 1e-5 * alphas
    differences = [
        (naive.secular_value(A, b, 0.7, a + d) - naive.secular_value(A, b, 0.7, a - d)) / (2 * d)
        for a, d in zip(alphas, h, strict=True)
    ]
    assert f.slope(alphas) == pytest.approx(differences, rel=1e-5)


@pytest.mark.slow
@settings(max_examples=40, derandomize=True)
@given(seeds, st.floats(0.05, 0.9), st.floats(-6, 6))
def test_fixed_point_iterates_approach_the_root_monotonically(seed, share, decade):
    A, b = problem(seed, 8, 3)
    f = secular_function(A, b, share * threshold(A, b))
    root, _ = f.root()
    path = f.iterates(10.0**decade, 200)
    steps = np.diff(path) * np.sign(root - path[0])
    assert (steps >= -1e-9 * np.maximum(path[1:], root)).all()
    assert abs(path[-1] - root) <= abs(path[0] - root)


def test_secular_function_without_a_root_says_so():
    A, b = problem(10)
    with pytest.raises(InputError, match=r"^bound\b.*2\.76844"):
        secular_function(A, b, 2 * threshold(A, b)).root()
    with pytest.raises(InputError, match=r"^target\b"):
        secular_function(np.array([[1.0], [0.0]]), [0.0, 1.0], 0.1)


def test_a_sweep_is_its_bounds_one_by_one():
    rng = np.random.default_rng(4)
    matrix = rng.standard_normal((12, 4))
    for data in (matrix, matrix[:, [0, 1, 2, 2]]):  # of full rank, and not
        target = data @ np.ones(4) + 0.1 * rng.standard_normal(12)
        bounds = [0.0, 0.1, 1.0, 100.0]
        sweep = solve_sweep(data, target, bounds)
        assert [each.case for each in sweep] == ["least squares", "regularised", "regularised", "zero"]
        for bound, each in zip(bounds, sweep, strict=True):
            alone = solve_silently(data, target, bound)
            for field in fields(each):
                np.testing.assert_array_equal(getattr(each, field.name), getattr(alone, field.name))
