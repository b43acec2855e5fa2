"""The estimators of a stream against certified values, exact relations and shifted, scaled and turned copies of records."""

import warnings

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from naive.nist import datasets, digits
from stillwork.estimation import LeastMeanSquares, MinMaxRegressor, RecursiveLeastSquares, track


def scaled_qr(A, b):
    units = np.linalg.norm(A, axis=0)
    q, r = np.linalg.qr(A / units)
    return np.linalg.solve(r, q.T @ b) / units


def rows_of(estimator, X, y):
    for k in range(len(X)):
        estimator.partial_fit(X[k : k + 1], y[k : k + 1])
    return np.append(estimator.coef_, estimator.intercept_)


@pytest.mark.parametrize("name", datasets())
def test_certified_digits_are_kept(name):
    X, y, certified, intercept = datasets()[name]
    A = np.column_stack([X, np.ones(len(X))]) if intercept else X
    # of Filip's columns numpy's rank is one too small
    peer = scaled_qr(A, y) if name == "Filip" else np.linalg.lstsq(A, y)[0]
    wanted = digits(peer, certified) - 1
    fitted = RecursiveLeastSquares(fit_intercept=intercept).fit(X, y)
    whole = np.append(fitted.coef_, fitted.intercept_)
    assert digits(whole[: A.shape[1]], certified) >= wanted
    stream = rows_of(RecursiveLeastSquares(fit_intercept=intercept), X, y)
    assert stream == pytest.approx(whole, rel=1e-12)


OFFSETS = [
    (101325.0, 20.0, 2.0, 500),
    (101325.0, 20.0, 2.0, 2000),
    (300.0, 0.01, 5.0, 1000),
    (1e6, 10.0, 2.0, 1000),
]


@pytest.mark.parametrize(("offset", "size", "slope", "samples"), [*OFFSETS, (300.0, 0.01, 5.0, 2000)])
@pytest.mark.parametrize("forgetting", [1.0, 0.999])
def test_features_with_an_offset_keep_their_slope(offset, size, slope, samples, forgetting):
    X = offset + size * np.random.default_rng(1).standard_normal((samples, 1))
    y = slope * X[:, 0] + 7.0
    found = RecursiveLeastSquares(forgetting=forgetting).fit(X, y)
    assert found.coef_ == pytest.approx([slope], rel=1e-10)
    rounding = 1e-15 * offset / size * offset * slope  # of the slope, times the offset
    assert found.intercept_ == pytest.approx(7.0, abs=100 * rounding)
    assert track(np.vstack([X.T, np.ones(samples)]), y, forgetting).estimates[0, -1] == pytest.approx(
        slope, rel=1e-8
    )
    assert LeastMeanSquares().fit(X, y).coef_ == pytest.approx([slope], rel=1e-4)
    assert MinMaxRegressor(0.0, forgetting=forgetting).fit(X, y).coef_ == pytest.approx([slope], rel=1e-8)


@pytest.mark.parametrize(("offset", "size", "slope", "samples"), OFFSETS)
def test_least_mean_squares_find_the_slope_of_a_machine_that_starts_at_zero(offset, size, slope, samples):
    X = offset + size * np.random.default_rng(2).standard_normal((samples, 1))
    X[0] = 0.0
    assert LeastMeanSquares().fit(X, slope * X[:, 0] + 7.0).coef_ == pytest.approx([slope], rel=1e-2)


def record(seed, samples=120, features=3):
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((samples, features))
    X[40:60] = X[40]  # a rest
    X[:, -1] = np.sign(X[:, -1])  # two levels
    return X, X @ rng.standard_normal(features) + 0.3 * rng.standard_normal(samples)


