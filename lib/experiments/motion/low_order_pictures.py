"""Figures of the low-order feedforward."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from experiments.motion.designs import DESIGNS, stage_bandwidth, stage_compensator
from experiments.motion.low_order import LowOrder, copy_poles, direct_loop, pick_poles
from experiments.motion.machines import published_setpoint, stage, stage_mass
from experiments.motion.performance_pictures import paint_errors
from experiments.motion.pictures import CASES
from stillwork.control.feedforward import modified_feedforward
from stillwork.control.loops import closed_loop
from stillwork.control.pid import PidFamily
from stillwork.signals.moving_average import rms
from stillwork.workbook import figures


def paint_errors_over_order(
    low: Mapping[str, Sequence[tuple[int, float]]],
    copies: Mapping[str, tuple[int, float]],
    published: Mapping[str, float],
    noise: Mapping[str, float],
):
    """Rms error in the scan over the number of states of the feedforward, one panel a design.

    Points are (states, rms in m), of low-order feedforwards and of the observer copy, without noise (dashed) and with
    what `noise` alone makes (m); published is Table 3.7 (nm), with noise.
    """
    figure, axes = figures.new(1, len(low), height=3.0, sharey=True, squeeze=False)
    for axis, (name, points) in zip(axes[0], low.items(), strict=True):
        states, errors = np.array(points).T
        order, copied = copies[name]
        for alone, label, hollow in ((noise[name], "with noise", False), (0.0, "without", True)):
            line, face = "--" if hollow else "-", "none" if hollow else None
            axis.semilogy(
                states,
                1e9 * np.hypot(errors, alone),
                f"o{line}",
                color=CASES[name],
                markerfacecolor=face,
                label=f"low order, {label}",
            )
            axis.semilogy(
                [order],
                [1e9 * np.hypot(copied, alone)],
                "s",
                color=figures.BLACK,
                markerfacecolor=face,
                label=f"observer copy, {label}",
            )
        figures.mark_published(axis, copies[name][0], published[name], "published, with noise")
        axis.xaxis.get_major_locator().set_params(integer=True)
        axis.set(title=f"{name}, redesigned", xlabel="states of the feedforward (1)")
    axes[0, 0].set_ylabel("rms error in the scan (nm)")
    figures.legend_below(axes[0, 0], 3)
    return figure


def paint_errors_over_plants(studies: Mapping[str, Mapping[str, np.ndarray]]):
    """Rms errors of MC and AD over perturbed plants, kept gains beside gains tuned again; one panel a size of the errors."""
    from matplotlib.ticker import FixedLocator, NullFormatter, ScalarFormatter

    figure, axes = figures.new(1, len(studies), height=3.4, sharex=True, sharey=True, squeeze=False)
    for axis, (title, study) in zip(axes[0], studies.items(), strict=True):
        names = list(dict.fromkeys(key.rpartition(",")[0] for key in study))
        for offset, how, fill in ((0.12, "kept", "white"), (-0.12, "tuned", CASES["MC and AD"])):
            values = [1e9 * np.asarray(study[f"{name}, {how}"]) for name in names]
            low, middle, high = (np.array([np.quantile(v, q) for v in values]) for q in (0.025, 0.5, 0.975))
            rows = np.arange(len(names))[::-1] + offset
            axis.errorbar(
                middle,
                rows,
                xerr=[middle - low, high - middle],
                fmt="o",
                markersize=4,
                markerfacecolor=fill,
                capsize=3,
                color=CASES["MC and AD"],
                label="gains of the nominal plant" if how == "kept" else "gains tuned on each plant",
            )
        axis.set_yticks(np.arange(len(names))[::-1], names)
        axis.set_xscale("log")
        axis.xaxis.set_major_locator(FixedLocator([0.5, 1, 2, 5, 10, 20, 50]))
        axis.xaxis.set_major_formatter(ScalarFormatter())
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set(title=title, xlabel="rms error in the scan (nm)")
    figures.legend_below(axes[0, 0], 2)
    return figure


@cache
def _prepared(name: str) -> tuple[object, list[LowOrder]]:
    """The redesigned loop of mass 5 and its low-order feedforwards."""
    setpoint, block = published_setpoint(), stage_compensator(5, DESIGNS[name])
    controller = PidFamily(stage_mass())(stage_bandwidth(name).design_hz).state_space()
    loop = direct_loop(closed_loop(stage().at([0], [4]), block, controller))
    return loop, pick_poles(loop, setpoint, copy_poles(modified_feedforward(block, controller)), 8)


def paint_low_order(design: str, states: int, gain: float):
    """Explorer: error over the move for a feedforward of so many states, its filters' gains scaled by `gain` %."""
    loop, found = _prepared(design)
    chosen = [each for each in found if each.order <= states][-1]
    chosen = replace(chosen, weights=tuple(gain / 100 * w for w in chosen.weights))
    setpoint = published_setpoint()
    error = chosen.error(loop, setpoint)
    size = 1e9 * rms(error[setpoint.scanning])
    title = f"{chosen.order} states: {size:.2f} nm rms in the scan (grey)"
    return paint_errors(setpoint, {"error": error}, title)
