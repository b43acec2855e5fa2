"""The advice on an estimator: cases with an answer that anybody knows, and its numbers by hand."""

import re

import numpy as np
import pytest
import scipy.linalg

from benchmarks import advice as problems
from stillwork.base.checks import InputError
from stillwork.estimation import advise
from stillwork.estimation.advice import IGNORE, SAFE
from stillwork.estimation.linear_fits import admitted_noise
from workbook import paths


def record(samples=400, noise=0.0, seed=1):
    rng = np.random.default_rng(seed)
    clean = rng.standard_normal((samples, 3))
    y = clean @ [1.0, -2.0, 3.0] + 0.5 * rng.standard_normal(samples)
    return clean + noise * rng.standard_normal(clean.shape), y, clean, rng


def test_each_flaw_has_its_estimator():
    X, y, clean, rng = record(noise=0.7)
    other = clean + 0.7 * rng.standard_normal(X.shape)
    assert advise(X, y, instruments=other).ranking[0].name == "instruments"
    known = advise(X, y, noise=0.7)
    assert known.ranking[0].name in ("bias compensation", "total least squares")
    assert known.ranking[0].coef == pytest.approx([1.0, -2.0, 3.0], abs=0.4)
    spoiled = y + np.where(rng.random(400) < 0.05, 100.0, 0.0)
    assert advise(X, spoiled).ranking[0].name == "Huber"
    nothing = advise(X, rng.standard_normal(400))
    assert nothing.ranking[0].name == IGNORE
    assert "noise of 0.1" in str(advise(clean, y))  # then something else than least squares would be right


def test_instruments_that_explain_nothing_are_left_aside():
    X, y, _, rng = record(noise=0.3)
    blind = rng.standard_normal(X.shape)
    one, other = advise(X, y, instruments=blind), advise(X, y)
    assert [each.name for each in one.ranking] == [each.name for each in other.ranking]
    assert "left aside" in str(one)


def test_a_mean_square_below_zero_is_no_merit():
    # of a single feature whose noise is above what it holds: bias compensation, 1.7 times the error of ignoring it
    name, _, _, ignoring, _ = problems.judge(problems.SECOND["drowned"](np.random.default_rng([4, 11])))
    assert name != "bias compensation"
    assert ignoring[0] <= 1.0


def test_noise_that_the_data_do_not_hold_is_reported_and_taken_smaller():
    X, y, *_ = record(noise=0.7)
    right, twice = advise(X, y, noise=0.7), advise(X, y, noise=1.4)
    assert "less noise than was given" not in str(right)
    (sentence,) = [each for each in twice.assumed if "less noise than was given" in each]
    assert 0.4 < float(re.search(r"([\d.]+) of it", sentence)[1]) < 0.65
    assert twice.ranking[0].coef == pytest.approx([1.0, -2.0, 3.0], abs=0.5)


@pytest.mark.parametrize("samples", [20, 300])
def test_a_true_size_of_the_noise_is_called_wrong_by_chance_alone(samples):
    # y without noise of its own is the worst case, in which one record of a hundred may be called wrong
    wrong = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        clean = rng.standard_normal((samples, 3))
        X = clean + 0.5 * rng.standard_normal(clean.shape) * [1.0, 0.0, 2.0]
        wrong += admitted_noise(X, clean @ [1.0, 2.0, -1.0], np.array([0.5, 0.0, 1.0])) < 1
    assert wrong <= 5


def test_a_relation_that_would_turn_with_half_the_noise_is_not_advised():
    # of one feature whose noise is said to be as large as it allows, and whose relation is lost in the noise of y
    rng = np.random.default_rng(2)
    X = rng.standard_normal((300, 1))
    ranking = advise(X, X[:, 0] + 3 * rng.standard_normal(300), noise=0.9).ranking
    assert abs(ranking[0].coef[0]) < 2.0  # the relation without any noise in X has 1


