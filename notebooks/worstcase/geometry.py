"""Pictures of the min-max problem for one and two unknowns, and of its secular equation."""

import numpy as np

from experiments.worstcase.simulations import sample_problem
from stillwork.estimation.min_max import solve_silently
from stillwork.estimation.secular import secular_function
from workbook import figures


def costs(matrix: np.ndarray, target: np.ndarray, bound: float, points: np.ndarray) -> np.ndarray:
    """|A x - b| + eta |x| (2) at points of shape (..., unknowns)."""
    residuals = np.linalg.norm(points @ matrix.T - target, axis=-1)
    return residuals + bound * np.linalg.norm(points, axis=-1)


def paint_one_unknown(matrix: np.ndarray, target: np.ndarray, bounds: list[float]):
    """Cost (2) over a single unknown for several bounds, its minimum marked."""
    figure, axes = figures.new(height=3.0)
    least = solve_silently(matrix, target, 0.0).estimate[0]
    reach = 1.6 * abs(least)
    x = np.sign(least) * np.linspace(-0.35 * reach, reach, 401)
    for bound in bounds:
        found = solve_silently(matrix, target, bound)
        values = costs(matrix, target, bound, x[:, None])
        (line,) = axes.plot(x, values, label=f"η = {bound:.3g}, {found.case}")
        style = {"color": line.get_color(), "label": f"minimum, η = {bound:.3g}"}
        axes.plot(found.estimate, found.worst_case_residual, "o", **style)
    axes.set(xlabel="x", ylabel="worst-case residual (unit of b)")
    axes.legend(ncols=2)
    return figure


def paint_two_unknowns(matrix: np.ndarray, target: np.ndarray, bound: float):
    """Contours of the cost over two unknowns, with the estimate's way from least squares to zero."""
    figure, axes = figures.new(height=3.6)
    start = solve_silently(matrix, target, 0.0)
    found = solve_silently(matrix, target, bound)
    shares = np.concatenate([np.linspace(0, 0.999, 120), [1.0]])
    way = np.array([solve_silently(matrix, target, s * start.threshold).estimate for s in shares])
    reach = 1.5 * np.abs(start.estimate).max()
    grid = np.linspace(-0.5 * reach, reach, 121)
    first, second = np.meshgrid(np.sign(start.estimate[0]) * grid, np.sign(start.estimate[1]) * grid)
    values = costs(matrix, target, bound, np.stack([first, second], axis=-1))
    levels = found.worst_case_residual * np.array([1.002, 1.01, 1.03, 1.07, 1.15, 1.3, 1.6])
    axes.contour(first, second, values, levels=levels, colors=figures.GREY, linewidths=0.7)
    axes.plot(*way.T, color=figures.BLUE, label="min-max estimate, η from 0 to τ")
    axes.plot(*start.estimate, "s", color=figures.BLACK, label="least squares, η = 0")
    axes.plot(*found.estimate, "o", color=figures.RED, label=f"min-max, η = {bound:.3g} ({found.case})")
    axes.plot(0, 0, "x", color=figures.BLACK, label="zero, η ≥ τ")
    title = f"contours of the worst-case residual, τ = {start.threshold:.3g}"
    axes.set(xlabel="x₁", ylabel="x₂", title=title, aspect="equal")
    axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
    return figure


def paint_bounds(matrix: np.ndarray, target: np.ndarray, consistent: np.ndarray):
    """The bound that belongs to every regularisation: outside data (b off the column space) and consistent ones."""
    figure, (left, right) = figures.new(1, 2, height=3.0)
    sides = ((left, target, "b outside the column space"), (right, consistent, "b in the column space"))
    for axes, goal, title in sides:
        function = secular_function(matrix, goal, 1.0)
        alpha = np.geomspace(1e-4, 1e4, 321) * function.eigenvalues[-1]
        axes.semilogx(alpha, alpha / function(alpha), label="η(α) = α |x| / |Ax − b|")
        axes.axhline(function.threshold, color=figures.BLACK, linestyle="--", linewidth=0.9)
        axes.text(alpha[0], function.threshold, " τ: zero from here on", va="bottom", fontsize=8)
        if function.excess == 0:
            axes.axhline(function.free_bound, color=figures.GREEN, linestyle="--", linewidth=0.9)
            # Below its line, since the curve passes above it.
            style = {"textcoords": "offset points", "va": "top", "ha": "right", "fontsize": 8}
            axes.annotate("least squares up to here ", (alpha[-1], function.free_bound), (0, -3), **style)
        axes.set(xlabel="α", ylabel="bound η (unit of A)", title=title, ylim=(0, 1.15 * function.threshold))
        axes.legend(loc="lower right")
    return figure


def paint_secular(matrix: np.ndarray, target: np.ndarray, shares: list[float]):
    """f(α) for several bounds; the fixed points are the regularisations."""
    figure, axes = figures.new(height=3.2)
    threshold = solve_silently(matrix, target, 0.0).threshold
    functions = [secular_function(matrix, target, share * threshold) for share in shares]
    roots = [function.root()[0] for function in functions]
    alpha = np.geomspace(min(roots) / 20, max(roots) * 20, 301)
    for share, function, root in zip(shares, functions, roots, strict=True):
        (line,) = axes.loglog(alpha, function(alpha), label=f"f(α), η = {share:g} τ")
        axes.loglog(root, root, "o", color=line.get_color(), label=f"root at η = {share:g} τ")
    axes.loglog(alpha, alpha, color=figures.BLACK, linewidth=0.8, label="α")
    axes.set(xlabel="α", ylabel="f(α)")
    axes.legend(ncols=2)
    return figure


def explore_geometry(share: float, noise: float):
    """`paint_two_unknowns` with the bound given as a share of the threshold."""
    matrix, target = sample_problem(1, 8, 2, noise)
    return paint_two_unknowns(matrix, target, share * solve_silently(matrix, target, 0.0).threshold)
