"""Tracking errors over the places of the sensor, Table 4.1 and its figures (notebook 16)."""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from experiments.motion.designs import Design
from experiments.motion.ideal_feedforward import Force
from experiments.motion.legends import case_styles
from experiments.motion.location_study import LocationStudy, location_loops, stage_error, study_locations
from experiments.motion.machines import published_setpoint, stage, stage_mass
from experiments.motion.magnitudes import plain_numbers
from experiments.motion.position_dependence import stage_grid
from experiments.motion.scan_errors import paint_errors
from stillwork.control.applications import Application
from stillwork.control.pid import PidFamily
from stillwork.control.setpoint import Setpoint
from workbook import figures


def paint_location_errors(study: LocationStudy, panels: Mapping[str, str]):
    """Tracking errors at all places, a panel a case: the band they fill in half a millisecond, and three of them (Figs 4.10, 4.11)."""
    figure, axes = figures.new(2, 2, height=4.6, sharex=True, sharey=True)
    time = study.setpoint.time
    pixel = max(round(5e-4 / study.setpoint.sample_time), 1)  # samples of one
    starts = np.arange(0, len(time), pixel)
    for axis, (title, case) in zip(axes.ravel(), panels.items(), strict=True):
        errors, size = 1e9 * study.errors[case], study.rms(case)
        band = (each.reduceat(each.reduce(errors, axis=0), starts) for each in (np.minimum, np.maximum))
        axis.fill_between(time[starts], *band, color=figures.GREY, alpha=0.35, linewidth=0)
        order = np.argsort(size)
        chosen = {"largest": order[-1], "middle": order[len(order) // 2], "smallest": order[0]}
        for (name, k), colour in zip(chosen.items(), (figures.RED, figures.BLUE, figures.GREEN), strict=True):
            axis.plot(time, errors[k], color=colour, linewidth=0.5, label=f"{name} rms")
        for edge in (study.setpoint.acceleration_end, study.setpoint.scan[1]):
            axis.axvline(edge, color=figures.BLACK, linewidth=0.8)
        axis.set_title(f"{title}: {1e9 * size.min():.1f} to {1e9 * size.max():.1f} nm rms")
    figures.legend_below(axes[0, 0], 3, fontsize=7)
    figures.label(axes, "time (s)", "error (nm)")
    return figure


def paint_rms_along(study: LocationStudy, cases: Sequence[str]):
    """Rms error in the scan over the place; dashed with a redesigned controller."""
    figure, axis = figures.new(1, 1, height=3.2)
    styles = case_styles(cases)
    for case in cases:
        axis.semilogy(study.places, 1e9 * study.rms(case), label=case, linewidth=1.2, **styles.get(case, {}))
    axis.set(xlabel="place of the sensor (m)", ylabel="rms error in the scan (nm)")
    plain_numbers(axis.yaxis)
    axis.legend(ncols=3, fontsize=7, loc="upper center")
    return figure


def paint_table_of_ranges(
    names: Sequence[str],
    whole: Mapping[str, np.ndarray],
    spread: Mapping[str, np.ndarray],
    published: Mapping[str, ArrayLike],
):
    """Smallest, mean and largest rms error (nm) of every case, their spread over the ranges, and the published values."""
    figure, axis = figures.new(1, 1, height=3.4)
    parts = (("smallest", -0.22, figures.GREEN), ("mean", 0.0, figures.BLUE), ("largest", 0.22, figures.RED))
    for k, (part, offset, colour) in enumerate(parts):
        place = np.arange(len(names)) + offset
        low, high = (np.array([f(spread[n][:, k]) for n in names]) for f in (np.min, np.max))
        middle = np.array([whole[n][k] for n in names])
        axis.vlines(place, low, high, color=colour, linewidth=4, alpha=0.4, label=f"{part}, over the ranges")
        axis.plot(place, middle, "_", color=colour, markersize=9, label=f"{part}, whole structure")
        marks = [np.asarray(published[n])[k] for n in names]
        figures.mark_published(axis, place, marks, label="published" if k == 0 else None)
    axis.set_yscale("log")
    axis.set_xticks(np.arange(len(names)), [n.replace(", ", ",\n") for n in names], fontsize=7)
    axis.set(ylabel="rms error in the scan (nm)", ylim=(0.3, None))
    axis.legend(ncols=3, fontsize=7, loc="lower left")
    return figure


@cache
def _explored() -> tuple[Setpoint, Force]:
    setpoint = published_setpoint(2e-4)
    return setpoint, stage_error(setpoint, PidFamily(stage_mass())(35.6))


def paint_location(place: float, damping: float, compensate: str, bandwidth_hz: float):
    """Explorer: the tracking error at one place under the feedforward error, bare and with an observer."""
    setpoint, force = _explored()
    controller = PidFamily(stage_mass())(bandwidth_hz)
    cases = {"no observer": (Design(), controller)}
    if damping or compensate == "yes":
        application = Application(compensate == "yes", damping, selectivity=2.0 if damping else None)
        cases["observer"] = (Design(application, 0.03), controller)
    study = study_locations(location_loops(stage(), stage_grid(), [place], cases), force, setpoint)
    labels = {name: f"{name}: {1e9 * study.rms(name)[0]:.2f} nm rms in the scan" for name in cases}
    return paint_errors(setpoint, {labels[name]: study.errors[name][0] for name in cases})
