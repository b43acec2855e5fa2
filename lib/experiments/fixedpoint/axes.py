"""What pictures of this topic share: a filter's colour, an error's label and unit, axes, legends, intervals."""

import numpy as np

from experiments.fixedpoint.published import EXTENDED, KALMAN, LITERAL, LOW_PASS, POLYNOMIAL, WINDOW
from stillwork.base.checks import InputError
from workbook import figures
from workbook.studies import mean_interval

COLOURS = {
    WINDOW: figures.BLUE,
    LOW_PASS: figures.GREEN,
    KALMAN: figures.RED,
    LITERAL: figures.ORANGE,
    EXTENDED: figures.PURPLE,
    POLYNOMIAL: figures.SKY,
}

# Width and style of a line over the motion, where the runs lie on one another: each later one is narrower.
LINES = {
    WINDOW: (2.4, "-"),
    LOW_PASS: (1.8, "-"),
    KALMAN: (1.2, "-"),
    LITERAL: (1.0, "--"),
}
NOMINAL = {"color": figures.GREY, "alpha": 0.4, "linewidth": 4.5, "label": "nominal", "zorder": 1}

# Label, title, and factor to the label's unit.
METRICS = {
    "position": ("RMS error of q (mm)", "position", 1e3),
    "velocity": ("RMS error of q' (mm/s)", "velocity", 1e3),
    "roughness": ("roughness (m/s²)", "change of q'' per sample", 1.0),
}


def legend_above(axes, columns: int | None = None):
    """What a panel's lines mean, above the whole figure; by default in one row."""
    handles, labels = axes.get_legend_handles_labels()
    axes.figure.legend(handles, labels, loc="outside upper center", ncols=columns or len(labels))


def log_axis(axis):
    """A logarithmic axis with few, plain numbers: decades; 1, 2 and 5 where it spans less than two; more in less than one."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = axis.get_view_interval()
    subs = (
        (1.0,)
        if high / low > 80
        else (1.0, 2.0, 5.0)
        if high / low > 8
        else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    )
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def fill_range(axes, time: np.ndarray, error: np.ndarray, length: int, **style):
    """From the smallest to the largest error in stretches of so many samples, over the middle of each."""
    whole = len(time) // length * length
    blocks = error[:whole].reshape(-1, length)
    middle = time[:whole].reshape(-1, length)[:, length // 2]
    style = {"alpha": 0.6, "lw": 0.8} | style
    axes.fill_between(middle, blocks.min(axis=1), blocks.max(axis=1), **style)


def points_with_intervals(axes, runs: list[np.ndarray], places, name: str):
    """Means of the runs as points, their 95 % intervals as bars."""
    if not all(np.isfinite(values).all() for values in runs):
        raise InputError(
            f"{name}: a loop diverged, so its error has no mean; take less noise or another motion"
        )
    intervals = [mean_interval(values) for values in runs]
    axes.plot([values.mean() for values in runs], places, "o", ms=4, color=COLOURS[name], label=name)
    label = f"{name}, 95 % interval"
    axes.hlines(places, *zip(*intervals, strict=True), color=COLOURS[name], label=label)
