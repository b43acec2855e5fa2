"""Scans along the structure with the observer in the loop: Example 5.6.1 of the observer thesis."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.machines import (
    published_deviations,
    published_setpoint,
    shapes_along,
    stage,
    stage_mass,
)
from experiments.motion.scan_study import along_scan, contiguous, output_rows
from stillwork.base.algebra import add_scaled, advance_state, copy_vector, minus_row, plus_column, plus_row
from stillwork.base.checks import InputError
from stillwork.base.kernels import kernel
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.control.pid import Pid, PidFamily
from stillwork.control.setpoint import Setpoint, point_to_point
from stillwork.estimation.riccati import discrete_gain
from stillwork.estimation.robust import kalman_gains
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel
from stillwork.lti.discretisation import zoh, zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from workbook import figures


@dataclass(frozen=True)
class GainTable:
    """Stationary filter gains on a grid of positions."""

    grid: Float64[np.ndarray, " places"]  # m, ascending
    gains: Float64[np.ndarray, "places states outputs"]

    def at(self, places: ArrayLike) -> Float64[np.ndarray, "samples states outputs"]:
        """Gains at places (m) on the grid by linear interpolation."""
        places = np.asarray(places, float)
        right = np.clip(np.searchsorted(self.grid, places), 1, len(self.grid) - 1)
        part = (places - self.grid[right - 1]) / (self.grid[right] - self.grid[right - 1])
        part = part[:, None, None]
        return (1 - part) * self.gains[right - 1] + part * self.gains[right]


def gain_table(
    a: ArrayLike, g: ArrayLike, rows: ArrayLike, grid: ArrayLike, process: ArrayLike, sensor: ArrayLike
) -> GainTable:
    """Stationary Kalman filter gains for the rows of C at every point of an ascending grid (m)."""
    gains = [discrete_gain(a, g, c, process, sensor).filter_gain for c in np.asarray(rows, float)]
    return GainTable(np.asarray(grid, float), np.array(gains))


def scheduled_gains(model: TimeVaryingModel, table: GainTable, places: ArrayLike) -> FilterGains:
    """Filter whose gain is looked up at every sample; everything else is the time-varying filter's."""
    return FilterGains(model.a, model.b, table.at(places), model.c)


RETAINED, COMPENSATED = 4, 3


@dataclass(frozen=True)
class PositionScan:
    """One scan of the eight-mode stage and the four-mode model that the observer has of it."""

    plant: ModalModel  # all modes, one output a grid point
    setpoint: Setpoint
    places: Float64[np.ndarray, " samples"]  # m, where the sensor looks
    shapes: Float64[np.ndarray, "samples modes"]  # output shape of the plant there
    compliance: Float64[np.ndarray, " samples"]  # m/N, T_DC there

    @property
    def reduced(self) -> ModalModel:
        """The modes of the observer's model."""
        return self.plant.modes(slice(0, RETAINED))


def position_scan(plant: ModalModel, grid: ArrayLike, setpoint: Setpoint, start: float) -> PositionScan:
    """A scan that begins with the sensor at `start` (m) along the `grid` of the plant's outputs."""
    from scipy.interpolate import CubicSpline

    places = start + setpoint.derivatives[0]
    compliance = truncate(plant, RETAINED, COMPENSATED).feedthrough[:, 0]
    shapes = shapes_along(plant, grid, places)
    return PositionScan(plant, setpoint, places, shapes, CubicSpline(grid, compliance)(places))


def observer_model(scan: PositionScan, process: float, sensor: float) -> TimeVaryingModel:
    """Four-mode model along the scan for the filters; variances of w (N^2) and of the measurement (m^2)."""
    return along_scan(scan.reduced, scan.setpoint.sample_time, scan.shapes[:, :RETAINED], process, sensor)


@dataclass(frozen=True)
class AppliedScan:
    """What one scan with the observer in the loop gave."""

    estimates: Float64[np.ndarray, "states samples"]
    states: Float64[np.ndarray, "states samples"]  # true, of the retained modes
    error: Float64[np.ndarray, " samples"]  # r - y, m


