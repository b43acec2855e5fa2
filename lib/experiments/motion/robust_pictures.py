"""Figures of the robust-observer comparison."""

from collections.abc import Mapping, Sequence
from functools import lru_cache

import numpy as np

from experiments.motion.contest import ENTRANTS, Contest, prepare, run_entrant, sample_scans
from experiments.motion.scan_study import Errors, Records, Scan, published_scan
from workbook import figures

STATES = [
    (mode, *error)
    for mode in ("rigid body", "first flexible mode", "second flexible mode")
    for error in (("position error (nm √kg)", 1e9), ("velocity error (µm/s √kg)", 1e6))
]
SAID = {  # of Fig. 5.10, what hangs on the weight, by claim
    "sensitivity-rigid-as-kalman": "penalised filter's rigid body as Kalman's",
    "regularised-worst-on-flexible": "regularised filter worst on flexible states",
    "sensitivity-drift": "penalised filter drifts more than Kalman's",
    "sensitivity-end-above-state": "penalised filter's error at the end above the state",
}
PUBLISHED = ("Kalman", "sensitivity penalised", "regularised least squares")
COLOURS = dict(zip(ENTRANTS, (figures.RED, figures.BLUE, figures.GREEN), strict=False))


def paint_state_errors(scan: Scan, truth: np.ndarray, estimates: Mapping[str, np.ndarray]):
    """Estimation errors of one run over time, one panel a state, on a symmetric logarithmic axis (Fig. 5.10)."""
    from matplotlib.ticker import FixedLocator

    figure, axes = figures.new(3, 2, sharex=True)
    time = scan.setpoint.time
    for k, axis in enumerate(axes.ravel()):
        mode, unit, factor = STATES[k]
        if k >= 2:
            axis.plot(time, truth[k] * factor, color=figures.GREY, linewidth=0.8, label="true state")
        for name, estimate in estimates.items():
            error = (truth[k] - estimate[k]) * factor
            axis.plot(time, error, label=name, color=COLOURS.get(name), linewidth=0.9)
        axis.set_yscale("symlog", linthresh=10.0)
        axis.yaxis.set_major_locator(FixedLocator([-1e9, -1e6, -1e3, 0.0, 1e3, 1e6, 1e9]))
        for edge in scan.setpoint.scan:
            axis.axvline(edge, color=figures.BLACK, linewidth=0.8)
        axis.set(title=mode, ylabel=unit)
    figures.label(axes, "time (s)")
    figures.legend_below(axes[1, 0], 4)
    return figure


def paint_statements(
    weights: np.ndarray,
    sweep: Sequence[Errors],
    kalman: Errors,
    regularised: Errors,
    shares: Mapping[str, np.ndarray],
    chosen: float,
):
    """Errors of the sensitivity-penalised filter over its weight, and the share of plants on which statements hold."""
    figure, (sizes, held) = figures.new(2, 1, height=4.6, sharex=True)
    rigid = [np.median(each.rms[:, 0] / kalman.rms[:, 0]) for each in sweep]
    sizes.loglog(weights, rigid, color=figures.BLACK, label="rigid body, over the Kalman filter's")
    flexible = [np.median(each.flexible()) for each in sweep]
    style = {"color": COLOURS["sensitivity penalised"], "label": "flexible states, over their size"}
    sizes.loglog(weights, flexible, **style)
    for name, each in (("regularised least squares", regularised), ("Kalman", kalman)):
        level = np.median(each.flexible())
        sizes.axhline(level, color=COLOURS[name], ls="--", linewidth=0.9, label=f"the same, {name}")
    sizes.set_ylabel("error (1, median)")
    sizes.legend(fontsize=7)
    for k, (claim, share) in enumerate(shares.items()):  # thinner and thinner: lines at 1 lie on each other
        held.semilogx(weights, share, linewidth=5 - 1.3 * k, label=SAID[claim])
    held.set(ylabel="share of the plants", xlabel="weight $\\gamma$")
    figures.legend_below(held, 2, fontsize=7)
    for axis in (sizes, held):
        axis.axvline(chosen, color=figures.BLACK, linewidth=0.8)
    return figure


def spreads(
    axis, rows: Sequence[str], samples: Sequence[np.ndarray], colour: str, label: str, offset: float = 0.0
):
    """Median and central 95 % of runs as a dot on a bar, one row each."""
    places = np.arange(len(rows)) + offset
    low, middle, high = (np.array([np.quantile(s, q) for s in samples]) for q in (0.025, 0.5, 0.975))
    ends = [middle - low, high - middle]
    axis.errorbar(middle, places, xerr=ends, fmt="o", color=colour, capsize=3, markersize=4, label=label)
    axis.set_yticks(np.arange(len(rows)), rows)


@lru_cache(maxsize=8)
def _contest(size_percent: float) -> tuple[Scan, Contest, Records]:
    """Scan, entrants and records for one size of the errors; they stay while the weight alone moves."""
    scan = published_scan()
    contest = prepare(scan, size_percent / 100, rigid=False)
    return scan, contest, sample_scans(scan, 6, 1, size_percent / 100, "ends", False)


def paint_weight(weight_exponent: float, size_percent: float):
    """Explorer: scan-phase errors of the published three as gamma and the size of the errors move."""
    scan, contest, records = _contest(size_percent)
    knobs = {"Kalman": 1.0, "sensitivity penalised": 10.0**weight_exponent}
    knobs["regularised least squares"] = size_percent / 100
    figure, axes = figures.new(1, 2, height=2.8, sharex=True)
    window = scan.setpoint.scanning
    for name, knob in knobs.items():
        error = records.states[0] - run_entrant(name, contest, knob, records)[0]
        for axis, state in zip(axes, (2, 4), strict=True):
            axis.plot(scan.setpoint.time[window], 1e9 * error[state, window], label=name, color=COLOURS[name])
            axis.set(title=STATES[state][0], xlabel="time (s)")
    axes[0].set_ylabel("estimation error (nm √kg)")
    axes[0].legend()
    return figure
