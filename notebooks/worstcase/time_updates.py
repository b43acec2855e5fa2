"""Time updates: exact, approximate, fast, and what they cost: what this notebook alone needs."""

import numpy as np

from experiments.worstcase.simulations import FIG_2_PARAMETERS, path
from experiments.worstcase.theory import recursion_trial
from workbook import figures
from workbook.studies import Study, run_study
from workbook.timings import measured_times

# === Costs ========================================================================================================
# What an update costs: multiplications, divisions and roots, counted from the loops of the kernels.


# Evaluations that each root of the rank-one eigenproblem takes on average, counted over random updates.
ROOT_EVALUATIONS = 3.4


def multiplications(update: str, n: int, evaluations: float = 1.0) -> float:
    """Multiplications, divisions and square roots of one update: one of the toolbox, or ``fast``.

    For `n` unknowns. `evaluations` are those of the secular function: from `Track.evaluations` (exact, fast), or the number of
    fixed-point iterations (approximate).
    """
    accumulate = n * (n + 1) + 4 * n
    factorise = n * (n - 1) * (n - 2) / 6 + 3 * n * (n - 1) / 2 + n
    forward = n * (n - 1) / 2
    backward = forward + n
    squares = forward + 5 * n
    if update == "least squares":
        return 2.0 * n**2 + 5 * n + 3
    if update == "ridge":
        return accumulate + factorise + backward
    if update == "approximate":
        gain = forward + backward + 3 * n + 1
        return accumulate + 2 + gain + evaluations * (squares + 4 + factorise + backward)
    if update == "exact":
        trial = factorise + 2 * backward + squares + forward + 2 * n + 30
        return accumulate + 2 + evaluations * trial + forward + backward + 2 * n
    roots = n * (3 * n + ROOT_EVALUATIONS * (3 * n + 15))
    return n**3 + 8 * n**2 + 15 * n + roots + evaluations * (7 * n + 30)


def slope(sizes, costs) -> float:
    """Exponent of growth: least-squares slope of log cost over log size."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


# === Update pictures ==============================================================================================
# Pictures of the time updates: distance from batch, accuracy of (20), cost against n.


COLOURS = {
    "least squares": figures.BLACK,
    "ridge": figures.GREEN,
    "approximate": figures.BLUE,
    "exact": figures.ORANGE,
    "fast": figures.PURPLE,
    "SOCP": figures.GREY,
}
ITERATIONS = {"approximate 1": "approximate, 1 iteration", "approximate 3": "approximate, 3 iterations"}


def paint_exactness(found: dict[str, np.ndarray]):
    """Norm of the batch estimate along time, and of the exact and the fast recursion at every eighth sample."""
    figure, axes = figures.new(height=2.8)
    time = np.arange(len(found["size"]))
    axes.plot(time, found["size"], color=figures.BLACK, linewidth=0.9, label="batch solution at every sample")
    for update, first, marker, size in (("exact", 0, "o", 3), ("fast", 4, "x", 4)):
        style = {"markersize": size, "color": COLOURS[update], "label": f"{update} recursion"}
        axes.plot(time[first::8], found[f"size_{update}"][first::8], marker, **style)
    axes.set(xlabel="time (samples)", ylabel="norm of the estimate |x|")
    axes.legend()
    return figure


def paint_accuracy(records: dict[str, dict[str, np.ndarray]]):
    """Error of alpha and of the estimate of (20) with 1, 2 and 3 iterations; one row of axes a record."""
    figure, grid = figures.new(len(records), 2, sharex=True, sharey="col", squeeze=False)
    for (title, found), (left, right) in zip(records.items(), grid, strict=True):
        for axes, name in ((left, "alpha"), (right, "approximate")):
            for iterations, colour in ((1, figures.BLUE), (2, figures.ORANGE), (3, figures.GREEN)):
                label = f"{iterations} iteration{'s' * (iterations > 1)}"
                errors = found[f"{name}_{iterations}"]
                # where (20) starts from the exact solution its error is rounding, which differs between machines
                shown = np.where(errors > 1e-11, errors, np.nan)
                axes.semilogy(shown, color=colour, linewidth=0.8, label=label)
            axes.minorticks_off()
        left.set(ylabel="relative error of α", title=title)
        right.set(ylabel="|x − batch| / max |batch|", title=f"{title}: estimate")
    for axes in grid[0]:
        axes.set_ylim(bottom=1e-10)  # after all rows: it ends the scaling of the shared axis
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
    for power, name, colour in ((2, "n²", figures.BLACK), (3, "n³", figures.GREY)):
        axes.loglog(n, 0.5 * n**power, color=colour, linewidth=0.8, linestyle="--", label=f"∝ {name}")
    axes.set(xlabel="number of unknowns n", ylabel="multiplications per update")
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
        axes.loglog(
            times["unknowns"],
            times[name],
            style,
            markersize=3,
            color=COLOURS[kind],
            label=ITERATIONS.get(name, name),
        )
    axes.set(xlabel="number of unknowns n", ylabel="time per update (µs)")
    axes.legend(ncols=2)
    return figure


def explore_accuracy(bound: float, noise: float):
    """`paint_accuracy` on one record of the setting of Fig. 2."""
    truth = path("constant", FIG_2_PARAMETERS, 120)
    found = recursion_trial(np.random.default_rng(1), truth, bound, 0.95, noise)
    return paint_accuracy({f"η = {bound:.3g}": found})


# === Update choices ===============================================================================================

SMALL_BOUND, SAMPLES = 0.1, 375  # of notebook 03, which has this bound beside the large one


def updates(*, fig_2_noise: float, update_bound: float, seed: int, lean: bool) -> dict[str, float]:
    """Theorem 2, the misprint of h and (20)'s single iteration; the fast variant takes 2 records instead of 10."""
    truth = path("constant", FIG_2_PARAMETERS, SAMPLES)
    small, large = (
        run_study(
            recursion_trial, 2 if lean else 10, seed, progress=False,
            truth=truth, bound=bound, forgetting=0.95, noise=fig_2_noise,
        )
        for bound in (SMALL_BOUND, update_bound)
    )  # fmt: skip
    return update_statements(small, large)


def update_statements(small: Study, large: Study) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """What records with a small and with a large bound say of the recursions, by the ledger's names."""
    largest = np.nanmax(large["alpha_1"], axis=1)
    found = {
        "theorem-2": max(study[name].max() for study in (small, large) for name in ("exact", "fast")),
        "h-as-printed": np.nanmedian(large["as_printed"]),
        "eq-18-as-printed": np.nanmedian(large["image_as_printed"]),
        "single-iteration": np.median(large["approximate_1"][:, 10:]),
        "single-iteration-large": np.nanmedian(large["alpha_1"]),
        "single-iteration-tail": np.nanquantile(large["alpha_1"], 0.95),
        "single-iteration-largest": (np.median(largest), (largest.min(), largest.max())),
    }
    return {f"worstcase.updates.{name}": value for name, value in found.items()}