@st.composite
def drawn_records(draw):
    """Features of a machine: stretches of noise, rests, steps of the operating point, features of two levels, lost rows."""
    rng, parts = np.random.default_rng(draw(st.integers(0, 2**32 - 1))), []
    place = np.zeros(3)
    for kind in draw(st.lists(st.sampled_from(["noise", "rest", "step", "lost"]), min_size=2, max_size=5)):
        part = rng.standard_normal((30, 3))
        if kind == "rest":
            part[:] = part[0]
        elif kind == "step":
            place = 3 * rng.standard_normal(3)
        elif kind == "lost":
            part[rng.integers(0, 30, 5), rng.integers(0, 3, 5)] = np.nan
        parts.append(part + place)
    X = np.vstack([rng.standard_normal((30, 3)), *parts])
    for j in draw(st.sets(st.integers(0, 2), max_size=2)):
        X[:, j] = np.where(np.isnan(X[:, j]), np.nan, np.sign(X[:, j]))
    y = X @ rng.standard_normal(3) + 0.3 * rng.standard_normal(len(X))
    return X, y


EXACT = [
    RecursiveLeastSquares(),
    RecursiveLeastSquares(forgetting=0.97),
    RecursiveLeastSquares(window=45),
    MinMaxRegressor(0.0, forgetting=0.97),
]
BOUNDED = MinMaxRegressor([0.1, 0.2, 0.3], forgetting=0.97)
STEPPED = LeastMeanSquares()  # one step meets all features: they share a unit
TURNED = [*EXACT, MinMaxRegressor(0.3), MinMaxRegressor(0.3, "sample", 0.97, window=50)]