def run_applied(
    scan: PositionScan,
    gains: FilterGains,
    controller: Pid,
    mass: float,
    noise: ArrayLike,
    increase: float = 0.0,
    compensate: bool = False,
) -> AppliedScan:
    """Simulate a scan with MC (`compensate`), AD (`increase` of the damping ratios) or both.

    The compliance T_DC is taken off with the last held force. `noise` holds w (N), v and d (m); `mass` (kg) is that
    of the acceleration feedforward.
    """
    setpoint, sample_time = scan.setpoint, scan.setpoint.sample_time
    samples = setpoint.derivatives.shape[1]
    noise = np.asarray(noise, float)
    plant = zoh_modes(scan.plant, sample_time)
    flexible = scan.reduced.frequencies[1:]
    gain = damping_gain(scan.reduced, increase)[0, 3::2]
    filters = [zoh(band_pass(float(w), 2.0), sample_time) for w in flexible]
    control = zoh(controller.state_space(), sample_time)
    compensation = compensate * gains.outputs[:, 0]
    compensation[:, :2] = 0.0  # the rigid body is no deformation
    estimates, states = np.zeros((samples, 2 * RETAINED)), np.zeros((samples, len(plant.a)))
    error = np.zeros(samples)
    _applied(
        contiguous(plant.a, plant.b[:, 0], scan.shapes, scan.compliance),
        contiguous(gains.forward, gains.inputs[:, :, 0], gains.gain[:, :, 0], gains.outputs[:, 0]),
        contiguous(control.a, control.b[:, 0], control.c),
        contiguous([f.a for f in filters], [f.b[:, 0] for f in filters], gain),
        compensation,
        contiguous(setpoint.derivatives[0], mass * setpoint.derivatives[2], noise),
        (estimates, states, error),
    )
    if not np.all(np.isfinite(error)) or np.abs(error).max() > 1.0:
        raise InputError("the loop with this observer is unstable; lower the controller's bandwidth")
    known = np.ascontiguousarray(states[:, : 2 * RETAINED].T)
    return AppliedScan(np.ascontiguousarray(estimates.T), known, error)


@kernel
def _applied(plant, observer, control, filters, compensation, given, found):
    a, b, shapes, compliance = plant
    forward, inputs, gain, outputs = observer
    (ca, cb, cc), (fa, fb, damping) = control, filters
    (reference, feedforward, noise), (estimates, states, error) = given, found
    samples, n, m, modes = len(reference), a.shape[0], ca.shape[0], fa.shape[0]
    r = forward.shape[1]
    x, x_next, z, z_next = np.zeros(n), np.zeros(n), np.zeros(m), np.zeros(m)
    band, hat, hat_next = np.zeros((modes, 2)), np.zeros(r), np.zeros(r)
    positions, last = x[::2], 0.0
    for k in range(samples):
        output = plus_row(-noise[1, k], shapes, k, positions)
        measured = output + noise[2, k]
        if k > 0:
            advance_state(forward[k], inputs[k], last, hat, hat_next)
            innovation = minus_row(measured - compliance[k] * last, outputs, k, hat)
            add_scaled(innovation, gain[k], hat)
        force = plus_row(feedforward[k] + plus_column(0.0, band, 1, damping), cc, 0, z)
        difference = reference[k] - measured + plus_row(0.0, compensation, k, hat)
        advance_state(ca, cb, difference, z, z_next)
        for i in range(modes):
            velocity = hat[2 * (i + 1) + 1]
            first = fa[i, 0, 0] * band[i, 0] + fa[i, 0, 1] * band[i, 1] + fb[i, 0] * velocity
            band[i, 1] = fa[i, 1, 0] * band[i, 0] + fa[i, 1, 1] * band[i, 1] + fb[i, 1] * velocity
            band[i, 0] = first
        error[k] = reference[k] - output
        copy_vector(x, states[k])
        advance_state(a, b, force + noise[0, k], x, x_next)
        copy_vector(hat, estimates[k])
        last = force


APPLICATIONS = {"MC": (0.0, True), "AD": (0.035, False), "MC and AD": (0.035, True)}


