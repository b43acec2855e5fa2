"""Explorers of the time-varying filters: the worst disturbance, and scheduled beside online gains."""

from functools import cache

import numpy as np

from experiments.motion.energy_to_peak import error_system, generalised_h2_norm, predictor_gains
from experiments.motion.machines import published_setpoint, shapes_along, stage, stage_mass
from experiments.motion.position_scan import (
    APPLICATIONS,
    RETAINED,
    observer_model,
    position_scan,
    published_fast_setpoint,
    run_applied,
)
from experiments.motion.scan_study import output_rows, published_scan
from experiments.motion.scheduled import gain_table, scheduled_gains
from stillwork.control.pid import PidFamily
from stillwork.estimation.robust import kalman_gains
from stillwork.lti.discretisation import zoh_modes
from stillwork.workbook import figures

SPACING = 0.05  # m, of the masses; unpublished
STEP = 1e-4  # s


@cache
def _scaled_scan(sample_time: float):
    """Sampled model and output rows of the published scan, states in displacements, lengths in nanometres."""
    scan = published_scan(sample_time=sample_time)
    sampled = zoh_modes(scan.nominal, sample_time)
    flexible = scan.nominal.frequencies[1:]
    scale = np.array([1.0, flexible[0], *np.repeat(flexible, 2) ** np.array([0, 1, 0, 1])])
    c = 1e9 * output_rows(scan.shapes) * scale
    return sampled.a * scale / scale[:, None], sampled.b / scale[:, None], c, scan.deviations


def paint_worst(force: float, detuning: float):
    """Explorer: what the worst disturbance does to a filter designed for `detuning` times the `force` (N)."""
    sample_time = 1e-3
    a, b, c, (_, reference, sensor) = _scaled_scan(sample_time)
    noise = 1e18 * np.array([[reference**2 + sensor**2]])
    process = np.array([[force**2]])
    figure, (left, right) = figures.new(1, 2, height=2.8)
    time = sample_time * np.arange(len(c))
    for name, designed in (("Kalman", 1.0), ("detuned", detuning)):
        gains = predictor_gains(a, b, c, designed**2 * process, noise)
        found = generalised_h2_norm(error_system(a, b, c, process, noise, gains))
        peak = np.sqrt(np.linalg.eigvalsh(found.gramians[1:])[:, -1])
        left.semilogy(time, 1e9 * peak, label=f"{name}: {1e9 * found.norm:.3g}")
        right.plot(time, found.worst[:, 0], label=name)
    left.set_ylabel("largest possible error ($10^{-9}$ m√kg)")
    right.set_ylabel("worst force (in deviations)")
    figures.label((left, right), "time (s)")
    left.legend()
    return figure


@cache
def _table(spacing: float):
    plant = stage()
    grid = SPACING * np.arange(len(plant.output_shapes))
    scan = position_scan(plant, grid, published_setpoint(STEP), 0.0)
    model = observer_model(scan, 1e-4, 2e-18)
    places = np.linspace(grid[0], grid[-1], 1 + int(np.ceil(round((grid[-1] - grid[0]) / spacing, 9))))
    rows = output_rows(shapes_along(plant, grid, places)[:, :RETAINED])
    return gain_table(model.a[1], model.g[1], rows, places, model.process, model.sensor)


def paint_schedules(speed: str, start: float, spacing: float):
    """Explorer: error of the first flexible mode with online gains and with a table of this `spacing` (mm); AD, 36 Hz."""
    setpoint = published_setpoint(STEP) if speed == "1 m/s" else published_fast_setpoint(STEP)
    plant = stage()
    grid = SPACING * np.arange(len(plant.output_shapes))
    scan = position_scan(plant, grid, setpoint, start)
    model = observer_model(scan, 1e-4, 2e-18)
    deviations = np.array([0.01, 1e-9, 1e-9])[:, None]
    noise = np.random.default_rng(1).standard_normal((3, len(scan.places))) * deviations
    figure, axis = figures.new(1, 1, height=2.8)
    for name, gains in (
        ("online", kalman_gains(model)),
        ("scheduled", scheduled_gains(model, _table(1e-3 * spacing), scan.places)),
    ):
        ran = run_applied(
            scan, gains, PidFamily(stage_mass())(35.6), stage_mass(), noise, *APPLICATIONS["AD"]
        )
        error = ran.states[2] - ran.estimates[2]
        style = {"linewidth": 0.9, "label": f"{name}: largest {1e9 * np.abs(error).max():.3g}"}
        axis.plot(setpoint.time, 1e9 * error, **style)
    axis.set(xlabel="time (s)", ylabel="error of mode 1 (nm√kg)")
    axis.legend()
    return figure
