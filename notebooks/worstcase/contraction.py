"""The fixed-point map: convergence without contraction: what this notebook alone needs."""

from functools import cache

import numpy as np

from experiments.worstcase.theory import counter_example, random_problem
from stillwork.estimation.secular import SecularFunction, secular_function
from workbook import figures
from workbook.studies import Study, run_study


def convergence_trial(
    rng: np.random.Generator,
    unknowns: int,
    steps: int,
    shares: tuple[float, float] = (0.05, 0.9),
    few_from: float = 2.0,
    **problem,
) -> dict[str, float]:
    """Theorem 3 on one problem, from thirteen starts over twelve decades; and the largest slope of f.

    The bound is between `shares` of the threshold; `problem` as of `random_problem`. ``converged``: share of starts
    within 1e-6 of the root after `steps`. ``monotone``: share whose iterates never turn back. ``slope``: largest f'.
    ``log_slope``: largest d log f / d log alpha. ``rate``: f' at the root. ``few``: relative error after 3 iterations
    from `few_from` times the root.
    """
    matrix, target, threshold = random_problem(rng, unknowns, **problem)
    function = secular_function(matrix, target, threshold * rng.uniform(*shares))
    root, _ = function.root()
    path = [root * np.geomspace(1e-6, 1e6, 13)]
    for _ in range(steps):
        path.append(function(path[-1]))
        if np.array_equal(path[-1], path[-2]):  # nothing moves any more
            break
    path = np.array(path)
    moves = np.diff(path, axis=0) * np.sign(root - path[0])
    alphas = root * np.geomspace(1e-6, 1e6, 400)
    slopes = function.slope(alphas)
    return {
        "converged": float(np.mean(np.abs(path[-1] / root - 1) < 1e-6)),
        "monotone": float(np.mean(np.all(moves[:, [*range(6), *range(7, 13)]] >= -1e-9 * root, axis=0))),
        "slope": float(slopes.max()),
        "log_slope": float((alphas * slopes / function(alphas)).max()),
        "rate": float(function.slope(root)),
        "few": float(abs(function.iterates(few_from * root, 3)[-1] / root - 1)),
    }


def scalar_trial(rng: np.random.Generator) -> dict[str, float]:
    """Section 8's statements on the scalar case: slopes of f between its ends, and the rate beta."""
    matrix, target, threshold = random_problem(rng, 1)
    function = secular_function(matrix, target, threshold * rng.uniform(0.02, 0.98))
    energy = function.eigenvalues[0]  # a'a
    beta = function.bound / threshold
    kappa = energy * function.excess**2 / (target @ target)
    slopes = function.slope(energy * np.geomspace(1e-8, 1e8, 200))
    root, _ = function.root()
    path = function.iterates(root * 10.0 ** rng.uniform(-3, 3), 12)
    distances = np.abs(path - root)
    rounding = 1e-13 * (path[:-1] + root)
    return {
        "bounded": float(np.all((slopes > 0) & (slopes <= beta * (1 + 1e-12)))),
        "rising": float(np.all(np.diff(slopes) >= -1e-12 * beta)),
        "at_zero": float(function.slope(0.0) / (beta * np.sqrt(kappa / energy)) - 1),
        "at_infinity": float(slopes[-1] / beta - 1),
        "contracts": float(np.all(distances[1:] <= beta * distances[:-1] + rounding)),
    }


def by_unknowns(found: dict[int, Study]):
    """A row a number of unknowns: shares of `convergence_trial`, and the largest slopes."""
    from pandas import DataFrame

    return DataFrame(
        {
            "converged": {n: study["converged"].mean() for n, study in found.items()},
            "monotone": {n: study["monotone"].mean() for n, study in found.items()},
            "contraction": {n: np.mean(study["slope"] < 1) for n, study in found.items()},
            "largest slope": {n: study["slope"].max() for n, study in found.items()},
            "largest log-slope": {n: study["log_slope"].max() for n, study in found.items()},
        }
    ).rename_axis("unknowns")


# === Contraction pictures ==================================================================================


def paint_scalar(function: SecularFunction):
    """f and f' for one unknown, with the bounds that Section 8 gives for f'."""
    figure, (left, right) = figures.new(1, 2, height=3.0)
    root, _ = function.root()
    beta = function.bound / function.threshold
    alpha = np.geomspace(1e-3, 1e3, 301) * root
    path = function.iterates(root * 300, 40)
    style = {"markersize": 3.5, "color": figures.RED, "label": "iterates of eq. (21)"}
    _paint_map(left, function, alpha, path[:-1], path[1:], **style)
    right.semilogx(alpha, function.slope(alpha), label="f′(α)")
    figures.mark_published(right, alpha[-1], beta, "limit β at infinity")
    figures.mark_published(right, alpha[0], function.slope(0.0), "β √(κ/a′a) at zero", marker="s")
    right.set(xlabel="α", ylabel="slope f′(α)", ylim=(0, 1.05))
    right.legend(loc="center right")
    return figure


def paint_counter_example(function: SecularFunction):
    """A map for two unknowns whose slope exceeds 1, and its iterates, which converge all the same."""
    figure, (left, middle, right) = figures.new(1, 3, height=3.0)
    root, _ = function.root()
    alpha = np.geomspace(1e-6, 1e3, 401) * root
    _paint_map(left, function, alpha, root, root, color=figures.RED, label="root")
    left.minorticks_off()  # over many decades they take longer to draw than all else
    _paint_slope(middle, function, alpha)
    _paint_iterates(right, function, root)
    return figure


