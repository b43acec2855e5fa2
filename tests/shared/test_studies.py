import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from shared import trials
from workbook.checks import InputError
from workbook.studies import mean_interval, proportion_interval, run_study, spread_interval

RUNS, SEED = 23, 5


def study(**settings):
    return run_study(trials.draw, RUNS, SEED, progress=False, **settings)


def test_each_trial_has_the_stream_that_the_docstring_promises():
    done = study(mean=1.0, size=2)
    streams = np.random.SeedSequence(SEED).spawn(RUNS)
    for k, stream in enumerate(streams):
        rng = np.random.default_rng(stream)
        assert done["level"][k] == rng.normal(1.0)
        np.testing.assert_array_equal(done["path"][k], rng.normal(size=2))
    assert done.runs == RUNS
    assert done.seed == SEED
    assert done["path"].shape == (RUNS, 2)


def test_an_error_in_a_trial_comes_through():
    with pytest.raises(ValueError, match="convergence"):
        run_study(trials.failing, 3, 1, progress=False)


def coverage(hits):
    """Fraction, and four standard errors of it: one in 16000 seeds would fail by chance."""
    return np.mean(hits), 4 * np.sqrt(np.mean(hits) * (1 - np.mean(hits)) / len(hits))


@pytest.mark.slow
@pytest.mark.parametrize(("level", "runs"), [(0.5, 2), (0.9, 5), (0.95, 20)])
def test_intervals_cover_as_often_as_they_say(level, runs):
    rng = np.random.default_rng(1)
    mean_hits, next_hits = [], []
    for _ in range(1500):
        sample = rng.normal(3.0, 2.0, size=runs)
        low, high = mean_interval(sample, level)
        mean_hits.append(low <= 3.0 <= high)
        low, high = spread_interval(sample, level)
        next_hits.append(low <= rng.normal(3.0, 2.0) <= high)
    for hits in (mean_hits, next_hits):
        fraction, margin = coverage(hits)
        assert abs(fraction - level) < margin


def test_the_mean_interval_is_the_textbooks():
    sample = [1.0, 2.0, 4.0]
    expected = stats.ttest_1samp(sample, 0).confidence_interval(0.9)
    np.testing.assert_allclose(mean_interval(sample, 0.9), [expected.low, expected.high])


@given(st.integers(1, 2000), st.data())
def test_the_interval_of_a_proportion_is_scipys(runs, data):
    successes = data.draw(st.integers(0, runs))
    expected = stats.binomtest(successes, runs).proportion_ci(0.95, method="wilson")
    found = proportion_interval(successes, runs)
    assert found == pytest.approx((expected.low, expected.high), abs=1e-12)


@pytest.mark.parametrize("interval", [mean_interval, spread_interval])
def test_one_run_has_no_interval(interval):
    with pytest.raises(InputError, match=r"^values\b"):
        interval([1.0])
    with pytest.raises(InputError, match="level"):
        interval([1.0, 2.0], 1.0)
    with pytest.raises(InputError, match=r"^values\b"):
        interval([1.0, np.nan])
