import sys
import warnings

import cvxpy
import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.metrics import r2_score
from sklearn.utils.estimator_checks import check_estimator

from stillwork.base.checks import InputError
from stillwork.estimation import (
    LeastMeanSquares,
    MinMaxRegressor,
    RecursiveLeastSquares,
)
from stillwork.estimation.min_max import ZeroEstimateWarning
from stillwork.estimation.recursive import GrowthLimitWarning
from stillwork.estimation.regression import UnlikeScalesWarning

EVERY = [
    LeastMeanSquares(),
    RecursiveLeastSquares(),
    RecursiveLeastSquares(window=40),
    MinMaxRegressor(bound=0.01, bound_on="sample", initial_covariance=100.0),
]
KINDS = [
    LeastMeanSquares(step_size=0.4, fit_intercept=False),
    RecursiveLeastSquares(forgetting=0.95, fit_intercept=False),
    RecursiveLeastSquares(fit_intercept=False),
    MinMaxRegressor(0.3, forgetting=0.95, fit_intercept=False),
    MinMaxRegressor([0.3, 0.0, 0.1], "sample", initial_covariance=10.0, fit_intercept=False),
]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::stillwork.estimation.min_max.ZeroEstimateWarning")
@pytest.mark.filterwarnings("ignore:Estimator .* does not inherit")
@pytest.mark.parametrize("estimator", EVERY, ids=repr)
def test_it_passes_scikit_learn_s_own_checks(estimator):
    assert len(check_estimator(estimator, on_skip=None)) > 50


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("estimator", EVERY, ids=repr)
def test_a_score_of_a_named_table_is_that_of_its_array(estimator):
    X, y = record(6, samples=200)
    named = pd.DataFrame(X, columns=["a", "b", "c"])
    assert clone(estimator).fit(named, y).score(named, y) == clone(estimator).fit(X, y).score(X, y)


def test_numbers_are_fitted_without_scikit_learn_and_what_is_wrong_with_them_is_reported(monkeypatch):
    X, y = record(8)
    wanted = clone(EVERY[1]).fit(X, y)
    for module in ("sklearn", "sklearn.utils", "sklearn.utils.validation", "sklearn.exceptions"):
        monkeypatch.setitem(sys.modules, module, None)
    rls = RecursiveLeastSquares()
    with pytest.raises(InputError, match="not fitted"):
        rls.predict(X)
    np.testing.assert_array_equal(rls.fit(X.tolist(), y.tolist()).coef_, wanted.coef_)
    for wrong in (X[:, 0], X[:, :2], np.where(X > 1, np.inf, X), X[:0]):
        with pytest.raises(InputError, match=r"^X is an array of shape"):
            rls.predict(wrong)
    with pytest.raises(ImportError, match="regression"):
        rls.predict(pd.DataFrame(X))


def record(seed=0, samples=60, outputs=None, features=3):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(samples, features))
    coef = rng.normal(size=features if outputs is None else (outputs, features))
    y = X @ coef.T
    return X, y + 0.3 * rng.normal(size=y.shape)


def weighted(X, y, forgetting, weights=1.0):
    root = np.sqrt(weights * forgetting ** np.arange(len(X) - 1, -1, -1))
    return X * root[:, None], y * (root if y.ndim == 1 else root[:, None])


def assert_cone_program(found, X, y, bounds):
    """The min-max problem as a second-order cone program, with `bounds` on the columns: same cost, same point."""
    coef = cvxpy.Variable(X.shape[1])
    cost = cvxpy.norm(y - X @ coef) + cvxpy.norm(cvxpy.multiply(bounds, coef))
    least = cvxpy.Problem(cvxpy.Minimize(cost)).solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10)
    assert np.linalg.norm(y - X @ found) + np.linalg.norm(bounds * found) <= least * (1 + 1e-9)
    # the cost is flat: the solver's gap of 1e-10 lets the point move by its root
    assert found == pytest.approx(coef.value, abs=1e-4)


