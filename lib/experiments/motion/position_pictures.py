"""Figures of the position-dependent observers (section 4.2), one line a place, coloured along the structure."""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from experiments.motion.designs import Design
from experiments.motion.ideal_feedforward import Force
from experiments.motion.location_study import LocationStudy, location_loops, stage_error, study_locations
from experiments.motion.machines import published_setpoint, stage, stage_mass
from experiments.motion.performance import paint_errors
from experiments.motion.pictures import (
    LABELS,
    add_magnitude,
    case_styles,
    mark_limit,
    paint_limited,
    paint_magnitudes,
    plain,
    plain_numbers,
)
from experiments.motion.position_dependence import place_loops, stage_grid
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Loop
from stillwork.control.pid import Pid, PidFamily
from stillwork.control.setpoint import Setpoint
from stillwork.lti.peaks import resonance_grid
from stillwork.workbook import figures


def colours(count: int) -> list[str]:
    """Colours from dark to light along the structure."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colormaps["viridis"](0.92 * k / max(count - 1, 1))) for k in range(count)]


def _along(loops: Mapping[float, Loop], low_hz: float, high_hz: float):
    """One grid for all places, dense at the poles of plants and compensators, and each loop's label and line."""
    each = list(loops.values())
    poles = np.concatenate([each[0].plant.poles, *(loop.compensator.poles for loop in each[::3])])
    styles = [{"color": colour, "linewidth": 1.0} for colour in colours(len(loops))]
    lines = zip([f"{place:g} m" for place in loops], each, styles, strict=True)
    return resonance_grid(poles, low_hz, high_hz, 250, 6), list(lines)


def paint_sensitivities(
    loops: Mapping[float, Loop],
    controllers: Mapping[str, Pid],
    functions: Sequence[str] = ("input_sensitivity", "output_sensitivity"),
):
    """Loop functions, a row a controller (by the name in the title), a line a place (m), and the allowed 6 dB."""
    omega, lines = _along(loops, 10.0, 2e3)
    panels = {
        f"{LABELS[function]}{name}": {
            label: (omega, getattr(loop.at(controller, omega), function), style)
            for label, loop, style in lines
        }
        for name, controller in controllers.items()
        for function in functions
    }
    rows = len(controllers)
    return paint_limited(panels, -15, 12, 3.4 if rows == 1 else 5.2, rows)


def paint_equivalent_controllers(loops: Mapping[float, Loop], controller: Pid):
    """Equivalent controllers from r and from y to the plant input, a line a place (m), beside the controller."""
    omega, lines = _along(loops, 1.0, 3e3)
    broad = {"color": figures.GREY, "linewidth": 2.5}
    panels = {
        title: {"controller": (omega, controller.frequency_response(omega), broad)}
        | {label: (omega, getattr(loop.at(controller, omega), name), style) for label, loop, style in lines}
        for title, name in (
            ("reference $r$ to force $f$", "reference_controller"),
            ("position $y$ to force $f$", "output_controller"),
        )
    }
    figure, axes = paint_magnitudes(panels, "magnitude (dB re 1 N/m)", height=3.4, sharey=True)
    axes[0, 0].legend(ncols=2, fontsize=7)
    return figure


def paint_observers(loops: Mapping[float, Loop]):
    """Observers from u and from y to the damping force and to the estimated deformation, a line a place (Fig. 4.2)."""
    omega, lines = _along(loops, 1.0, 3e3)
    found = [(label, loop.compensator.frequency_response(omega), style) for label, loop, style in lines]
    units = {
        "$u$ to $u_d$": "N/N",
        "$y$ to $u_d$": "N/m",
        r"$u$ to $\hat y_{flex}$": "m/N",
        r"$y$ to $\hat y_{flex}$": "m/m",
    }
    panels = {
        title: {label: (omega, response[divmod(k, 2)], style) for label, response, style in found}
        for k, title in enumerate(units)
    }
    figure, axes = paint_magnitudes(panels, rows=2, height=5.0, sharex=True)
    for axis, unit in zip(axes.ravel(), units.values(), strict=True):
        axis.set_ylabel(f"magnitude (dB re 1 {unit})")
    axes[0, 0].legend(ncols=2, fontsize=7)
    return figure


