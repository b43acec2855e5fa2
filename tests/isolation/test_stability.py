import numpy as np
import pytest

from experiments.isolation.floors import flat_floor
from experiments.isolation.simulation import simulate, simulate_together
from experiments.isolation.twin import load_twin
from notebooks.isolation.numerical_stability import (
    FORMS,
    condition_bounds,
    covariance_run,
    peak_error,
    recur,
    scaled_condition,
    shared_motion,
    stability_map,
    steady_start,
)
from stillwork.base.checks import InputError
from stillwork.estimation.adaptive import FeRls

FORGETTING = 0.99


def regressors(n=5, samples=2000, seed=0):
    rng = np.random.default_rng(seed)
    return (np.eye(n) + 0.3 * rng.standard_normal((n, n))) @ rng.standard_normal((n, samples))


@pytest.mark.parametrize(("form", "rate"), [("one product", 1.0), ("both products", -1.0), ("Joseph", -1.0)])
def test_what_becomes_of_an_antisymmetric_error(form, rate):
    # Far above rounding and far below P: the error is followed on its own.
    psi, code = regressors(), FORMS.index(form)
    matrix = np.linalg.inv(psi @ psi.T / psi.shape[1]) * (1 - FORGETTING)
    upper = np.triu(np.ones((5, 5)), 1)
    matrix = matrix + 1e-9 * np.linalg.norm(matrix) * (upper - upper.T)
    before, samples = np.linalg.norm(matrix - matrix.T), 500
    recur(code, matrix, np.ascontiguousarray(psi.T[:samples]), FORGETTING, np.empty(5), np.empty(5))
    growth = np.linalg.norm(matrix - matrix.T) / before
    found = np.log(growth) / (-samples * np.log(FORGETTING))
    if rate > 0:
        assert found == pytest.approx(rate, abs=1e-3)
    else:
        assert found < -0.5


@pytest.mark.parametrize("form", FORMS)
def test_every_form_follows_the_inverse_while_it_lasts(form):
    run = covariance_run(form, regressors(), FORGETTING, np.eye(5), 10)
    assert np.all(run.error < 1e-9)
    assert np.all(np.abs(run.smallest - 1) < 1e-9)
    assert run.breakdown == np.inf


def test_one_product_breaks_and_the_triangle_does_not():
    psi, start = regressors(), 0.01 * np.eye(5)
    broken = covariance_run("one product", psi, FORGETTING, start, 60)
    assert 30 < broken.breakdown < 45
    assert broken.growth_rate() == pytest.approx(-np.log(FORGETTING) / (1 - FORGETTING), abs=0.01)
    single = covariance_run("one product", psi, FORGETTING, start, 60, "float32")
    assert 12 < single.breakdown < 25
    for precision in ("float64", "float32"):
        safe = covariance_run("triangle", psi, FORGETTING, start, 60, precision)
        assert safe.breakdown == np.inf and not safe.asymmetry.any()


def test_shared_motion_has_the_condition_number_asked_for():
    # Of 20 000 samples: eigenvalues scatter by sqrt(9 / 20 000), the units by less.
    assert scaled_condition(shared_motion(1e4, 20_000, 0)) == pytest.approx(1e4, rel=0.1)
    scaled = np.geomspace(1e-3, 1e3, 9)[:, None] * shared_motion(1e4, 20_000, 0)
    assert scaled_condition(scaled) == pytest.approx(1e4, rel=0.1)


def test_distance_is_that_of_the_generalised_eigenvalues():
    psi, start = shared_motion(100.0, 200, 1), 0.01 * np.eye(9)
    run = covariance_run("triangle", psi, FORGETTING, start, 2, "float32")
    rounded = float(np.float32(FORGETTING))
    p, information = start.astype(np.float32), np.linalg.inv(start)
    for x in psi.astype(np.float32).T[: 2 * 4 * 25]:
        g = p @ x
        p = ((p - np.outer(g, g) / (np.float32(FORGETTING) + x @ g)) / np.float32(FORGETTING)).astype(
            np.float32
        )
        information = rounded * information + np.outer(x, x).astype(float)
    exact = np.abs(np.linalg.eigvals(information @ (p + p.T) / 2).real - 1).max()
    assert exact / 5 < run.distance[-1] < 5 * exact  # two orders of summation


