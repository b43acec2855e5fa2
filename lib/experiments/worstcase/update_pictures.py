"""Pictures of the time updates: distance from batch, accuracy of (20), cost against n."""

import numpy as np

from experiments.worstcase.costs import multiplications
from experiments.worstcase.simulations import FIG_2_PARAMETERS, path
from experiments.worstcase.theory import recursion_trial
from workbook import figures
from workbook.timings import measured_times

COLOURS = {
    "least squares": figures.BLACK,
    "ridge": figures.GREEN,
    "approximate": figures.BLUE,
    "exact": figures.ORANGE,
    "fast": figures.PURPLE,
    "SOCP": figures.GREY,
}


def paint_exactness(found: dict[str, np.ndarray]):
    """Norm of the batch estimate along time, and of the exact and the fast recursion at every eighth sample."""
    figure, axes = figures.new(height=2.8)
    time = np.arange(len(found["size"]))
    axes.plot(time, found["size"], color=figures.BLACK, linewidth=0.9, label="batch solution at every sample")
    for update, first, marker, size in (("exact", 0, "o", 3), ("fast", 4, "x", 4)):
        style = {"markersize": size, "color": COLOURS[update], "label": f"{update} recursion"}
        axes.plot(time[first::8], found[f"size_{update}"][first::8], marker, **style)
    axes.set(xlabel="time (samples)", ylabel="|x|")
    axes.legend()
    return figure


def paint_accuracy(records: dict[str, dict[str, np.ndarray]]):
    """Error of alpha and of the estimate of (20) with 1, 2 and 3 iterations; one row of axes a record."""
    figure, grid = figures.new(len(records), 2, sharex=True, squeeze=False)
    for (title, found), (left, right) in zip(records.items(), grid, strict=True):
        for axes, name in ((left, "alpha"), (right, "approximate")):
            for iterations, colour in ((1, figures.BLUE), (2, figures.ORANGE), (3, figures.GREEN)):
                label = f"{iterations} iteration{'s' * (iterations > 1)}"
                errors = found[f"{name}_{iterations}"]
                # where (20) starts from the exact solution its error is rounding, which differs between machines
                shown = np.where(errors > 1e-11, errors, np.nan)
                axes.semilogy(shown, color=colour, linewidth=0.8, label=label)
            axes.minorticks_off()
            axes.set_ylim(bottom=1e-10)
        left.set(ylabel="relative error of α", title=title)
        right.set(ylabel="|x − batch| / max |batch|", title=f"{title}: estimate")
    figures.label(grid, "time (samples)")
    figures.legend_below(grid[0, 0], 3)
    return figure


def paint_counts(sizes: list[int], evaluations: float):
    """Multiplications an update against n, with what the paper claims as slopes."""
    figure, axes = figures.new(height=3.4)
    for update in ("least squares", "ridge", "approximate", "exact", "fast"):
        needed = 1.0 if update == "approximate" else evaluations
        counts = [multiplications(update, n, needed) for n in sizes]
        axes.loglog(sizes, counts, "o-", markersize=3, color=COLOURS[update], label=update)
    n = np.array([sizes[0], sizes[-1]], dtype=float)
    for power, name, colour in ((2, "n²", figures.BLACK), (3, "n³", figures.BLUE)):
        axes.loglog(n, 0.5 * n**power, color=colour, linewidth=0.8, linestyle="--", label=f"∝ {name}")
    axes.set(xlabel="number of unknowns n", ylabel="multiplications an update")
    axes.legend(ncols=2)
    return figure


def times_by_name() -> dict[str, np.ndarray]:
    """The committed table of benchmark times: ``unknowns`` and microseconds an update, by name."""
    rows = measured_times("worstcase", "update_times/update_times.csv")
    columns = {"unknowns": np.array(list(map(float, rows)))}
    for heading in next(iter(rows.values())):
        columns[heading.removesuffix(" (us)")] = np.array([row[heading] for row in rows.values()])
    return columns


def paint_times(times: dict[str, np.ndarray]):
    """Measured time an update against n (the committed table)."""
    figure, axes = figures.new(height=3.4)
    styles = {
        "RLS": ("least squares", "o-"),
        "ridge": ("ridge", "o-"),
        "approximate 1": ("approximate", "o-"),
        "approximate 3": ("approximate", "v:"),
        "exact": ("exact", "o-"),
        "fast": ("fast", "o-"),
        "SOCP": ("SOCP", "s-"),
    }
    for name, (kind, style) in styles.items():
        axes.loglog(times["unknowns"], times[name], style, markersize=3, color=COLOURS[kind], label=name)
    axes.set(xlabel="number of unknowns n", ylabel="time an update (µs)")
    axes.legend(ncols=2)
    return figure


def explore_accuracy(bound: float, noise: float):
    """`paint_accuracy` on one record of the setting of Fig. 2."""
    truth = path("constant", FIG_2_PARAMETERS, 120)
    found = recursion_trial(np.random.default_rng(1), truth, bound, 0.95, noise)
    return paint_accuracy({f"η = {bound:.3g}": found})
