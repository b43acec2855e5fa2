"""Figures of the response to a change of the floor (Fig. 6)."""

from collections.abc import Callable, Mapping

import numpy as np

from experiments.isolation.algorithm_styles import COLORS, STYLES
from experiments.isolation.convergence import ALGORITHMS
from experiments.isolation.mean_convergence import mean_course
from experiments.isolation.tracking import GROUPS, SHARE, Response, Switch
from experiments.isolation.twin import Twin
from workbook import figures
from workbook.studies import Study

# of each power of the integrator, the largest shift
SHOWN = {1: figures.BLUE, 5: figures.GREEN, 7: figures.RED}
MILLI = 1e3


def paint_switches(panels: Mapping[str, Mapping[str, Response]]):
    """Fig. 6: weights around a switch of the floor, as distances from their optimum before it."""
    figure, axes = figures.new(len(panels), 1, height=2.9 * len(panels), sharex=True, squeeze=False)
    for panel, (title, responses) in zip(axes[:, 0], panels.items(), strict=True):
        for name, response in responses.items():
            start = response.switch.start.weights[0]
            for row, color in SHOWN.items():
                way = MILLI * (response.weights[:, row] - start[row])
                label = f"w{row + 1}, {name}"
                panel.plot(response.time_s, way, STYLES[name], color=color, lw=1.0, label=label)
        for row, color in SHOWN.items():
            after = response.time_s > 0
            level = np.full(after.sum(), MILLI * response.switch.shift[row])
            panel.plot(response.time_s[after], level, ":", color=color, label=f"w{row + 1}, new optimum")
        panel.axvline(0, color=figures.BLACK, lw=0.8)
        panel.set_title(title)
    figures.label(axes, "time after the switch (s)", "w − optimum before\n(10⁻³ N per m/s²)")
    figures.legend_below(axes[0, 0], 3)
    return figure


def paint_settling(
    studies: Mapping[str, Study], expected: Mapping[str, Mapping[str, Response]], duration_s: float
):
    """Settling times of all weights and of each group: run by run, and of the noise-free mean course.

    A run that has not settled at its end `duration_s` is a triangle there: its time is longer, or endless.
    """
    figure, axes = figures.new(1, len(studies), height=3.6, sharey=True, squeeze=False)
    at = np.arange(len(GROUPS))
    for panel, (title, study) in zip(axes[0], studies.items(), strict=True):
        for shift, name in zip((-0.15, 0.15), ALGORITHMS, strict=True):
            color = COLORS[name]
            times = np.array([study[f"{name} {group}"] for group in GROUPS]).ravel()
            places = np.repeat(at + shift, study.runs)
            ended = np.isfinite(times)
            panel.plot(places[ended], times[ended], "o", ms=3, color=color, alpha=0.6, label=f"{name}, runs")
            if not ended.all():
                # Side by side, or several would look like one.
                spread = places[~ended] + 0.04 * (np.arange(np.sum(~ended)) % 3 - 1)
                ends, label = np.full(len(spread), duration_s), f"{name}, not settled in {duration_s:g} s"
                panel.plot(spread, ends, "^", ms=5, color=color, mfc="none", label=label)
            means = [expected[title][name].settling_s(group) for group in GROUPS]
            panel.plot(at + shift, means, "_", ms=12, mew=2, color=color, label=f"{name}, mean course")
        panel.set_yscale("log")
        panel.set_xticks(at, list(GROUPS))
        panel.set_title(title)
    figures.label(axes, "weights", f"time to stay within {SHARE:.0%}\nof the shift (s)")
    # Of all panels, for an algorithm may leave runs unsettled in one of them only.
    entries = [panel.get_legend_handles_labels() for panel in axes[0]]
    named = {name: handle for handles, names in entries for handle, name in zip(handles, names, strict=True)}
    figure.legend(named.values(), named.keys(), loc="outside lower center", ncols=2)
    return figure


def expected_switch_painter(twin: Twin, switches: Mapping[str, Switch], duration_s: float) -> Callable:
    """Explorer: expected share of the shift still to go, all weights."""
    time = np.linspace(duration_s / 60, duration_s, 60)

    def paint(direction: str, step_size: float, memory_s: float):
        switch = switches[direction]
        figure, axes = figures.new(1, 1, height=3.2)
        for name in ALGORITHMS:
            moved = {"step_size": step_size, "memory_s": memory_s, "start": switch.start}
            left = Response(time, mean_course(twin, switch.end, name, time, **moved), switch).left()
            style = {"color": COLORS[name], "label": name}
            axes.plot(np.append(0.0, time), np.append(1.0, left), STYLES[name], **style)
        axes.axhline(SHARE, color=figures.GREY, lw=0.8)
        axes.set(xlabel="time after the switch (s)", ylabel="share of the shift to go")
        axes.legend()
        return figure

    return paint
