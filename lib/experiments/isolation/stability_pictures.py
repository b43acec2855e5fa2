"""Figures of numerical stability (notebook 07)."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from experiments.isolation.cures import CureRun
from experiments.isolation.simulation import Run
from experiments.isolation.stability import CovarianceRun, condition_bounds, covariance_run
from workbook import figures
from workbook.palette import COLOURS

_LINES = ("-", "--", "-", ":", "-.", "--", "-")
EXPLORED = ("one product", "both products", "triangle", "Joseph", "UD")
FLOOR = 1e-19  # where exact zeros are drawn; the axis says so


def paint_map(
    conditions: ArrayLike,
    found: Mapping[tuple[str, str], np.ndarray],
    shipped: Mapping[str, tuple[float, Mapping[str, CovarianceRun]]],
    forgettings: tuple[float, float],
):
    """Error of P in its own metric over the condition number, drawn at one where it is larger, and where forms break.

    `found` by precision and form is what `stability_map` gives, `shipped` by floor a condition number and the runs in
    float32 by form; the forgetting factors are those of the synthetic regressors and of the shipped floors.
    """
    precisions = list(dict.fromkeys(precision for precision, _ in found))
    figure, grid = figures.new(1, len(precisions), height=3.9, sharey=True, squeeze=False)
    for axes, precision in zip(grid[0], precisions, strict=True):
        lost, place = [], 0
        for (of, form), (distance, breakdown) in found.items():
            if of != precision:
                continue
            held = np.all(np.isinf(breakdown), axis=1)
            low, high = distance.min(axis=1), distance.max(axis=1)
            middle = np.median(distance, axis=1)
            style = {"color": f"C{place}", "ls": _LINES[place], "capsize": 2, "label": form}
            axes.errorbar(conditions, middle, (middle - low, high - middle), **style)
            lost += list(zip(np.asarray(conditions)[~held], middle[~held], strict=True))
            place += 1
        if lost:
            style = {"color": figures.BLACK, "ms": 7, "mew": 1.5, "label": "P lost definiteness"}
            axes.plot(*np.transpose(lost), "x", **style)
        if precision == "float32":
            for mark, (name, (condition, runs)) in zip("osD", shipped.items(), strict=False):
                values = [run.worst for run in runs.values()]
                axes.plot(np.full(len(values), condition), values, mark, color=figures.GREY, label=name)
        certain, mean = condition_bounds(forgettings[0], precision)
        for bound, line, text in ((certain, ":", "errors of one sign "), (mean, "--", "independent errors ")):
            axes.axvline(bound, color=figures.BLACK, lw=0.8, ls=line)
            axes.annotate(text, (bound, 1e-13), rotation=90, ha="right", va="bottom", fontsize=7)
        axes.axhline(1.0, color=figures.GREY, lw=0.8)
        axes.set(xscale="log", yscale="log", title=precision, ylim=(1e-13, 10))
        axes.set(xlabel="condition number of the scaled regressors")
    grid[0, 0].set(ylabel="largest relative error of P, in its own metric")
    figures.legend_below(grid[0, 0], 4)
    return figure


def paint_forms(runs: Mapping[str, Mapping[str, CovarianceRun]], experiment: float):
    """Asymmetry and error of P over time constants, by precision and form; `experiment` is the published length."""
    figure, grid = figures.new(2, len(runs), height=5.4, sharex=True, squeeze=False)
    for (upper, lower), (precision, forms) in zip(grid.T, runs.items(), strict=True):
        for style, (form, run) in zip(_LINES, forms.items(), strict=False):
            t = run.time_constants
            upper.semilogy(t, np.maximum(run.asymmetry, FLOOR), style, label=form)
            lower.semilogy(t, run.error, style, label=form)
            if np.isfinite(run.breakdown):
                for axes in (upper, lower):
                    axes.axvline(run.breakdown, color=figures.GREY, lw=0.8, ls=":")
                # Towards the wider side of the line, or the words would leave the frame.
                side = "left" if run.breakdown < t[-1] / 2 else "right"
                look = {"fontsize": 8, "ha": side, "va": "bottom", "color": figures.GREY}
                text = f" indefinite at about {run.breakdown_tens():.0f} "
                lower.annotate(text, (run.breakdown, 1e-13), **look)
        unit = np.finfo(precision).eps
        guide = np.array([0.0, np.log(1 / unit)])
        style = {"color": figures.BLACK, "lw": 0.8, "label": "slope 1/λ a sample"}
        upper.semilogy(guide, unit / 10 * np.exp(guide), **style)
        for axes in (upper, lower):
            axes.axvspan(0, experiment, color=figures.GREY, alpha=0.12, lw=0)
        upper.set(title=precision, ylabel="antisymmetric part of P", ylim=(FLOOR / 3, 10))
        _name_zero(upper)
        lower.set(xlabel="time constants of the forgetting", ylabel="error of P", ylim=(1e-14, 1e3))
        upper.set_yticks(10.0 ** np.arange(-18, 4, 3))
        lower.set_yticks(10.0 ** np.arange(-12, 4, 3))
    style = {"ha": "center", "va": "top", "fontsize": 8, "color": figures.GREY}
    grid[0, 0].annotate("the paper's 200 s", (experiment / 2, 5.0), **style)
    figures.legend_below(grid[0, 0], 3)
    return figure


def _name_zero(axes):
    style = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom", "fontsize": 8}
    axes.annotate("exactly 0 is drawn here", (0.99, FLOOR * 2), color=figures.GREY, **style)


def paint_windup(runs: Mapping[str, CovarianceRun]):
    """Largest eigenvalue of P while a direction is silent, a panel for each kind of silence."""
    figure, grid = figures.new(1, len(runs), height=3.0, sharey=True, squeeze=False)
    for axes, (title, run) in zip(grid[0], runs.items(), strict=True):
        t = run.time_constants
        axes.semilogy(t, run.largest, label="every form")
        axes.semilogy(t, np.exp(t), color=figures.GREY, lw=4, alpha=0.4, zorder=1, label="exp(t / T)")
        axes.set(xlabel="time constants of the forgetting", title=title, ylim=(0.3, 1e15))
    grid[0, 0].set(ylabel="largest eigenvalue of P / start")
    figures.legend_below(grid[0, 0], 2)
    return figure


def paint_return(outcomes: Mapping[str, Sequence[Run]], return_s: float):
    """Filtered error around the return of a silent sensor; a cross marks where a run broke."""
    figure, grid = figures.new(1, len(outcomes), height=3.0, sharey=True, squeeze=False)
    for axes, (name, runs) in zip(grid[0], outcomes.items(), strict=True):
        for number, run in enumerate(runs, 1):
            near, error = run.time_s > return_s - 5, np.sqrt(run.error_power)
            axes.semilogy(run.time_s[near] - return_s, error[near], lw=0.9, label=f"floor {number}")
            if run.broke_s is not None:
                style = {"color": axes.lines[-1].get_color(), "label": f"floor {number}, broke"}
                axes.plot(run.broke_s - return_s, error[-1], "x", ms=9, mew=2, **style)
        axes.axvspan(-5, 0, color=figures.GREY, alpha=0.12, lw=0)
        axes.set(xlabel="time since the sensor's return (s)", title=name, xlim=(-5, 15))
        axes.legend(loc="upper right")
    grid[0, 0].set(ylabel="filtered error, rms (N)")
    return figure


def paint_cures(
    runs: Mapping[str, CureRun], samples_per_constant: float, silence: tuple[float, float], step: float
):
    """Growth of P, misalignment and error of the cures."""
    figure, (top, middle, bottom) = figures.new(3, 1, height=6.4, sharex=True)
    styles = ("-", "--", "-.", "-", "--", ":", "-.", "--")
    colors = (*COLOURS, figures.GREY)
    for style, color, (name, run) in zip(styles, colors, runs.items(), strict=False):
        t = run.samples / samples_per_constant
        top.semilogy(t, run.growth.max(axis=1), style, color=color, label=f"{name}, largest")
        top.semilogy(t, run.growth.min(axis=1), style, color=color, lw=0.7, label=f"{name}, smallest")
        middle.semilogy(t, run.misalignment, style, color=color, label=name)
        bottom.semilogy(t, np.sqrt(run.error_power), style, color=color, label=name)
    for axes in (top, middle, bottom):
        axes.axvspan(*silence, color=figures.GREY, alpha=0.12, lw=0)
        axes.axvline(step, color=figures.BLACK, lw=0.8, ls=":")
    look = {"xycoords": ("data", "axes fraction"), "va": "top", "fontsize": 8}
    top.annotate("one floor sensor silent", (np.mean(silence), 0.96), ha="center", **look)
    look |= {"xytext": (-4, 0), "textcoords": "offset points"}
    middle.annotate("the optimum moves by 20 %", (step, 0.96), ha="right", **look)
    top.set(ylabel="diagonal of P / start", ylim=(1e-2, 1e6))
    middle.set(ylabel="misalignment")
    bottom.set(xlabel="time constants of the forgetting", ylabel="filtered error, rms (N)")
    figures.legend_below(top, 4)
    return figure


def explore_forms(regressors: ArrayLike, initial: ArrayLike):
    """Explorer: asymmetry of every form, with another forgetting or precision."""

    def paint(precision: str, samples_per_constant: float, time_constants: float):
        figure, axes = figures.new(1, 1, height=3.0)
        forgetting = float(np.exp(-1 / samples_per_constant))
        for style, form in zip(_LINES, EXPLORED, strict=False):
            run = covariance_run(form, regressors, forgetting, initial, time_constants, precision, 2)
            broke = f"indefinite at about {run.breakdown_tens():.0f}"
            label = f"{form}: {'stays definite' if np.isinf(run.breakdown) else broke}"
            axes.semilogy(run.time_constants, np.maximum(run.asymmetry, FLOOR), style, label=label)
        axes.set(xlabel="time constants of the forgetting", ylabel="antisymmetric part of P")
        axes.set(
            ylim=(FLOOR / 3, 10), title=f"{precision}, time constant of {samples_per_constant:.0f} samples"
        )
        axes.set_yticks(10.0 ** np.arange(-18, 1, 3), minor=False)
        _name_zero(axes)
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
        return figure

    # Both precisions are compiled here, not at a reader's first move.
    for precision in ("float64", "float32"):
        covariance_run("triangle", regressors, 0.5, initial, 1, precision, per_time_constant=1)
    return paint
