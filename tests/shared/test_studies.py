from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from shared import trials
from stillwork.base.checks import InputError
from workbook.studies import mean_interval, proportion_interval, run_study, spread_interval

RUNS, SEED = 23, 5


def study(executor=None, **settings):
    return run_study(trials.draw, RUNS, SEED, executor=executor, progress=False, **settings)


def assert_same(one, other):
    assert one.values.keys() == other.values.keys()
    for quantity in one.values:
        assert one[quantity].tobytes() == other[quantity].tobytes()


@pytest.mark.parametrize("workers", [1, 3])
@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_the_result_depends_neither_on_the_executor_nor_on_its_workers(kind, workers):
    with kind(workers) as executor:
        assert_same(study(executor), study())


@pytest.mark.slow
def test_a_cluster_gives_the_numbers_of_a_serial_run():
    from distributed import Client, LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        with Client(cluster) as client, client.get_executor() as executor:
            assert_same(study(executor, mean=2.0), study(mean=2.0))


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


def test_more_runs_continue_the_same_streams():
    short = run_study(trials.draw, 5, SEED, progress=False)
    np.testing.assert_array_equal(short["level"], study()["level"][:5])


def test_trials_run_at_once():
    import threading

    barrier = threading.Barrier(4, timeout=10)

    def meet(_rng):
        barrier.wait()
        return {"met": 1.0}

    with ThreadPoolExecutor(4) as executor:
        assert run_study(meet, 4, 1, executor=executor, progress=False)["met"].sum() == 4


@pytest.mark.parametrize("executor", [None, "threads"])
def test_an_error_in_a_trial_comes_through(executor):
    with ThreadPoolExecutor(2) as pool, pytest.raises(ValueError, match="convergence"):
        run_study(trials.failing, 3, 1, executor=pool if executor else None, progress=False)


def test_trials_must_return_the_same_quantities():
    with pytest.raises(InputError, match=r"^trial\b"):
        run_study(trials.uneven, 20, 1, progress=False)


@pytest.mark.parametrize("runs", [0, -1, True])
def test_runs_is_a_count(runs):
    with pytest.raises(InputError, match=r"^runs\b"):
        run_study(trials.draw, runs, 1, progress=False)


def test_progress_shows_to_a_person_and_not_in_a_build(monkeypatch, capsys):
    run_study(trials.draw, 3, 1)
    assert "draw" in capsys.readouterr().err
    monkeypatch.setenv("STILLWORK_OUTPUT", "/somewhere")
    run_study(trials.draw, 3, 1)
    assert capsys.readouterr().err == ""


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


@pytest.mark.slow
@given(st.integers(1, 200), st.data())
def test_wilsons_interval_solves_wilsons_equation(runs, data):
    """Its ends are the p at which the observed fraction lies z standard errors off (Wilson 1927)."""
    successes = data.draw(st.integers(0, runs))
    fraction, z = successes / runs, stats.norm.ppf(0.975)
    low, high = proportion_interval(successes, runs)
    assert 0 <= low <= fraction <= high <= 1
    for end in (low, high):
        assert (fraction - end) ** 2 == pytest.approx(z**2 * end * (1 - end) / runs, abs=1e-9)


@pytest.mark.parametrize("interval", [mean_interval, spread_interval])
def test_one_run_has_no_interval(interval):
    with pytest.raises(InputError, match=r"^values\b"):
        interval([1.0])
    with pytest.raises(InputError, match="level"):
        interval([1.0, 2.0], 1.0)
    with pytest.raises(InputError, match=r"^values\b"):
        interval([1.0, np.nan])
