"""Pictures of runs: tracking, phase, errors over noise and frequency."""

import numpy as np

from experiments.fixedpoint.axes import (
    COLOURS,
    LINES,
    METRICS,
    NOMINAL,
    fill_range,
    legend_above,
    log_axis,
    points_with_intervals,
)
from experiments.fixedpoint.published import LITERAL
from stillwork.base.rounding import first_largest
from stillwork.control.controlled_run import ControlledRun
from stillwork.control.trajectory import Trajectory
from workbook import figures
from workbook.studies import Study


def paint_tracking(runs: dict[str, ControlledRun], quantity: str = "position"):
    """Nominal and true motion; the tracking error's range over the run; the error where the motion turns hardest."""
    name, unit = {"position": ("q", "m"), "velocity": ("q'", "m/s")}[quantity]
    figure, (motion, envelope, stretch) = figures.new(3, height=7.2)
    nominal = next(iter(runs.values())).trajectory
    sample_time = nominal.sample_time
    # Every 10 ms: coarser, the window's 40 Hz would show as a slow wander.
    coarse = slice(None, None, max(1, round(0.01 / sample_time)))
    motion.plot(nominal.time[coarse], getattr(nominal, quantity)[coarse], **NOMINAL)
    corner = hardest_turn(nominal)
    part = slice(max(0, round((corner - 0.15) / sample_time)), round((corner + 0.15) / sample_time))
    reach = 0.0
    for label, run in runs.items():
        style = {"color": COLOURS[label], "label": label}
        time, error = run.time, 1e3 * getattr(run, f"{quantity}_error")
        width, line = LINES[label]
        motion.plot(time[coarse], getattr(run, quantity)[coarse], line, linewidth=width, **style)
        # Narrow bands before wide ones; of the printed form the edge alone, which in noise lies on the other Kalman filter.
        band = {"zorder": 2 + 1 / (1 + np.nanmean(np.abs(error[time >= 2.0])))}
        if label == LITERAL:
            band = {"facecolor": "none", "alpha": 1.0, "zorder": 3.5}
        fill_range(envelope, time, error, max(1, round(0.06 / sample_time)), **style | band)
        stretch.plot(time[part], error[part], line, **style)
        reach = max(reach, 1.15 * np.nanmax(np.abs(error[time >= 2.0])))  # the start may be off by far more
    motion.set(xlabel="time (s)", ylabel=f"{name} ({unit})", title="motion")
    envelope.set(
        xlabel="time (s)",
        ylabel=f"error of {name} (m{unit})",
        title="error: smallest to largest in each 60 ms",
    )
    envelope.set(ylim=(-reach, reach), xlim=motion.get_xlim())
    stretch.set(xlabel="time (s)", ylabel=f"error of {name} (m{unit})", title="error at a corner")
    legend_above(motion)
    return figure


def hardest_turn(nominal: Trajectory) -> float:
    """Time of the largest nominal acceleration in the second half, s; the first of equals."""
    half = len(nominal.position) // 2
    size = np.abs(nominal.acceleration[half:])
    return float(nominal.time[half + first_largest(size, 1e-4)])


def paint_phase(runs: dict[str, ControlledRun]):
    """Phase trajectories, a column a filter: over the last five seconds, and where the coordinate is largest."""
    figure, panels = figures.new(2, len(runs), height=5.2, sharey="row", sharex="row")
    nominal = next(iter(runs.values())).trajectory
    first = max(0, len(nominal.position) - round(5.0 / nominal.sample_time))
    step = max(1, round(0.005 / nominal.sample_time))  # five points a cycle of 40 Hz
    near = np.flatnonzero(nominal.position[first:] > 0.97 * nominal.position.max())[::3] + first
    for row, part in zip(panels, (slice(first, None, step), near), strict=True):
        for axes, (label, run) in zip(row, runs.items(), strict=True):
            axes.plot(nominal.position[part], nominal.velocity[part], **NOMINAL)
            style = {"color": COLOURS[label], "label": label, "linewidth": 1.0}
            axes.plot(run.position[part], run.velocity[part], **style)
            axes.set_xlabel("q (m)")
    for axes, label in zip(panels[0], runs, strict=True):
        axes.set_title(label)
    panels[0, 0].set_ylabel("q' (m/s), the last 5 s")
    panels[1, 0].set_ylabel("q' (m/s), at a corner")
    figure.legend(handles=panels[0, 0].lines[:1], loc="outside upper center")
    return figure


def paint_errors_by_case(studies: dict[str, dict[str, Study]]):
    """Mean and 95 % interval of each filter's errors, one row of points a noise case."""
    figure, panels = figures.new(1, len(METRICS), height=0.55 * len(studies) + 1.5, sharey=True)
    names = list(next(iter(studies.values())))
    for axes, (quantity, (label, title, factor)) in zip(panels, METRICS.items(), strict=True):
        for number, name in enumerate(names):
            runs = [factor * study[name][quantity] for study in studies.values()]
            points_with_intervals(axes, runs, np.arange(len(runs)) + 0.12 * (number - 1.5), name)
        axes.set(xscale="log", xlabel=label, title=title)
        log_axis(axes.xaxis)
    panels[0].set_yticks(range(len(studies)), list(studies))
    panels[0].invert_yaxis()
    figure.legend(handles=panels[0].lines, loc="outside upper center", ncols=len(names))
    return figure


def paint_errors_over_frequency(
    frequencies_hz, studies: dict[str, list[dict[str, Study]]], label="trajectory frequency (Hz)"
):
    """RMS error of q against the trajectory's frequency, or what else `label` says, a panel per case; none where a run diverged."""
    error, _, factor = METRICS["position"]
    figure, [panels] = figures.new(1, len(studies), height=3.3, sharex=True, sharey=True, squeeze=False)
    for axes, (case, sweep) in zip(panels, studies.items(), strict=True):
        lost = False
        for name in sweep[0]:
            values = np.array([factor * study[name]["position"].mean() for study in sweep])
            values[np.isinf(values)] = np.nan
            axes.loglog(frequencies_hz, values, "o-", markersize=3, color=COLOURS[name], label=name)
            lost = lost or np.isnan(values).any()
        axes.set(xlabel=label, title=case)
        log_axis(axes.xaxis)
        log_axis(axes.yaxis)
        if lost:
            where = {"transform": axes.transAxes, "ha": "right", "fontsize": 8}
            axes.text(0.98, 0.03, "no point: a record diverged", **where)
    panels[0].set_ylabel(error)
    legend_above(panels[0])
    return figure