def test_least_mean_squares_take_the_published_step():
    X, y = record(3, outputs=2)
    start = np.ones((2, 3))
    coef = start.copy()
    for row, output in zip(X, y, strict=True):
        coef += 0.4 * np.outer(output - coef @ row, row) / (1e-2 + row @ row)
    found = LeastMeanSquares(step_size=0.4, regularisation=1e-2, initial_coef=start, fit_intercept=False).fit(
        X, y
    )
    assert found.coef_ == pytest.approx(coef, rel=1e-12)


@pytest.mark.filterwarnings("ignore::stillwork.estimation.min_max.ZeroEstimateWarning")
@pytest.mark.parametrize("bound", [0.0, 0.4, [0.4, 0.0, 0.0], [0.0, 2.0, 0.3]])
@pytest.mark.parametrize(("bound_on", "intercept"), [("record", False), ("sample", True)])
def test_min_max_is_the_cone_program(bound, bound_on, intercept):
    """An intercept is a column of ones that is known."""
    X, y = record(4, samples=20, outputs=2)
    weights = np.random.default_rng(5).uniform(0, 3, len(X))
    A, b = weighted(np.column_stack([X, np.ones(20)]) if intercept else X, y + 9 * intercept, 0.9, weights)
    growth = 1.0 if bound_on == "record" else np.sqrt(weights @ 0.9 ** np.arange(19, -1, -1))
    bounds = growth * np.append(np.broadcast_to(bound, 3), [0.0] * intercept)
    found = MinMaxRegressor(bound, bound_on, forgetting=0.9, fit_intercept=intercept)
    found.fit(X, y + 9 * intercept, weights)
    for coef, constant, target in zip(found.coef_, np.broadcast_to(found.intercept_, 2), b.T, strict=True):
        assert_cone_program(np.append(coef, [constant] * intercept), A, target, bounds)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(15))
def test_min_max_of_one_sample_at_a_time_is_that_of_all(seed):
    # the kernel of a row against the singular values of the whole record
    rng = np.random.default_rng([11, seed])
    features, outputs = rng.integers(1, 9), rng.integers(1, 4)
    X = rng.standard_normal((40, features)) * 10 ** (rng.uniform(-6, 6, features) * rng.integers(0, 2))
    if seed % 5 == 0:
        X = X[:, :1] + 1e-3 * X  # nearly one column
    size = np.abs(X).max(axis=0)
    bound = 10 ** rng.uniform(-3, 1) * size * np.append(1.0, rng.random(features - 1) < 0.7)
    y = X @ rng.standard_normal((features, outputs)) / size.mean()
    y += 10 ** rng.uniform(-6, 1) * rng.standard_normal(y.shape)
    how = {
        "bound": bound if seed % 2 else float(bound.mean()),
        "bound_on": ("record", "sample")[rng.integers(2)],
        "forgetting": (0.9, 1.0)[rng.integers(2)],
        "fit_intercept": bool(rng.integers(2)),
    }
    stream = MinMaxRegressor(**how)
    for k in range(len(X)):
        stream.partial_fit(X[k : k + 1], y[k : k + 1])
        if k % 8 == 7:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ZeroEstimateWarning)
                whole = MinMaxRegressor(**how).fit(X[: k + 1], y[: k + 1])
            least = 1e-12 * np.abs(whole.coef_ * size).max() + 1e-15 * np.abs(y).max()
            assert np.abs((stream.coef_ - whole.coef_) * size).max() <= 10 * least


def test_min_max_keeps_the_digits_of_data_that_fit():
    X, y = record(7)
    coef = np.array([1.0, -2.0, 3.0])
    noise = 1e-9 * (y - X @ np.linalg.lstsq(X, y)[0])
    found = MinMaxRegressor(0.05, fit_intercept=False).fit(X, X @ coef + noise)
    expected = small_noise_solution(X, noise, coef, 0.05)
    assert np.abs(expected - coef).max() > 1e-12  # what sums of squares, of 1e-17 beside 1e3, could not tell
    assert found.coef_ == pytest.approx(expected, abs=1e-14)


def small_noise_solution(X, noise, coef, bound):
    """To first order in the noise: alpha = bound |noise| / |coef|, then ridge."""
    alpha = bound * np.linalg.norm(noise) / np.linalg.norm(coef)
    return coef - np.linalg.solve(X.T @ X + alpha * np.eye(3), alpha * coef - X.T @ noise)