def predicted(estimator, X, y, seen, **changed):
    """Of the rows that count most: the last ones; older ones of a window may lie where nothing is known any more."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fitted = type(estimator)(**estimator.get_params() | changed).fit(X, y)
    rows = seen[-30:]
    return fitted.predict(rows[~np.isnan(rows).any(axis=1)])


@settings(max_examples=60)
@given(
    drawn_records(),
    st.tuples(*3 * [st.floats(-6, 6)]),
    st.tuples(*3 * [st.sampled_from([0.0, 1.0, -3e3, 1e5])]),
    st.permutations(range(3)),
    st.floats(-9, 9),
    st.sampled_from([*EXACT, BOUNDED, STEPPED]),
)
def test_neither_unit_nor_offset_nor_order_matters(record, powers, offsets, order, power, estimator):
    X, y = record
    units, unit, bound = 10.0 ** np.array(powers), 10.0**power, {}
    if estimator is BOUNDED:
        bound = {"bound": (estimator.bound * units)[order]}
    elif estimator is STEPPED:
        units[:], offsets = units[0], np.zeros(3)
    moved = ((X + offsets) * units)[:, order]
    expected = predicted(estimator, X, y, X)
    found = predicted(estimator, moved, unit * y, moved, **bound) / unit
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)


@settings(max_examples=80)
@given(drawn_records(), st.integers(0, 2**32 - 1), st.sampled_from(TURNED), st.integers(0, 2))
def test_features_may_be_turned_into_one_another_or_given_twice(record, seed, estimator, which):
    X, y = record
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    expected = predicted(estimator, X, y, X)
    assert predicted(estimator, X @ turn, y, X @ turn) == pytest.approx(expected, rel=1e-6, abs=1e-6)
    if estimator in EXACT:
        twice = np.column_stack([X, X[:, which]])
        assert predicted(estimator, twice, y, twice) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@settings(max_examples=100)
@given(
    drawn_records(),
    st.none() | st.integers(2, 60),
    st.sampled_from([1.0, 0.95]),
    st.booleans(),
    st.none() | st.floats(0.1, 10.0),
    st.booleans(),
)
def test_an_estimate_is_that_of_weighted_least_squares(record, window, forgetting, intercept, prior, stream):
    """Of the rows of the window, two outputs, with weights, an initial estimate, lost rows, a row at a time or at once."""
    X, y = record[0], np.column_stack([record[1], record[0][::-1, 0]])
    weights, start = np.random.default_rng(len(X)).uniform(0.1, 3, len(X)), {}
    A = np.column_stack([X, np.ones(len(X))]) if intercept else X
    age = np.arange(len(X) - 1, -1, -1)
    lost = np.isnan(np.column_stack([X, y])).any(axis=1)
    used = ~lost & (age < (window or len(X)))
    assume(used.any())
    root = np.sqrt(forgetting**age * weights)[used, None]
    wanted, target = root * A[used], root * y[used]
    if prior is not None and window is None:
        start = {
            "initial_covariance": prior,
            "initial_coef": np.arange(6.0).reshape(2, 3),
            "growth_limit": np.inf,
        }
        held = np.sqrt(forgetting ** len(X) / prior)
        wanted = np.vstack([wanted, held * np.eye(3, A.shape[1])])
        target = np.vstack([target, held * start["initial_coef"].T])
    made = RecursiveLeastSquares(forgetting=forgetting, window=window, fit_intercept=intercept, **start)
    begun = int(np.argmin(lost)) + 1 if stream else len(X)  # a stream begins with a row that is not lost
    (made.partial_fit if stream else made.fit)(X[:begun], y[:begun], weights[:begun])
    for k in range(begun, len(X)):
        made.partial_fit(X[k : k + 1], y[k : k + 1], weights[k : k + 1])
    expected = A[used] @ np.linalg.lstsq(wanted, target)[0]
    assert made.predict(X[used]) == pytest.approx(expected, rel=1e-8, abs=1e-8)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e4]), st.sampled_from(EXACT))
def test_two_features_that_differ_by_a_millionth_are_told_apart(seed, offset, estimator):
    rng = np.random.default_rng(seed)
    one = rng.standard_normal((300, 1))
    X = offset + np.hstack([one, one + 1e-6 * rng.standard_normal((300, 1))])
    found = type(estimator)(**estimator.get_params()).fit(X, X @ [2.0, -3.0])
    assert found.coef_ == pytest.approx([2.0, -3.0], abs=1e-7 * max(1.0, offset) / 10)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.95, 1.0]), st.booleans())
def test_a_feature_that_others_explain_changes_no_prediction(seed, forgetting, intercept):
    X, y = record(seed)
    more = np.column_stack([X[:, :2], X[:, 0], X[:, 2], X[:, 1] - 2 * X[:, 2], np.full(len(X), 0.1)])
    kind = RecursiveLeastSquares(forgetting=forgetting, fit_intercept=intercept)
    found = kind.fit(more, y)
    root = np.sqrt(forgetting ** np.arange(len(X) - 1, -1, -1))
    A = np.column_stack([X, np.ones(len(X))])  # the constant feature stands for an intercept
    expected = A @ np.linalg.lstsq(A * root[:, None], y * root)[0]
    assert found.predict(more) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert found.coef_[[2, 4]] == pytest.approx([0, 0], abs=0)


@pytest.mark.parametrize("rest", ["constant", "lost"])
def test_a_million_rests_are_survived(rest):
    X, y = record(3, samples=800)
    stream = RecursiveLeastSquares(forgetting=0.99).partial_fit(X[:400], y[:400])
    still = np.full((10**6, 3), 5.0 if rest == "constant" else np.nan)
    stream.partial_fit(still, np.full(10**6, 2.0))
    assert np.isfinite(stream.coef_).all()
    assert stream.predict(still[:1]) == pytest.approx([2.0] if rest == "constant" else [np.nan], nan_ok=True)
    stream.partial_fit(X[400:], y[400:])
    # what is left of the rest is one row of all its weight, of the first 400 what the limit keeps
    weights = np.append(0.99**400 / (1 - 0.99) if rest == "constant" else 0.0, 0.99 ** np.arange(399, -1, -1))
    A = (
        np.column_stack([np.vstack([np.full((1, 3), 5.0), X[400:]]), np.ones(401)])
        * np.sqrt(weights)[:, None]
    )
    expected = np.linalg.lstsq(A, np.append(2.0, y[400:]) * np.sqrt(weights))[0]
    assert np.append(stream.coef_, stream.intercept_) == pytest.approx(expected, abs=1e-5)


def test_single_precision_keeps_its_digits():
    X, y = record(4)
    narrow = (X + 100).astype(np.float32), y.astype(np.float32)
    wide = RecursiveLeastSquares().fit(*(each.astype(float) for each in narrow))
    assert np.array_equal(RecursiveLeastSquares().fit(*narrow).coef_, wide.coef_)
