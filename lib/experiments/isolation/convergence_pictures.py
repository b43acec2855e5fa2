"""Figures of the initial convergence: Fig. 5, Table 1, readings of the text, stability of the mean."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import ArrayLike

from experiments.isolation.algorithm_styles import COLORS, STYLES
from experiments.isolation.convergence import ALGORITHMS, Course, Starts
from experiments.isolation.floors import ShapedFloor
from experiments.isolation.mean_convergence import Sideways, mean_course
from experiments.isolation.responses import responses
from experiments.isolation.steady import Steady, steady_state
from experiments.isolation.twin import Twin
from stillwork.base.rounding import in_order
from workbook import figures
from workbook.claims import load_entries
from workbook.studies import Study, spread_interval

SHOWN = {0: figures.BLUE, 3: figures.GREEN, 6: figures.RED}  # w1, w4, w7: the colours of Fig. 5


def published_row(algorithm: str, quantity: str) -> np.ndarray:
    """Row of Table 1 from the ledger: ``tau`` or ``final`` of ``FeLMS`` or ``FeRLS``, nine values."""
    entries = load_entries("isolation")
    return np.array(
        [entries[f"isolation.table-1.{algorithm.lower()}.{quantity}-w{i}"].published for i in range(1, 10)]
    )


def paint_courses(courses: Mapping[str, Course]):
    """Fig. 5: quadratic filtered error and w1, w4, w7 over time, for each algorithm."""
    figure, (above, below) = figures.new(2, 1, height=5.2, sharex=True, height_ratios=[1, 1.6])
    for name, course in courses.items():
        width = max(round(1 / course.time_s[0]), 1)
        rows = len(course.time_s) // width * width
        power = course.error_power[:rows].reshape(-1, width).mean(axis=1)
        time = course.time_s[width - 1 : rows : width]
        color = COLORS[name]
        above.semilogy(time, power, STYLES[name], color=color, label=f"{name}, mean over 1 s")
        for row, color in SHOWN.items():
            label = f"w{row + 1}, {name}"
            below.plot(course.time_s, course.weights[:, row], STYLES[name], color=color, label=label)
        ends = np.full(len(SHOWN), course.time_s[-1] * (1.02 if name == "FeLMS" else 1.04))
        style = {"label": f"published, {name}"} | ({"marker": "s"} if name == "FeLMS" else {})
        figures.mark_published(below, ends, published_row(name, "final")[list(SHOWN)], **style)
    above.set_ylabel("filtered error e'e (N²)")
    above.legend()
    below.set(xlabel="time (s)", ylabel="parameter (N per m/s²)")
    figures.legend_below(below, 4)
    return figure


def paint_table(studies: Mapping[str, Study]):
    """Table 1: time constants above, final values below, FeLMS left, FeRLS right, with intervals over seeds."""
    figure, axes = figures.new(2, 2, height=5.4, sharex=True)
    number = np.arange(1, 10)
    colors = (figures.BLUE, figures.ORANGE)
    for row, (quantity, label) in enumerate(
        (("tau", "time to stay within 63 % (s)"), ("final", "final value (N per m/s²)"))
    ):
        for column, algorithm in enumerate(ALGORITHMS):
            panel = axes[row, column]
            for shift, ((name, study), color) in enumerate(zip(studies.items(), colors, strict=False)):
                middle, low, high = run_interval(study, algorithm, quantity)
                at = number + 0.22 * (shift - 0.5)
                panel.vlines(at, low, high, color=color, lw=3, alpha=0.5, label=f"{name}, 95 % of runs")
                panel.plot(at, middle, "o", ms=3, color=color, label=f"{name}, mean of {study.runs} runs")
            figures.mark_published(panel, number, published_row(algorithm, quantity))
            panel.set_title(algorithm if row == 0 else "")
            panel.set_xticks(number, [f"w{i}" for i in number])
            if row == 0:
                panel.set_yscale("log")
        figures.label(axes[row], y=label)
        # One scale a row: the point is the comparison.
        limits = [panel.get_ylim() for panel in axes[row]]
        for panel in axes[row]:
            panel.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
    for panel in axes[0]:
        panel.set_ylim(0.3, 500)  # the intervals of w1 go further
    figures.label(axes, "parameter")
    axes[1, 1].legend(fontsize=7)
    return figure


def run_interval(study: Study, algorithm: str, quantity: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean over the runs and the 95 % interval of one run, per parameter; time constants on a log scale."""
    values = study[f"{algorithm} {quantity}"]
    if quantity == "tau":
        values = np.log(values)
    found = values.mean(axis=0), *np.array([spread_interval(column) for column in values.T]).T
    return tuple(np.exp(each) for each in found) if quantity == "tau" else found


