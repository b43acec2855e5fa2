import numpy as np
import pytest

from experiments.motion.machines import stage
from experiments.motion.scan_study import published_scan
from experiments.motion.uncertainty import norm_bound, perturbed, sample_errors, sampled_derivatives
from naive import motion_filters as naive
from notebooks.motion.robust_comparison import filter_model, judge, output_errors, record_scans
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.time_varying import TimeVaryingModel, estimate
from stillwork.lti.discretisation import zoh_modes


@pytest.fixture(scope="module")
def scan():
    return published_scan()


def small_model(seed=0, samples=30):
    rng = np.random.default_rng(seed)
    a = 0.6 * rng.normal(size=(3, 3)) / np.sqrt(3)
    b, g = rng.normal(size=(3, 1)), rng.normal(size=(3, 2))
    c = rng.normal(size=(samples, 2, 3))
    model = TimeVaryingModel(a, b, g, c, np.diag([1.0, 2.0]), np.diag([0.5, 0.3]), np.eye(3))
    return model, rng.normal(size=(1, samples)), rng.normal(size=(2, samples))


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


def test_errors_have_the_law_that_was_asked_for():
    rng, plant = np.random.default_rng(0), stage()
    ends = sample_errors(rng, plant, 0.05)
    assert np.all(ends[0] == 0)
    assert np.all(np.abs(ends[1:]) == 0.05)
    uniform = sample_errors(rng, plant, 0.05, "uniform", rigid=True)
    assert np.all(np.abs(uniform) <= 0.05)
    assert np.all(uniform[0] != 0)
    common = sample_errors(rng, plant, 0.05, "common", rigid=True)
    assert np.all(common == common[0])
    assert np.all(np.abs(common) == 0.05)
    many = np.array([sample_errors(rng, plant, 0.05, "normal", rigid=True) for _ in range(400)])
    assert abs(many.std() - 0.05) < 4 * 0.05 / np.sqrt(2 * many.size)


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


def test_hinfinity_filter_is_its_naive_twin():
    model, u, y = small_model()
    wanted = np.array([[1.0, 0.5, 0.0], [0.0, 0.0, 2.0]])
    level = 1.3 * smallest_level(model, wanted)
    ours = estimate(hinfinity_gains(model, wanted, level), u, y)
    matrices = (model.a[0], model.b[0], model.g[0], model.c, model.process, model.sensor)
    twin = naive.hinfinity(*matrices, wanted, level, model.initial_covariance, u, y)
    np.testing.assert_allclose(ours, twin, rtol=1e-8, atol=1e-9)


def test_the_pseudo_inverse_is_the_shortest_error_that_explains_the_output(scan):
    errors = [sample_errors(np.random.default_rng(k), scan.nominal, 0.05, rigid=True) for k in range(2)]
    records = record_scans(scan, errors, np.random.default_rng(3))
    window = np.flatnonzero(scan.setpoint.scanning)
    told = records.states.copy()
    shortest = np.zeros((2, 3, len(window)))
    for run in range(2):
        for k, sample in enumerate(window):
            row = scan.shapes[sample]
            away = records.y[run, 0, sample] - row @ records.states[run, ::2, sample]
            shortest[run, :, k] = np.linalg.lstsq(row[None], [away], rcond=None)[0]
            told[run, ::2, sample] += shortest[run, :, k]
    found = output_errors(scan, errors, records, told)
    np.testing.assert_allclose(found.innovation, 0, atol=1e-15)
    np.testing.assert_allclose(found.by_pseudo_inverse, np.sqrt(np.mean(shortest**2, axis=2)), rtol=1e-9)
    np.testing.assert_allclose(found.position_errors, found.by_pseudo_inverse, rtol=1e-9)
    exact = output_errors(scan, np.zeros((2, 3, 4)), records, records.states)
    np.testing.assert_allclose(exact.innovation, exact.noise, rtol=1e-12)
    np.testing.assert_allclose(exact.deformation_error, 0, atol=1e-20)


def test_errors_are_counted_in_the_scanning_phase(scan):
    records = record_scans(scan, [np.zeros((3, 4))], np.random.default_rng(0))
    window = scan.setpoint.scanning
    ramp = np.zeros_like(records.states)
    ramp[:, :, window] = np.linspace(1.0, 3.0, window.sum())
    found = judge(scan, records, records.states - ramp)
    np.testing.assert_allclose(found.bias, 2.0)
    np.testing.assert_allclose(found.drift, 2.0, rtol=1e-9)
    np.testing.assert_allclose(found.end, 3.0)
    np.testing.assert_allclose(found.accelerating, 0.0)