def test_a_known_column_that_says_nothing_new_does_no_harm():
    X, y = record(8)
    doubled = np.column_stack([X[:, :2], X[:, :2] @ [1.0, 1.0], X[:, 2]])
    found = MinMaxRegressor([0, 0, 0, 0.5], fit_intercept=False).fit(doubled, y)
    assert found.coef_[3] == pytest.approx(
        MinMaxRegressor([0, 0, 0.5], fit_intercept=False).fit(X, y).coef_[2], rel=1e-10
    )


@pytest.mark.slow
@pytest.mark.parametrize("estimator", KINDS, ids=lambda e: type(e).__name__)
def test_a_stream_is_its_batch(estimator):
    X, y = record(9, samples=200, outputs=2)
    X[17], y[40] = np.nan, np.nan
    whole = clone(estimator).fit(X, y)
    for pieces in (np.arange(1, 200), [3, 18, 150]):
        stream = clone(estimator)
        for part, target in zip(np.split(X, pieces), np.split(y, pieces), strict=True):
            assert stream.partial_fit(part, target) is stream
        assert np.abs(stream.coef_ - whole.coef_).max() <= 1e-12 * np.abs(whole.coef_).max()
    assert stream.fit(X[:50], y[:50]).coef_ == pytest.approx(clone(estimator).fit(X[:50], y[:50]).coef_)


@pytest.mark.parametrize("given", [7.0, None])
def test_a_stream_holds_down_the_variances_that_its_batch_does(given):
    X, y = record(9, samples=200)
    X[50:, 1] = 0.0
    estimator = RecursiveLeastSquares(
        forgetting=0.9, initial_covariance=given, growth_limit=20.0, fit_intercept=False
    )
    with pytest.warns(GrowthLimitWarning):
        whole = clone(estimator).fit(X, y)
    for pieces in (np.arange(1, 200), [3, 18, 150]):
        stream = clone(estimator)
        for part, target in zip(np.split(X, pieces), np.split(y, pieces), strict=True):
            stream.partial_fit(part, target)
        assert np.allclose(stream.held_, whole.held_, rtol=1e-9, atol=0)


@pytest.mark.parametrize("estimator", KINDS, ids=lambda e: type(e).__name__)
def test_a_lost_sample_is_time_without_news(estimator):
    X, y = record(11, outputs=2)
    gone = np.isin(np.arange(60), [5, 20, 21, 59])
    silent = (
        X * ~gone[:, None],
        y * ~gone[:, None],
        *([] if isinstance(estimator, LeastMeanSquares) else [~gone * 1.0]),
    )
    expected = clone(estimator).fit(*silent).coef_
    for spoiled, target in ((X.copy(), y), (X, y.copy())):
        (spoiled if target is y else target)[gone, 0] = np.nan
        found = clone(estimator).fit(spoiled, target)
        assert np.array_equal(found.coef_, expected)
        assert np.array_equal(np.isnan(found.predict(spoiled)).any(axis=1), np.isnan(spoiled).any(axis=1))
    assert found.score(X, target) == pytest.approx(r2_score(y[~gone], found.predict(X)[~gone]))


@pytest.mark.parametrize(
    "estimator",
    [
        LeastMeanSquares(step_size=0.5, fit_intercept=False),
        RecursiveLeastSquares(forgetting=0.95, initial_covariance=1.0, fit_intercept=False),
        MinMaxRegressor(1e-3, "sample", forgetting=0.95, initial_covariance=1.0, fit_intercept=False),
    ],
    ids=lambda e: type(e).__name__,
)
@pytest.mark.parametrize("lost", [0.0, np.nan])
def test_endless_unexcited_samples_stay_finite_and_learning_resumes(estimator, lost):
    """0.95 to that power is zero: what it forgets is below all numbers after 15,000 samples."""
    X, y = record(14, samples=800)
    estimator = clone(estimator).partial_fit(X[:400], y[:400])
    estimator.partial_fit(np.full((100_000, 3), lost), np.zeros(100_000))
    assert np.isfinite(estimator.coef_).all()
    estimator.partial_fit(X[400:], y[400:])
    # what 0.95 forgets, the initial estimate and the little uncertainty all count for less than a thousandth
    tolerance = 0.3 if isinstance(estimator, LeastMeanSquares) else 2e-3
    A, b = weighted(X[400:], y[400:], getattr(estimator, "forgetting", 1.0))
    assert estimator.coef_ == pytest.approx(np.linalg.lstsq(A, b)[0], abs=tolerance)


