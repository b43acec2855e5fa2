"""Figures of the efficient update (notebook 06): agreement of the forms, and what each costs."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from experiments.isolation.direct import average_gain, multiplications
from stillwork.workbook import figures

_NAMES = {
    "full inverse": "54 × 54 inverse, (25)-(26)",
    "block inverse": "9 × 9 inverse, (28)",
    "recursion": "9 × 9 recursion, (29)-(30)",
    "FeLMS": "FeLMS, (19)",
}


def paint_agreement(
    time_s: ArrayLike,
    recursion: ArrayLike,
    differences: Mapping[str, ArrayLike],
    bound: float,
):
    """Weights of one actuator by the recursion, (samples, n), and how far the direct forms are from it.

    Differences are relative to the largest weight; drawn is the largest so far: that of one sample is a draw of
    rounding. `bound` is what rounding may reach.
    """
    figure, (upper, lower) = figures.new(2, 1, height=4.8, sharex=True)
    for number, row in enumerate(np.transpose(recursion), 1):
        color = (figures.BLUE, figures.RED, figures.GREEN)[(number - 1) // 3]
        upper.plot(time_s, row, ("-", "--", ":")[(number - 1) % 3], color=color, label=f"w{number}")
    for style, (name, difference) in zip(("-", "--", ":"), differences.items(), strict=True):
        so_far = np.maximum.accumulate(np.maximum(difference, np.finfo(float).eps))
        lower.semilogy(time_s, so_far, style, label=name)
    lower.axhline(bound, color=figures.BLACK, lw=0.8, ls="-.", label="bound of rounding")
    upper.set(ylabel="weight of the first\nactuator (N per m/s²)", title="recursion")
    lower.set(
        xlabel="time (s)",
        ylabel="relative difference",
        title="direct forms to recursion, all weights, so far",
    )
    upper.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    lower.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    return figure


def paint_gain(forgetting: float, samples: int, sample_time: float):
    """alpha(k) of eq. (22) with and without forgetting."""
    figure, axes = figures.new(1, 1, height=2.6)
    count = np.unique(np.geomspace(1, samples, 200).astype(int)) - 1
    time_s = (count + 1) * sample_time
    axes.loglog(time_s, average_gain(forgetting, samples)[count], label=f"forgetting {forgetting:.5f}")
    axes.loglog(time_s, average_gain(1.0, samples)[count], "--", label="no forgetting, 1 / (1 + k)")
    axes.axhline(1 - forgetting, color=figures.GREY, lw=0.8, ls=":", label="limit 1 - forgetting")
    axes.set(xlabel="time (s)", ylabel="gain α(k)")
    axes.legend()
    return figure


def paint_costs(
    actuators: int, regressors: int, times: Mapping[str, Mapping[str, float]], sample_time: float
):
    """Multiplications of each form, and measured times against the sampling interval."""
    figure, (upper, lower) = figures.new(2, 1, height=4.6)
    counts = multiplications(actuators, regressors)
    _bars(upper, {_NAMES[name]: count for name, count in counts.items()}, "{:,.0f}")
    upper.set(
        xlabel="multiplications and divisions per sample",
        title=f"{actuators} outputs × {regressors} regressors",
    )
    shown = {**_NAMES, "C": "the recursion in C"}
    _bars(lower, {text: times[name]["median_us"] for name, text in shown.items() if name in times}, "{:.2g}")
    lower.axvline(1e6 * sample_time, color=figures.BLACK, lw=1, ls="--")
    lower.annotate(
        f"sampling interval, {1e6 * sample_time:.0f} µs",
        (1e6 * sample_time, 3.0),
        ha="right",
        va="center",
        fontsize=8,
        xytext=(-3, 0),
        textcoords="offset points",
    )
    lower.set(xlabel="measured time per update (µs)", title="measured, 6 outputs × 9 regressors")
    return figure


def explore_costs(actuators: int, regressors: int):
    """Multiplications of each form for any size; what the recursion saves."""
    figure, axes = figures.new(1, 1, height=2.6)
    counts = multiplications(actuators, regressors)
    names = {
        "full inverse": "inverse of all parameters",
        "block inverse": "inverse of one block",
        "recursion": "recursion",
        "FeLMS": "FeLMS",
    }
    _bars(axes, {names[name]: count for name, count in counts.items()}, "{:,.0f}")
    saved = counts["full inverse"] / counts["recursion"]
    axes.set(
        xlabel="multiplications and divisions per sample",
        title=f"{actuators * regressors} parameters: the recursion takes {saved:,.0f} times fewer than the inverse",
    )
    return figure


def _bars(axes, values: Mapping[str, float], text: str):
    """Horizontal bars on a logarithmic axis with their numbers beside them, first on top."""
    place = np.arange(len(values))
    numbers = list(values.values())
    axes.barh(place, numbers, color=figures.SKY, height=0.6)
    axes.plot(numbers, place, "|", color=figures.BLUE, ms=14, mew=2, label="value")
    for y, number in zip(place, numbers, strict=True):
        axes.annotate(
            text.format(number),
            (number, y),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    axes.set(xscale="log", xlim=(min(numbers) / 3, max(numbers) * 30))
    axes.set_yticks(place, list(values))
    axes.set_ylim(len(values) - 0.4, -0.8)
    axes.grid(visible=False, axis="y")
