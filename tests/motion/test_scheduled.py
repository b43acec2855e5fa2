from dataclasses import replace

import numpy as np
import pytest

from experiments.motion.machines import shapes_along, stage, stage_mass
from experiments.motion.scan_study import output_rows
from notebooks.motion.scheduled_or_online import (
    GainTable,
    gain_table,
    observer_model,
    position_scan,
    published_fast_setpoint,
    run_applied,
    scheduled_gains,
)
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.control.pid import PidFamily
from stillwork.estimation.riccati import discrete_gain
from stillwork.estimation.robust import kalman_gains
from stillwork.estimation.time_varying import estimate
from stillwork.lti import zoh
from stillwork.lti.discretisation import zoh_modes

GRID = 0.05 * np.arange(7)


@pytest.fixture(scope="module")
def scan():
    return position_scan(stage(), GRID, published_fast_setpoint(5e-5), 0.03)


@pytest.fixture(scope="module")
def table(scan):
    model = observer_model(scan, 1e-4, 2e-18)
    places = np.linspace(0, 0.3, 61)
    rows = output_rows(shapes_along(stage(), GRID, places)[:, :4])
    return gain_table(model.a[1], model.g[1], rows, places, model.process, model.sensor)


def test_table_holds_stationary_gains_and_interpolates_linearly(scan, table):
    model = observer_model(scan, 1e-4, 2e-18)
    row = output_rows(shapes_along(stage(), GRID, [table.grid[7]])[:, :4])[0]
    gain = discrete_gain(model.a[1], model.g[1], row, model.process, model.sensor).filter_gain
    np.testing.assert_allclose(table.at([table.grid[7]])[0], gain, rtol=1e-9)
    middle = table.at([(table.grid[7] + table.grid[8]) / 2])[0]
    np.testing.assert_allclose(middle, (table.gains[7] + table.gains[8]) / 2, rtol=1e-9)


def test_at_rest_the_scheduled_filter_is_the_time_varying_one(scan, table):
    model = observer_model(scan, 1e-4, 2e-18)
    still = replace(model, c=np.repeat(model.c[:1], 400, axis=0), a=model.a[1], b=model.b[1], g=model.g[1])
    row = table.at([scan.places[0]])[0]
    exact = discrete_gain(model.a[1], model.g[1], model.c[0], model.process, model.sensor).filter_gain
    fixed = GainTable(np.array([0.0, 0.3]), np.array([exact, exact]))
    scheduled = scheduled_gains(still, fixed, np.full(400, 0.1))
    online = kalman_gains(still)
    np.testing.assert_allclose(scheduled.gain[1:], online.gain[1:], rtol=1e-6, atol=1e-9 * np.abs(row).max())


def test_what_looked_up_gains_leave_is_never_below_what_the_online_ones_do(scan, table):
    """By Joseph's form, which holds for any gain."""
    model = observer_model(scan, 1e-4, 2e-18)
    scheduled, online = scheduled_gains(model, table, scan.places), kalman_gains(model)
    p = model.initial_covariance
    deviations = np.sqrt(np.diag(online.covariance[-1]))
    for k in range(1, model.samples):
        spread = model.a[k] @ p @ model.a[k].T + model.g[k] @ model.process @ model.g[k].T
        rest = np.eye(8) - scheduled.gain[k] @ model.c[k]
        p = rest @ spread @ rest.T + scheduled.gain[k] @ model.sensor @ scheduled.gain[k].T
        if k % 20 == 0:
            more = (p - online.covariance[k]) / np.outer(deviations, deviations)
            assert np.linalg.eigvalsh(more)[0] >= -1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("increase", "compensate"), [(0.0, True), (0.035, False), (0.035, True)])
def test_applied_scan_is_its_naive_twin(scan, increase, compensate):
    rng = np.random.default_rng(0)
    samples, sample_time = len(scan.places), scan.setpoint.sample_time
    noise = rng.standard_normal((3, samples)) * np.array([0.01, 1e-9, 1e-9])[:, None]
    gains = kalman_gains(observer_model(scan, 1e-4, 2e-18))
    controller = PidFamily(stage_mass())(40.0)
    ran = run_applied(scan, gains, controller, stage_mass(), noise, increase, compensate)

    plant, control = zoh_modes(scan.plant, sample_time), zoh(controller.state_space(), sample_time)
    filters = [zoh(band_pass(float(w), 2.0), sample_time) for w in scan.plant.frequencies[1:4]]
    gain = damping_gain(scan.reduced, increase)[0, 3::2] if increase else np.zeros(3)
    x, z, bands, last = np.zeros(16), np.zeros(3), np.zeros((3, 2)), 0.0
    u, y, errors = [], [], []
    for k in range(samples):
        output = scan.shapes[k] @ x[::2] - noise[1, k]
        u.append(last)
        y.append(output + noise[2, k] - scan.compliance[k] * last)
        # The estimate up to here from the whole record, by the library's own filter.
        hat = ran.estimates[:, k]
        force = (control.c @ z)[0] + stage_mass() * scan.setpoint.derivatives[2, k] + gain @ bands[:, 1]
        flexible = gains.outputs[k, 0, 2::2] @ hat[2::2] if compensate else 0.0
        error = scan.setpoint.derivatives[0, k] - output - noise[2, k] + flexible
        z = control.a @ z + control.b[:, 0] * error
        velocities = hat[3::2]
        bands = np.array(
            [f.a @ b + f.b[:, 0] * v for f, b, v in zip(filters, bands, velocities, strict=True)]
        )
        errors.append(scan.setpoint.derivatives[0, k] - output)
        x = plant.a @ x + plant.b[:, 0] * (force + noise[0, k])
        last = force
    np.testing.assert_allclose(ran.error, errors, rtol=0, atol=1e-7 * np.abs(errors).max())
    shifted = np.append(u[1:], 0.0)
    again = estimate(gains, shifted[None], np.array(y)[None])
    scale = np.abs(again).max(axis=1, keepdims=True)
    np.testing.assert_allclose(ran.estimates / scale, again / scale, rtol=0, atol=1e-6)
