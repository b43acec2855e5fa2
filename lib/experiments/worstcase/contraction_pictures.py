"""Pictures of the fixed-point map f: its slope, its iterates, and where it is no contraction."""

import numpy as np

from experiments.worstcase.theory import counter_example
from stillwork.estimation.secular import SecularFunction
from workbook import figures


def paint_scalar(function: SecularFunction):
    """f and f' for one unknown, with the bounds that Section 8 gives for f'."""
    figure, (left, right) = figures.new(1, 2, height=3.0)
    root, _ = function.root()
    beta = function.bound / function.threshold
    alpha = np.geomspace(1e-3, 1e3, 301) * root
    path = function.iterates(root * 300, 12)
    style = {"markersize": 3.5, "color": figures.RED, "label": "iterates of (21)"}
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
    axes.axhline(1, color=figures.BLACK, linewidth=0.8, linestyle="--")
    axes.set(xlabel="α", ylabel="slope", ylim=(0, 1.35 * max(1.0, slopes.max())))
    axes.minorticks_off()
    axes.legend(loc="upper right")


def _paint_iterates(axes, function: SecularFunction, root: float):
    for decade, colour in ((-5, figures.BLUE), (-2, figures.SKY), (1, figures.ORANGE), (3, figures.RED)):
        style = {"markersize": 2.5, "lw": 0.8, "color": colour, "label": f"from {10.0**decade:g} × root"}
        axes.semilogy(function.iterates(root * 10.0**decade, 25), "o-", **style)
    axes.axhline(root, color=figures.BLACK, linewidth=0.8)
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
        axes.axvline(1, color=figures.BLACK, linewidth=0.8, linestyle="--")
        axes.set(xlabel=label, ylabel="share of problems")
        axes.legend(loc="lower right")
    left.set_xscale("log")
    return figure


def explore_counter_example(bound: float, excess: float):
    """Slope and iterates of the counter-example for a bound and a distance of b from the column space."""
    function = counter_example(bound, excess)
    root, _ = function.root()
    figure, (left, right) = figures.new(1, 2, height=3.0)
    _paint_slope(left, function, np.geomspace(1e-6, 1e3, 201) * root)
    _paint_iterates(right, function, root)
    return figure