@dataclass(frozen=True)
class ScheduleComparison:
    """Estimation errors of both implementations in many scans; the last axis: the retained states."""

    starts: Float64[np.ndarray, " scans"]  # m
    online: Float64[np.ndarray, "norms scans states"]  # two-norm and largest error, time-varying filter
    scheduled: Float64[np.ndarray, "norms scans states"]  # the same with interpolated stationary gains

    @property
    def ratio(self) -> Float64[np.ndarray, "norms scans states"]:
        """Scheduled over online."""
        return self.scheduled / self.online


def compare_schedules(
    setpoint: Setpoint,
    cases: Mapping[str, tuple[str, Pid]],
    mass_spacing: float,
    table_spacing: float,
    seed: int,
) -> dict[str, ScheduleComparison]:
    """29 scans at equally spaced starts over all of the structure, each with both gain schedules and the same noise.

    `cases` hold a key of `APPLICATIONS` and the controller; distances of the masses and of the table in m.
    """
    plant, deviations = stage(), np.array(list(published_deviations().values()))
    grid, rng = mass_spacing * np.arange(len(plant.output_shapes)), np.random.default_rng(seed)
    travel = setpoint.derivatives[0, -1]
    starts = np.linspace(grid[0], grid[-1] - travel * (1 + 1e-12), 29)
    found = {name: np.zeros((2, 2, len(starts), 2 * RETAINED)) for name in cases}
    for k, start in enumerate(starts):
        scan = position_scan(plant, grid, setpoint, float(start))
        model = observer_model(scan, deviations[0] ** 2, (deviations[1:] ** 2).sum())
        if k == 0:
            table = table_over(plant, grid, model, table_spacing)
        noise = rng.standard_normal((3, len(scan.places))) * deviations[:, None]
        for which, gains in enumerate((kalman_gains(model), scheduled_gains(model, table, scan.places))):
            for name, (application, controller) in cases.items():
                ran = run_applied(scan, gains, controller, stage_mass(), noise, *APPLICATIONS[application])
                error = ran.states - ran.estimates
                found[name][which, :, k] = np.linalg.norm(error, axis=1), np.abs(error).max(axis=1)
    return {name: ScheduleComparison(starts, *both) for name, both in found.items()}


def table_over(
    plant: ModalModel, grid: Float64[np.ndarray, " outputs"], model: TimeVaryingModel, spacing: float
) -> GainTable:
    """Stationary gains over all of the structure, at places at most `spacing` (m) apart."""
    count = int(np.ceil(round((grid[-1] - grid[0]) / spacing, 9)))
    places = np.linspace(grid[0], grid[-1], count + 1)
    rows = output_rows(shapes_along(plant, grid, places)[:, :RETAINED])
    return gain_table(model.a[1], model.g[1], rows, places, model.process, model.sensor)


def published_fast_setpoint(sample_time: float) -> Setpoint:
    """The aggressive move of Example 5.6.1, 10 m/s at 10000 m/s^2, over the same 0.17 m.

    Snap and jerk are not published; these reach the acceleration in two snap segments, as the normal move does.
    """
    return point_to_point(4e10, 2e7, 1e4, 10.0, 0.015, 0.002, sample_time)


SAMPLE_TIME = 1e-4  # s
GRID = 0.05 * np.arange(7)  # m, the masses of the stage; unpublished


def _scan(setpoint: Setpoint, start: float) -> tuple[PositionScan, TimeVaryingModel]:
    scan = position_scan(stage(), GRID, setpoint, start)
    return scan, observer_model(scan, 1e-4, 2e-18)


@cache
def _table(spacing: float) -> GainTable:
    return table_over(stage(), GRID, _scan(published_setpoint(SAMPLE_TIME), 0.0)[1], spacing)