def test_a_record_to_rely_on_has_no_warning_and_a_flawed_one_says_why():
    X, y, clean, rng = record()
    assert advise(X, y).warnings == advise(X, y, noise=0.01).warnings == ()

    def warned(X, y, **known):
        advice = advise(X, y, **known)
        assert all(f"Do not rely on this ranking: {each}" in str(advice) for each in advice.warnings)
        return " ".join(advice.warnings)

    assert "40 samples for 4 coefficients" in warned(X[:40], y[:40])
    rests = np.where(np.arange(400) // 40 == 3, 1.0, 0.01)[:, None] * X
    assert "a tenth of the record holds" in warned(
        rests, rests @ [1.0, 2.0, 3.0] + y - clean @ [1.0, -2.0, 3.0]
    )
    loud = np.where(np.arange(400) // 80 == 3, 1.0, 0.3) * rng.standard_normal(400)
    assert "of the 10 parts" in warned(X, loud)
    assert "signal-to-noise ratio" in warned(clean + rng.standard_normal(X.shape), y, noise=1.0)
    assert "instruments" in warned(X, y, instruments=rng.standard_normal(X.shape))
    assert "less noise than was given" in warned(clean, y, noise=2.0)


def test_instruments_that_miss_the_difference_of_two_features_are_warned_of():
    X, y, clean, rng = record(noise=0.05)
    twins = np.column_stack([X[:, 0], X[:, 0] + 0.01 * X[:, 1], X[:, 2]])
    seen = clean[:, [0, 2]]
    other = np.column_stack([seen, seen[:, 0]]) + 0.3 * rng.standard_normal((400, 3))
    advice = advise(twins, y, instruments=other)
    assert "left aside" not in str(advice)
    (warning,) = [each for each in advice.warnings if "instruments" in each]
    # the smallest eigenvalue of V^-1/2 X'PX V^-1/2 over the instruments, V the covariance of what is not explained
    centred, given = twins - twins.mean(axis=0), other - other.mean(axis=0)
    explained = given @ np.linalg.lstsq(given, centred)[0]
    left = (centred - explained).T @ (centred - explained) / 396
    expected = scipy.linalg.eigh(explained.T @ explained, left, eigvals_only=True)[0] / 3
    assert float(re.search(r"F = ([\d.]+)", warning)[1]) == pytest.approx(expected, rel=0.05)


def test_constant_features_are_advised_upon_all_the_same():
    assert advise(np.ones((40, 2)), np.arange(40.0) % 7).ranking[0].name == IGNORE


def test_errors_are_those_of_parts_that_are_held_out():
    # rows of equal leverage, so that the parts are of equal length
    X = np.tile(np.array(np.meshgrid(*3 * [[-1.0, 1.0]])).reshape(3, 8).T, (10, 1))
    y = X @ [1.0, -2.0, 3.0] + 0.5 * np.random.default_rng(1).standard_normal(80)
    ranked = {each.name: each for each in advise(X, y, folds=5, fit_intercept=False).ranking}
    losses = {"least squares": [], IGNORE: []}
    for part in np.array_split(np.arange(80), 5):
        kept = np.setdiff1d(np.arange(80), part)
        coef = np.linalg.lstsq(X[kept], y[kept])[0]
        losses["least squares"].append(np.mean((y[part] - X[part] @ coef) ** 2))
        losses[IGNORE].append(np.mean(y[part] ** 2))
    expected = np.sqrt(np.mean(losses["least squares"]) / np.mean(losses[IGNORE]))
    assert ranked["least squares"].error == pytest.approx(expected, rel=1e-5)
    assert ranked[IGNORE].error == 1.0
    assert {each.over_first for each in ranked.values() if each.over_first[0] == each.over_first[1]} == {
        (1.0, 1.0)
    }
    low, high = ranked[IGNORE].over_first
    assert low < 1 / min(each.error for each in ranked.values()) < high


def test_the_guide_runs(capsys):
    guide = (paths.root() / "docs" / "estimators.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```$", guide, re.DOTALL | re.MULTILINE)
    exec(block, {})
    assert capsys.readouterr().out.splitlines()[1].startswith("Huber")


def test_advice_is_the_same_in_any_unit():
    X, y, *_ = record(100, noise=0.3)
    units = np.array([1e-9, 1.0, 1e6])
    one, other = advise(X, y, noise=0.3), advise(X * units, 1e-6 * y, noise=0.3 * units)
    assert [each.name for each in one.ranking] == [each.name for each in other.ranking]
    for mine, its in zip(one.ranking, other.ranking, strict=True):
        assert its.error == pytest.approx(mine.error, rel=1e-4)
    assert one.turns == other.turns
    assert SAFE in [each.name for each in one.ranking]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"X": np.ones((5, 2)), "y": np.ones(5)}, r"^X\b.*six"),
        ({"y": np.ones(3)}, r"^y\b"),
        ({"noise": [0.1, 0.2]}, r"^noise\b.*3 features"),
        ({"noise": -1.0}, r"^noise\b"),
        ({"y": np.append(np.ones(399), np.nan)}, r"^y\b.*1 NaN.*X\[ok\]"),
        ({"X": np.where(np.eye(400, 3) > 0, np.nan, 1.0)}, r"^X\b.*3 NaN.*y\[ok\]"),
        ({"instruments": np.ones((400, 2))}, r"^instruments\b"),
    ],
)
def test_what_does_not_fit_is_refused(changed, message):
    X, y, *_ = record()
    with pytest.raises(InputError, match=message):
        advise(**{"X": X, "y": y} | changed)


@pytest.mark.slow
def test_advice_holds_on_problems_of_other_kinds():
    """Two of each kind; `benchmarks/advice.py` has three hundred."""
    found = [
        problems.judge(draw(np.random.default_rng([3, number])))
        for number, draw in enumerate(2 * list(problems.TEST.values()))
    ]
    over, ignoring = (np.array([each[place][0] for each in found]) for place in (2, 3))
    assert np.mean(over < 1.1) >= 0.8
    assert ignoring.max() < 1.2