def _paint_map(axes, function: SecularFunction, alpha: np.ndarray, first, second, **style):
    axes.loglog(alpha, function(alpha), label="f(α)")
    axes.loglog(alpha, alpha, color=figures.BLACK, linewidth=0.8, label="α")
    axes.loglog(first, second, "o", **style)
    axes.set(xlabel="α", ylabel="f(α)")
    axes.legend()


def _paint_slope(axes, function: SecularFunction, alpha: np.ndarray):
    slopes = function.slope(alpha)
    axes.semilogx(alpha, slopes, label="f′")
    axes.semilogx(alpha, alpha * slopes / function(alpha), color=figures.GREEN, label="d log f / d log α")
    axes.axhline(1, color=figures.BLACK, linewidth=0.8, linestyle="--", label="edge of a contraction")
    axes.set(xlabel="α", ylabel="slope", ylim=(0, 1.5 * max(1.0, slopes.max())))
    axes.minorticks_off()
    axes.legend(loc="upper right")


STARTS = (  # decades over the root
    (-5, "10⁻⁵", figures.BLUE),
    (-2, "0.01", figures.SKY),
    (1, "10", figures.ORANGE),
    (3, "1000", figures.RED),
)


def _paint_iterates(axes, function: SecularFunction, root: float):
    for decade, factor, colour in STARTS:
        style = {"markersize": 2.5, "lw": 0.8, "color": colour, "label": f"from {factor} × root"}
        axes.semilogy(function.iterates(root * 10.0**decade, 25), "o-", **style)
    axes.axhline(root, color=figures.BLACK, linewidth=0.8, label="root")
    axes.set(xlabel="iteration", ylabel="α")
    axes.minorticks_off()
    axes.legend(fontsize=7)


def paint_slopes(slopes: dict[int, np.ndarray], rates: dict[int, np.ndarray]):
    """Largest slope of f, and slope at the root, over random problems, by number of unknowns."""
    figure, (left, right) = figures.new(1, 2, height=3.0, sharey=True)
    sides = ((left, slopes, "largest slope of f"), (right, rates, "slope of f at the root"))
    for axes, values, label in sides:
        for unknowns, found in values.items():
            share = np.arange(1, len(found) + 1) / len(found)
            axes.step(np.sort(found), share, where="post", label=f"n = {unknowns}")
        axes.axvline(1, color=figures.BLACK, linewidth=0.8, linestyle="--", label="edge of a contraction")
        axes.set_xlabel(label)
    left.set(xscale="log", ylabel="share of problems below")
    right.set_xlim(right=1.06)
    figures.legend_below(left, len(slopes) + 1)
    return figure


def explore_counter_example(bound: float, excess: float):
    """Slope and iterates of the counter-example for a bound and a distance of b from the column space."""
    function = counter_example(bound, excess)
    root, _ = function.root()
    figure, left, right = _counter_figure()
    alpha = np.geomspace(1e-6, 1e3, 201) * root
    slopes = function.slope(alpha)
    left.lines[0].set_data(alpha, slopes)
    left.lines[1].set_data(alpha, alpha * slopes / function(alpha))
    left.set_ylim(0, 1.5 * max(1.0, slopes.max()))
    for line, (decade, *_) in zip(right.lines, STARTS, strict=False):
        line.set_ydata(function.iterates(root * 10.0**decade, 25))
    right.lines[len(STARTS)].set_ydata([root, root])
    for axes in (left, right):
        axes.relim()
        axes.autoscale_view(scalex=axes is left, scaley=axes is right)
    return figure


@cache
def _counter_figure():
    """Figure and panels of the explorer, kept for its next move: only their data change."""
    function = counter_example(0.5, 0.02)
    root, _ = function.root()
    figure, (left, right) = figures.new(1, 2, height=3.0)
    _paint_slope(left, function, np.geomspace(1e-6, 1e3, 201) * root)
    _paint_iterates(right, function, root)
    return figure, left, right


# --- Section 8: Theorem 3 on random problems ----------------------------------------------------------------------

PROBLEMS = 10  # for each number of unknowns; the notebook has 120
STEPS = 2000  # until convergence is judged: near the threshold, in much noise, the notebook's 400 are too few


def contraction(
    *,
    problem_columns: float,
    problem_noise: str,
    problem_bound: str,
    iterations_from: float,
    seed: int,
    lean: bool,
) -> dict[str, float]:
    """Theorem 3 and its ground on random problems of 2 to 8 unknowns; the fast variant takes 10 of each instead of 120."""
    shares = {"any": (0.05, 0.9), "small": (0.05, 0.1), "large": (0.85, 0.9)}[problem_bound]
    noise = {"any": (-2.0, 0.0), "small": (-2.0, -2.0), "large": (0.0, 0.0)}[problem_noise]
    settings = {"steps": STEPS, "shares": shares, "few_from": iterations_from}
    settings |= {"decades": problem_columns, "noise": noise}
    runs = PROBLEMS if lean else 120
    found = [
        run_study(convergence_trial, runs, seed, unknowns=n, progress=False, **settings) for n in (1, 2, 4, 8)
    ]
    return {
        "worstcase.contraction.theorem-3": np.mean([study["converged"].mean() for study in found]),
        "worstcase.contraction.mapping": np.mean([study["slope"] < 1 for study in found[1:]]),
        "worstcase.contraction.few-iterations": np.median([study["few"] for study in found[1:]]),
    }