def test_float32_breaks_beyond_the_bound_and_the_factors_do_not():
    certain, mean = condition_bounds(float(np.exp(-1 / 500)), "float32")
    found = stability_map((certain / 30, 300 * mean), ("float32",), ("triangle", "UD"), 2, 500, 8)
    triangle, factored = found["float32", "triangle"], found["float32", "UD"]
    assert np.isinf(triangle[1, 0]).all() and np.isfinite(triangle[1, 1]).all()
    assert np.isinf(factored[1]).all() and np.all(factored[0] < 1)
    assert triangle[0, 0].max() < 1


def test_steady_start_is_where_the_recursion_stays():
    psi = regressors(samples=100)
    start = steady_start(np.tile(psi, 50), FORGETTING)
    run = covariance_run("UD", psi, FORGETTING, start, 8, per_time_constant=1)
    assert run.error[-1] < 0.6  # a repeated memory of one record: within the window's ripple


@pytest.mark.parametrize("form", FORMS)
def test_silence_winds_every_form_up(form):
    psi = regressors()
    psi[3] = 0
    run = covariance_run(form, psi, FORGETTING, 0.01 * np.eye(5), 20)
    np.testing.assert_allclose(run.largest, FORGETTING ** (-run.time_constants / (1 - FORGETTING)), rtol=1e-6)


@pytest.mark.parametrize("form", FORMS)
def test_what_an_explorer_watches_is_that_of_the_whole_run(form):
    whole, lean = (
        covariance_run(form, regressors(), FORGETTING, np.eye(5), 60, "float32", against_exact=each)
        for each in (True, False)
    )
    np.testing.assert_array_equal(lean.asymmetry, whole.asymmetry)
    np.testing.assert_array_equal(lean.largest, whole.largest)
    assert lean.breakdown == whole.breakdown


@pytest.mark.slow
def test_limit_protects_the_twin_where_the_printed_algorithm_breaks():
    # A tenth of the published time constant: ten times the gain, so that a short silence is enough.
    twin, forgetting = load_twin("rigid_body"), float(np.exp(-2e-4))
    floor, quiet = flat_floor(), flat_floor(level=[1.5e-3, 1.5e-3, 0.0])
    start = 10 * np.array([0.48, 0.48, 0.48, 0.6, 0.6, 0.6, 0.79, 0.79, 0.79])
    stages = [(2.0, floor), (12.0, quiet), (2.0, floor)]
    options = {"seed": 3, "keep_every_s": 0.02, "to_the_break": True}
    broken = simulate(twin, stages, adaptation=FeRls(start, forgetting, np.inf), **options)
    assert 14.0 < broken.broke_s < 15.0 and peak_error(broken, 14.0) == np.inf
    assert broken.time_s[-1] <= broken.broke_s
    same = options | {"signals_from_s": broken.broke_s - 1.0}
    again = simulate(twin, stages, adaptation=FeRls(start, forgetting, np.inf), **same)
    alone = simulate(twin, stages, weights=None, feedback=False, seed=3, signals_from_s=broken.broke_s - 1.0)
    np.testing.assert_array_equal(again.floor, alone.floor[:, : again.floor.shape[1]])  # to the last sample
    with pytest.raises(InputError, match=r"^to_the_break\b"):
        simulate_together(twin, stages, seeds=[1, 2], adaptations={"": None}, to_the_break=True)
    kept = simulate(twin, stages, adaptation=FeRls(start, forgetting), **options)
    assert kept.broke_s is None and peak_error(kept, 14.0) < 3