def paint_schedules(speed: str, start: float, spacing: str):
    """Explorer: error of the first flexible mode with online gains and with a table of this `spacing` ("5 mm"); AD, 36 Hz."""
    setpoint = published_setpoint(SAMPLE_TIME) if speed == "1 m/s" else published_fast_setpoint(SAMPLE_TIME)
    scan, model = _scan(setpoint, start)
    deviations = np.array([0.01, 1e-9, 1e-9])[:, None]
    noise = np.random.default_rng(1).standard_normal((3, len(scan.places))) * deviations
    figure, axis = figures.new(1, 1, height=2.8)
    scheduled = scheduled_gains(model, _table(1e-3 * float(spacing.split()[0])), scan.places)
    controller = PidFamily(stage_mass())(35.6)
    for name, gains in (("online", kalman_gains(model)), ("scheduled", scheduled)):
        ran = run_applied(scan, gains, controller, stage_mass(), noise, *APPLICATIONS["AD"])
        error = ran.states[2] - ran.estimates[2]
        style = {"linewidth": 0.9, "label": f"{name}: largest {1e9 * np.abs(error).max():.3g}"}
        axis.plot(setpoint.time, 1e9 * error, **style)
    axis.set(xlabel="time (s)", ylabel="error of mode 1 (nm√kg)")
    axis.legend()
    return figure


Found = Mapping[str, Mapping[str, ScheduleComparison]]  # by speed, then by application and controller


def both_norms(found: Mapping[str, ScheduleComparison]) -> Float64[np.ndarray, "2 ratios"]:
    """Scheduled over online: the two-norms, then the largest errors, of all cases, scans and states."""
    return np.concatenate([each.ratio.reshape(2, -1) for each in found.values()], axis=1)


def paint_comparison(found: Mapping[str, ScheduleComparison]):
    """Both norms of the error, scheduled over online, over the start of the scan; a column a speed."""
    figure, axes = figures.new(2, 2, sharex=True, sharey="row")
    for column, (speed, each) in enumerate(found.items()):
        for row, norm in enumerate(("two-norm", "largest value")):
            axis = axes[row, column]
            for state, label in ((0, "rigid body"), (2, "mode 1"), (4, "mode 2"), (6, "mode 3")):
                values = each.ratio[row, :, state]
                axis.plot(each.starts, values, ".-", linewidth=0.7, label=f"{label}, position")
            axis.set_title(f"{norm} of the error, {speed}")
            shade = {"color": figures.GREY, "alpha": 0.15, "linewidth": 0, "label": "within 5 %"}
            axis.axhspan(0.95, 1.05, **shade)
    figures.label(axes, "start of the scan (m)", "scheduled over online")
    figures.legend_below(axes[0, 0], 5)
    return figure


def appendix(page, *, found: Found, cases: Mapping, fast: Setpoint, mass_spacing: float, seed: int) -> None:
    """What the page of motion/23 judges beside its answer; `fast` is the move at 10 m/s."""
    page.text("## Estimation error, scheduled over online, all scans and states")
    rows = []
    for speed, both in found.items():
        for name, each in both.items():
            two, largest = each.ratio
            rows.append(
                {
                    "speed": speed,
                    "application, controller": name,
                    "two-norm, median": f"{np.median(two):.3f}",
                    "range": f"{two.min():.3f} .. {two.max():.3f}",
                    "largest, median": f"{np.median(largest):.3f}",
                    "range of largest": f"{largest.min():.3f} .. {largest.max():.3f}",
                }
            )
    page.show(pd.DataFrame(rows), index=False)
    page.text("""## Coarser tables

Two-norms at 10 m/s, scheduled over online, for AD with both controllers and three distances of the masses.""")
    some = {name: cases[name] for name in ("AD, original", "AD, redesigned")}
    coarse = {
        f"{1e3 * spacing:g} mm, {name}, masses {1e3 * distance:g} mm apart": np.quantile(
            each.ratio[0], [0, 0.5, 1]
        )
        for distance in (mass_spacing, 0.04, 0.07)
        for spacing in (0.005, 0.025, 0.05, 0.1)
        for name, each in compare_schedules(fast, some, distance, spacing, seed).items()
    }
    table = pd.DataFrame(coarse, index=["lowest", "median", "highest"]).T
    page.show(table.round(3))
    coarsest = table[table.index.str.startswith("100 mm")]["median"]
    page.check("motion.example-5-6-1.coarse-table", coarsest.max(), (coarsest.min(), coarsest.max()))
    page.conclude(
        "A table of 100 mm errs {low:.2f} to {high:.2f} times as much as the online gain in the median: what neither filter models, "
        "the omitted modes and the feedforward mismatch, matters more. This is no advice to use a coarse table.",
        low=coarsest.min(),
        high=coarsest.max(),
    )
