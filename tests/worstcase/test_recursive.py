import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from naive import worstcase as naive
from stillwork.estimation import min_max_solve, track
from stillwork.estimation.recursive import GrowthLimitWarning, worst_case_residuals

FORGETTING = 0.9
ITERATIONS = [0, 1]  # exact, and algorithm (20)


def record(seed=0, unknowns=4, samples=60, noise=0.3, size=1.0):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(samples, unknowns))
    return rows, rows @ (size * rng.normal(size=unknowns)) + noise * rng.normal(size=samples)


def through_zero():
    """Record whose output vanishes for a while, so that the estimate goes to zero and comes back."""
    rows, outputs = record(5, samples=90)
    rng = np.random.default_rng(55)
    outputs[30:60] = rng.normal(size=30)
    return rows, outputs


@pytest.mark.parametrize(("bound", "unknowns"), [(0.05, 5), (0.8, 1), (0.8, 2), (1.5, 5)])
def test_exact_recursion_is_the_batch_solution_at_every_step(bound, unknowns):
    rows, outputs = record(unknowns=unknowns)
    estimates, alphas = naive.batch_estimates(rows, outputs, FORGETTING, np.full(60, bound))
    found = track(rows.T, outputs, FORGETTING, bound=bound)
    assert np.array_equal(np.isinf(found.alphas), np.isinf(alphas))
    finite = np.isfinite(alphas)
    assert found.alphas[finite] == pytest.approx(alphas[finite], rel=1e-9)
    assert found.estimates.T == pytest.approx(estimates, rel=1e-9, abs=1e-11)


def test_exact_recursion_leaves_and_reenters_through_the_zero_solution():
    rows, outputs = through_zero()
    estimates, alphas = naive.batch_estimates(rows, outputs, FORGETTING, np.full(90, 1.6))
    zero = np.isinf(alphas[5:])
    assert 5 < zero.sum() < 70
    assert not zero[-1]  # the record really comes back
    found = track(rows.T, outputs, FORGETTING, bound=1.6)
    assert np.array_equal(np.isinf(found.alphas), np.isinf(alphas))
    assert found.estimates.T == pytest.approx(estimates, rel=1e-8, abs=1e-11)


@pytest.mark.parametrize(("iterations", "bound"), [(1, 0.1), (1, 1.6), (2, 1.0), (3, 1.6)])
def test_approximate_update_is_algorithm_20(iterations, bound):
    rows, outputs = through_zero()
    estimates, alphas = naive.iterative_algorithm(rows, outputs, FORGETTING, bound, iterations)
    found = track(rows.T, outputs, FORGETTING, bound=bound, iterations=iterations)
    assert np.array_equal(np.isinf(found.alphas), np.isinf(alphas))
    finite = np.isfinite(alphas)
    assert found.alphas[finite] == pytest.approx(alphas[finite], rel=1e-8)
    assert found.estimates.T == pytest.approx(estimates, rel=1e-7, abs=1e-10)


@pytest.mark.parametrize("iterations", [0, 5])
def test_growing_window_has_unit_weights_and_a_growing_bound(iterations):
    rows, outputs = record(8, unknowns=2)
    bounds = 0.15 * np.sqrt(np.arange(1, 61))
    found = track(rows.T, outputs, bound=bounds, iterations=iterations)
    estimates, _ = naive.batch_estimates(rows, outputs, 1.0, bounds)
    accuracy = 1e-3 if iterations else 1e-9
    assert found.estimates.T == pytest.approx(estimates, rel=accuracy, abs=accuracy)