def paint_readings(times: Mapping[str, np.ndarray]):
    """Time constants of w4 to w9 on the mean course under different readings, with the published ones."""
    figure, axes = figures.new(1, 2, height=3.4)
    number = np.arange(4, 10)
    looks = ((figures.BLUE, "o"), (figures.ORANGE, "s"), (figures.PURPLE, "^"))
    for panel, algorithm in zip(axes, ALGORITHMS, strict=True):
        mine = {name: each for name, each in times.items() if name.startswith(algorithm)}
        for (name, each), (color, marker) in zip(mine.items(), looks, strict=True):
            label = name.removeprefix(f"{algorithm}, ")
            panel.plot(number, each[3:], marker, color=color, mfc="none", label=label)
        figures.mark_published(panel, number, published_row(algorithm, "tau")[3:])
        panel.set(title=algorithm, yscale="log")
        panel.set_ylim(top=6 * max(each[3:].max() for each in mine.values()))
        panel.set_xticks(number, [f"w{i}" for i in number])
        panel.legend(loc="upper left", fontsize=8)
    figures.label(axes, "parameter", "time to stay within 63 % (s)")
    return figure


def paint_starts(starts: Starts, steady: ArrayLike):
    """Largest command in the first seconds against the start P(-1) = I / epsilon."""
    figure, axes = figures.new(1, 1, height=2.8)
    on = np.isnan(starts.stopped_s)
    axes.loglog(1 / starts.epsilon[on], starts.peak_command[on], "o", color=figures.BLUE, label="goes on")
    axes.loglog(1 / starts.epsilon[~on], starts.peak_command[~on], "x", color=figures.RED, label="diverges")
    style = {"label": "printed: ε = 10⁻⁵", "markersize": 9}
    figures.mark_published(axes, 1e5, starts.peak_command[~on].max() if (~on).any() else 1.0, **style)
    axes.axvspan(np.min(steady), np.max(steady), color=figures.GREEN, alpha=0.3, label="steady diagonal of P")
    axes.set(xlabel="initial covariance 1/ε", ylabel="largest command (N)")
    axes.legend()
    return figure


def paint_path_error(twin: Twin, floor: ShapedFloor):
    """Loci of P2hat^-1 P2 and the convergence rates on a floor, for the diagonal and the full estimate."""
    figure, (left, right) = figures.new(1, 2, height=3.4)
    f = np.geomspace(2, 300, 400)
    for estimate, color, marker in (("diagonal", figures.BLUE, "o"), ("full", figures.ORANGE, "s")):
        variant, style = twin.varied(estimate=estimate), {"color": color, "label": f"{estimate} estimate"}
        loci = in_order(np.linalg.eigvals(responses(variant, f).path_error))
        left.plot(loci.real.ravel(), loci.imag.ravel(), ".", ms=2, **style)
        rates = in_order(steady_state(variant, floor, noise=False).rls_eigenvalues)
        right.plot(rates.real, rates.imag, marker, ms=4, mfc="none", **style)
    for axes in (left, right):
        axes.axvline(0, color=figures.BLACK, lw=0.8)
        axes.plot(1, 0, "+", markersize=9, color=figures.RED, label="perfect estimate")
        axes.set_xlabel("real part")
    left.set(title="eigenvalues of P̂₂⁻¹P₂, 2-300 Hz", ylabel="imaginary part")
    right.set_title("eigenvalues of R⁻¹A: convergence")
    figures.legend_below(right, 3)
    return figure


def paint_sideways(courses: Mapping[str, Sideways]):
    """Size of a sideways weight error over time, simulated and as the mean update predicts it."""
    figure, axes = figures.new(1, 1, height=3.0)
    for (name, course), color in zip(courses.items(), (figures.BLUE, figures.RED), strict=False):
        axes.semilogy(course.time_s, course.size / course.size[0], color=color, label=name)
        style = {"color": figures.BLACK, "label": f"{name}, predicted"}
        axes.semilogy(course.time_s, course.predicted / course.size[0], ":", **style)
    axes.set(xlabel="time (s)", ylabel="sideways command over its start")
    axes.legend()
    return figure


def expected_course_painter(twin: Twin, steady: Steady, duration_s: float) -> Callable:
    """Explorer: expected w1, w4, w7 for a step size, a memory and a start."""
    time = np.linspace(duration_s / 60, duration_s, 60)

    def paint(step_size: float, memory_s: float, initial_covariance: float):
        figure, axes = figures.new(1, 1, height=3.6)
        for name in ALGORITHMS:
            moved = {"step_size": step_size, "memory_s": memory_s, "initial_covariance": initial_covariance}
            expected = mean_course(twin, steady, name, time, **moved)
            for row, color in SHOWN.items():
                axes.plot(time, expected[:, row], STYLES[name], color=color, label=f"w{row + 1}, {name}")
        final = published_row("FeRLS", "final")[list(SHOWN)]
        figures.mark_published(axes, np.full(3, duration_s * 1.02), final, "published, FeRLS")
        axes.set(xlabel="time (s)", ylabel="expected parameter (N per m/s²)")
        axes.legend(ncols=2)
        return figure

    return paint
