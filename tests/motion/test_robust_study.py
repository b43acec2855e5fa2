import numpy as np
import pytest

from experiments.motion.machines import stage
from experiments.motion.scan_study import published_scan
from experiments.motion.uncertainty import norm_bound, perturbed, sample_errors, sampled_derivatives
from naive import motion_filters as naive
from notebooks.motion.robust_comparison import both_over_ad, filter_model, perturbed_ratios, record_scans
from stillwork.lti.discretisation import zoh_modes


@pytest.fixture(scope="module")
def scan():
    return published_scan()


@pytest.mark.parametrize("parameter", range(4))
@pytest.mark.parametrize("mode", [1, 2])
def test_derivatives_are_the_limit_of_perturbed_models(scan, mode, parameter):
    derivatives = sampled_derivatives(scan.nominal, scan.sample_time)
    errors, size = np.zeros((3, 4)), 1e-5
    errors[mode, parameter] = size
    up = zoh_modes(perturbed(scan.nominal, errors), scan.sample_time)
    down = zoh_modes(perturbed(scan.nominal, -errors), scan.sample_time)
    number = 4 * (mode - 1) + parameter
    for name in ("a", "b"):
        central = (getattr(up, name) - getattr(down, name)) / (2 * size)
        largest = np.abs(getattr(up, name)).max()
        np.testing.assert_allclose(getattr(derivatives, name)[number], central, rtol=0, atol=1e-9 * largest)


def rows_of(model, derivatives, errors, k):
    """First-order error of [C A, C B, C G] at sample k."""
    s, t, m = (each[k] for each in derivatives.rows(model))
    weights = np.concatenate([errors, errors])
    return np.concatenate([weights @ s, weights @ m, weights @ t])


@pytest.mark.slow
def test_the_norm_bound_covers_every_corner_of_the_errors(scan):
    model = filter_model(scan)
    derivatives = sampled_derivatives(scan.nominal, scan.sample_time).along(model, scan.shapes[:, None, :])
    bound = norm_bound(model, derivatives, 0.05)
    rng = np.random.default_rng(3)
    for k in (1, 700, 1900):
        e = np.hstack([bound.e_a[k], bound.e_b[k], bound.e_g[k]])
        scale = np.abs(e).max(axis=0)
        scale[scale == 0] = 1
        for _ in range(50):
            wanted = rows_of(model, derivatives, 0.05 * rng.choice([-1, 1], 8), k)
            # The smallest Delta with M Delta E = wanted; M is one here.
            delta, *_ = np.linalg.lstsq((e / scale).T, wanted / scale, rcond=None)
            np.testing.assert_allclose(delta @ e / scale, wanted / scale, rtol=0, atol=1e-9)
            assert np.linalg.norm(delta) <= 1 + 1e-9


def test_perturbed_modes_stay_sorted_and_keep_their_response():
    plant = stage()
    errors = np.zeros((8, 4))
    errors[6, 0], errors[7, 0] = 0.1, -0.1
    moved = perturbed(plant, errors)
    assert np.all(np.diff(moved.frequencies) >= 0)
    omega = np.array([300.0, 4000.0])
    w = plant.frequencies * (1 + errors[:, 0])
    modal = 1 / (w[:, None] ** 2 - omega**2 + 2j * plant.damping[:, None] * w[:, None] * omega)
    direct = np.einsum("om,mi,mf->oif", plant.output_shapes, plant.input_shapes, modal)
    np.testing.assert_allclose(moved.frequency_response(omega), direct, rtol=1e-10)


def test_recorded_scan_is_its_naive_twin(scan):
    errors = [sample_errors(np.random.default_rng(k), scan.nominal, 0.05, rigid=True) for k in range(2)]
    records = record_scans(scan, errors, np.random.default_rng(7))
    noise = np.random.default_rng(7).standard_normal((2, 3, 1901)) * np.array(scan.deviations)[:, None]
    for run in range(2):
        plant = zoh_modes(perturbed(scan.nominal, errors[run]), scan.sample_time)
        forward = scan.mass * scan.setpoint.derivatives[2]
        shapes = scan.shapes * (1 + errors[run][:, 3])
        reference = scan.setpoint.derivatives[0]
        states, u, y = naive.scan(plant.a, plant.b, shapes, reference, forward, scan.controller, noise[run])
        for ours, twin in ((records.states[run], states), (records.u[run, 0], u), (records.y[run, 0], y)):
            np.testing.assert_allclose(ours, twin, rtol=1e-7, atol=1e-9 * np.abs(twin).max())


@pytest.mark.parametrize("size", [0.0, 0.05])
def test_both_over_ad_is_that_of_table_5_2(size):
    """At the printed Q_nu from the whole table, with the same noise; at a small one the two are about equal."""
    table = perturbed_ratios(4, 7, size=size, sample_time=1e-4)
    found = both_over_ad(1e3, 4, 7, size=size, sample_time=1e-4)
    np.testing.assert_allclose(found["original"], table["MC and AD"] / table["AD"], rtol=1e-9)
    whole = table["MC and AD, redesigned"] / table["AD, redesigned"]
    np.testing.assert_allclose(found["redesigned"], whole, rtol=1e-9)
    small = both_over_ad(0.03, 4, 7, size=size, sample_time=1e-4)
    assert np.all(small["original"] > found["original"]) and abs(np.median(small["original"]) - 1) < 0.03