def test_least_squares_and_ridge_agree_with_augmented_problems():
    rows, outputs = record(9)
    found = track(rows.T, outputs, FORGETTING, initial_covariance=100.0)
    expected = naive.recursive_least_squares(rows, outputs, FORGETTING, 100.0)
    assert found.estimates.T == pytest.approx(expected, rel=1e-8, abs=1e-10)
    found = track(rows.T, outputs, FORGETTING, penalty=0.7)
    assert found.estimates.T == pytest.approx(
        naive.ridge(rows, outputs, FORGETTING, 0.7), rel=1e-9, abs=1e-11
    )
    assert (found.alphas == 0.7).all()


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.floats(-8, 8), st.floats(-8, 8))
def test_tracks_do_not_depend_on_units_and_rotate_with_the_parameters(seed, unit_a, unit_y):
    rows, outputs = record(seed)
    p, q = 10.0**unit_a, 10.0**unit_y
    W = np.linalg.qr(np.random.default_rng(seed).normal(size=(4, 4)))[0]
    for iterations in ITERATIONS:
        first = track(rows.T, outputs, FORGETTING, bound=0.6, iterations=iterations)
        second = track(p * (rows @ W).T, q * outputs, FORGETTING, bound=0.6 * p, iterations=iterations)
        assert W @ second.estimates * (p / q) == pytest.approx(first.estimates, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("iterations", ITERATIONS)
def test_noise_free_and_rank_deficient_records_stay_finite(iterations):
    rows, outputs = record(13, noise=0.0)
    found = track(rows.T, outputs, FORGETTING, bound=0.01, iterations=iterations)
    assert np.isfinite(found.estimates).all()
    assert found.estimates[:, -1] == pytest.approx(np.linalg.lstsq(rows, outputs, rcond=None)[0], rel=1e-5)
    doubled = np.vstack([rows.T, rows.T])
    noisy = outputs + 0.1 * np.random.default_rng(0).normal(size=60)
    found = track(doubled, noisy, FORGETTING, bound=0.5, iterations=iterations)
    A, b = naive.weighted(doubled.T, noisy, FORGETTING)
    accuracy = 2e-2 if iterations else 1e-7
    assert found.estimates[:, -1] == pytest.approx(min_max_solve(A, b, 0.5).estimate, rel=accuracy)


def test_long_records_lose_no_digits():
    rng = np.random.default_rng(14)
    rows = rng.normal(size=(20_000, 3))
    outputs = rows @ rng.normal(size=3) + 0.1 * rng.normal(size=20_000)
    found = track(rows.T, outputs, 0.95, bound=0.5)
    A, b = naive.weighted(rows[-2000:], outputs[-2000:], 0.95)
    assert found.estimates[:, -1] == pytest.approx(min_max_solve(A, b, 0.5).estimate, rel=1e-11)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_least_squares_without_a_start_are_those_of_all_rows(seed):
    rows, outputs = record(seed)
    rows[:12, 2] = 0  # a regressor that comes later: until then the others alone count
    rows[:, 1] *= np.linspace(0.05, 1.0, 60)  # and one that grows
    found = track(rows.T, outputs, FORGETTING)
    for t, used in ((8, [0, 1, 3]), (11, [0, 1, 3]), (20, [0, 1, 2, 3]), (59, [0, 1, 2, 3])):
        A, b = naive.weighted(rows[: t + 1], outputs[: t + 1], FORGETTING)
        expected = np.zeros(4)
        expected[used] = np.linalg.lstsq(A[:, used], b)[0]
        assert found.estimates[:, t] == pytest.approx(expected, rel=1e-9, abs=1e-12)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.tuples(*4 * [st.integers(-9, 9)]), st.integers(-9, 9), st.booleans())
def test_no_unit_of_a_regressor_or_an_output_matters_to_least_squares(seed, powers, power, quiet):
    rows, outputs = record(seed)
    if quiet:
        rows[20:, 0] = 0
    units, unit = 10.0 ** np.array(powers), 10.0**power
    found, other = (
        track(a.T, b, 0.8, silent=True) for a, b in ((rows, outputs), (rows * units, outputs * unit))
    )
    assert other.errors / unit == pytest.approx(found.errors, rel=1e-6, abs=1e-8)
    assert np.array_equal(found.held, other.held)


@pytest.mark.parametrize("jump", [1e3, 1e8, 1e14])
def test_a_start_from_a_sample_that_was_nearly_nothing_costs_no_digits(jump):
    rows, _ = record(21)
    rows[:3] /= jump
    outputs = rows @ [1.0, -2.0, 3.0, 0.5]
    found = track(rows.T, outputs, 0.95)
    assert found.estimates[:, -1] == pytest.approx([1.0, -2.0, 3.0, 0.5], rel=1e-4)


def test_a_limit_that_acts_at_the_end_is_reported():
    rows, outputs = record(22, samples=300)
    rows[100:, 1] = 0
    with pytest.warns(GrowthLimitWarning, match="growth_limit"):
        found = track(rows.T, outputs, 0.8)
    assert found.held.tolist() == [False, True, False, False]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not track(rows[:100].T, outputs[:100], 0.8).held.any()


@pytest.mark.parametrize(
    "how",
    [{}, {"penalty": 1e-3}, *({"bound": 0.01, "iterations": k} for k in ITERATIONS)],
    ids=str,
)
def test_endless_silent_samples_stay_finite_and_tracking_resumes(how):
    """0.95 to that power is zero: what it forgets is below all numbers after 15,000 samples."""
    rng = np.random.default_rng(18)
    before, after = rng.normal(size=3), rng.normal(size=3)
    rows = np.zeros((20_800, 3))
    rows[:400], rows[-400:] = rng.normal(size=(2, 400, 3))
    outputs = np.append(rows[:400] @ before, rows[400:] @ after)
    found = track(rows.T, outputs, 0.95, **how)
    assert np.isfinite(found.estimates).all() and np.isfinite(found.errors).all()
    assert found.estimates[:, -1] == pytest.approx(after, rel=1e-4, abs=1e-4)


def test_worst_case_residuals_are_the_criterion():
    rows, outputs = record(15)
    found = track(rows.T, outputs, FORGETTING, bound=0.6)
    worst = worst_case_residuals(rows.T, outputs, found.estimates, np.full(60, 0.6), FORGETTING)
    for t in (10, 59):
        A, b = naive.weighted(rows[: t + 1], outputs[: t + 1], FORGETTING)
        assert worst[t] == pytest.approx(min_max_solve(A, b, 0.6).worst_case_residual, rel=1e-11)