def test_a_changed_coef_does_not_change_the_stream():
    X, y = record(22)
    for kind in KINDS:
        stream, twin = (clone(kind).partial_fit(X[:30], y[:30]) for _ in range(2))
        stream.coef_[:] = 0
        assert np.array_equal(
            stream.partial_fit(X[30:], y[30:]).coef_, twin.partial_fit(X[30:], y[30:]).coef_
        )


def test_forgetting_may_change_between_two_calls():
    X, y = record(16)
    stream = RecursiveLeastSquares(forgetting=0.8, fit_intercept=False).partial_fit(X[:30], y[:30])
    stream.set_params(forgetting=0.9).partial_fit(X[30:], y[30:])
    root = np.sqrt(np.append(0.9**30 * 0.8 ** np.arange(29, -1, -1), 0.9 ** np.arange(29, -1, -1)))
    assert stream.coef_ == pytest.approx(np.linalg.lstsq(X * root[:, None], y * root)[0], rel=1e-6)


@pytest.mark.parametrize("estimator", KINDS, ids=lambda e: type(e).__name__)
def test_a_refused_call_changes_nothing(estimator):
    X, y = record(17, outputs=2)
    refused, twin = (clone(estimator).partial_fit(X[:30], y[:30]) for _ in range(2))
    for bad in (
        (X[:, :2], y),
        (X, y[:, :1]),
        (X, y[:, 0]),
        (X[:5], y),
        (np.full((60, 3), np.inf), y),
        (X, None),
    ):
        with pytest.raises(InputError):
            refused.partial_fit(*bad)
    with pytest.raises(InputError, match=r"^X\b.*large"):
        refused.partial_fit(1e200 * X, 1e200 * y)
    for small in (1e-200 * X, y), (X, 1e-200 * y):
        with pytest.raises(InputError, match=r"^[Xy]\b.*small"):
            refused.fit(*small)
    assert np.array_equal(refused.partial_fit(X, y).coef_, twin.partial_fit(X, y).coef_)


def test_what_a_frame_calls_missing_is_lost():
    X = pd.DataFrame(np.random.default_rng(32).standard_normal((50, 2)), columns=["drive", "floor"])
    y = X @ [3.0, -5.0]
    X.iloc[5, 0] = y[7] = np.nan
    missing = X.convert_dtypes(), y.convert_dtypes()
    assert missing[0].iloc[5, 0] is pd.NA
    found, expected = (RecursiveLeastSquares().fit(*each) for each in (missing, (X, y)))
    assert np.array_equal(found.coef_, expected.coef_)
    assert found.feature_names_in_.tolist() == ["drive", "floor"]
    with pytest.raises(InputError, match=r"^X\b.*same order"):
        found.predict(X[["floor", "drive"]])


def test_a_bound_that_explains_everything_away_warns():
    X, y = record(19)
    with pytest.warns(ZeroEstimateWarning, match=r"\bbound\b"):
        assert not MinMaxRegressor(50.0, fit_intercept=False).fit(X, y).coef_.any()


@pytest.mark.parametrize("how", ["drift", "alike", "sizes"])
def test_lms_warns_of_what_it_has_not_learned_alone(how):
    rng = np.random.default_rng(8)
    x = rng.standard_normal((2000, 2))
    with warnings.catch_warnings(action="error"):
        LeastMeanSquares().fit(x, x @ [2.0, 3.0])
    if how == "drift":
        x[:, 0] = 1e5 + np.arange(2000.0)
    elif how == "alike":
        x[:, 1] = x[:, 0] + 1e-7 * x[:, 1]
    else:
        x[:, 1] *= 1e-2
    y = x @ [2.0, 3.0]
    with pytest.warns(UnlikeScalesWarning):
        estimate = LeastMeanSquares().fit(x, y)
    assert abs(estimate.coef_[1] / 3 - 1) > 0.01  # it is right to warn