def paint_location_errors(study: LocationStudy, panels: Mapping[str, str]):
    """Tracking errors at all places, a panel a case: the band they fill in half a millisecond, and three of them (Figs 4.10, 4.11)."""
    figure, axes = figures.new(2, 2, height=4.6, sharex=True, sharey=True)
    time = study.setpoint.time
    pixel = max(round(5e-4 / study.setpoint.sample_time), 1)
    starts = np.arange(0, len(time), pixel)
    for axis, (title, case) in zip(axes.ravel(), panels.items(), strict=True):
        errors, size = 1e9 * study.errors[case], study.rms(case)
        low, high = (
            extreme.reduceat(extreme.reduce(errors, axis=0), starts) for extreme in (np.minimum, np.maximum)
        )
        axis.fill_between(time[starts], low, high, color=figures.GREY, alpha=0.35, linewidth=0)
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


def paint_place(place: float, damping: float, compensate: str, noise_exponent: float, bandwidth_hz: float):
    """Explorer: equivalent controller and output sensitivity with the sensor at one place of the stage."""
    from matplotlib.ticker import NullLocator

    application = Application(compensate == "yes", damping)
    design = Design(application if damping or compensate == "yes" else None, 10.0**noise_exponent)
    plant = stage()
    loop = place_loops(plant, stage_grid(), [place], design, points=150, around=6)[0]
    controller = PidFamily(stage_mass())(bandwidth_hz)
    shown = (loop.omega > 2 * np.pi * 5) & (loop.omega < 2 * np.pi * 3e3)
    omega = loop.omega[shown]
    response = loop.at(controller, omega)
    margins = {"left": 0.09, "bottom": 0.16, "right": 0.985, "top": 0.91, "wspace": 0.2}
    figure, (left, right) = plain(2, 3.0, **margins)
    original = controller.frequency_response(omega)
    add_magnitude(left, omega, original, color=figures.GREY, linewidth=2.5, label="controller")
    add_magnitude(left, omega, response.output_controller, label="equivalent, $y$ to $f$")
    add_magnitude(right, omega, response.input_sensitivity, label="input sensitivity")
    add_magnitude(right, omega, response.output_sensitivity, label="output sensitivity")
    mark_limit(right)
    right.set(ylim=(-20, 15), title="stable" if np.all(loop.poles(controller).real < 0) else "unstable")
    for axis, unit in ((left, "dB re 1 N/m"), (right, "dB")):
        axis.set(xlabel="frequency (Hz)", ylabel=f"magnitude ({unit})")
        axis.xaxis.set_minor_locator(NullLocator())
        axis.legend(fontsize=7)
    return figure


@cache
def _explored() -> tuple[Setpoint, Force]:
    setpoint = published_setpoint(2e-4)
    return setpoint, stage_error(setpoint, PidFamily(stage_mass())(35.6))


def paint_location(place: float, damping: float, compensate: str, bandwidth_hz: float):
    """Explorer: the tracking error at one place under the feedforward error, bare and with an observer."""
    setpoint, force = _explored()
    controller = PidFamily(stage_mass())(bandwidth_hz)
    application = Application(compensate == "yes", damping, selectivity=2.0 if damping else None)
    used = damping > 0 or compensate == "yes"
    cases = {"no observer": (Design(), controller)}
    if used:
        cases["observer"] = (Design(application, 0.03), controller)
    study = study_locations(location_loops(stage(), stage_grid(), [place], cases), force, setpoint)
    labels = {name: f"{name}: {1e9 * study.rms(name)[0]:.2f} nm rms in the scan" for name in cases}
    return paint_errors(setpoint, {labels[name]: study.errors[name][0] for name in cases})
