"""Pictures of the min-max problem for one and two unknowns, and of its secular equation."""

import numpy as np
from numpy.typing import ArrayLike

from experiments.worstcase.simulations import sample_problem
from experiments.worstcase.theory import random_problem
from stillwork.estimation.min_max import solve_silently
from stillwork.estimation.secular import secular_function
from stillwork.lti.cones import minimise
from workbook import figures


def solution_trial(rng: np.random.Generator, perturbations: int) -> dict[str, float]:
    """Theorem 1 on one problem: cost against the cone program's, (6), the zero case, the worst perturbation.

    ``share``: bound over threshold. ``cost``: relative distance of the costs. ``identity``: relative
    residual of (6). ``crossings``: sign changes of alpha - f(alpha) over 24 decades. ``zero_agrees``: 1
    when the estimate is zero exactly for a bound above the threshold and the cone program agrees (to 1e-6
    of |b| in A x). ``attained``: relative distance of the worst perturbation's residual from (2).
    ``exceeded``: largest of the random perturbations' residuals over (2). ``several``: 1 with more than
    one unknown and a nonzero estimate.
    """
    matrix, target, threshold = random_problem(rng, int(rng.integers(1, 7)))
    bound = threshold * 10.0 ** rng.uniform(-1.5, 0.15)
    found = solve_silently(matrix, target, bound)
    other, cost = solve_cone_program(matrix, target, bound)
    residual = matrix @ found.estimate - target
    length = np.linalg.norm(found.estimate)
    size = np.linalg.norm(target)
    vanishes = np.linalg.norm(matrix @ other) < 1e-6 * size
    directions = rng.standard_normal((perturbations, *matrix.shape))
    directions *= bound / np.linalg.norm(directions, 2, axis=(1, 2))[:, None, None]
    sampled = np.linalg.norm((matrix + directions) @ found.estimate - target, axis=1)
    attained = np.linalg.norm((matrix + found.perturbation) @ found.estimate - target)
    identity, crossings = 0.0, 1
    if length > 0:
        identity = found.alpha * length / (bound * np.linalg.norm(residual)) - 1
        function = secular_function(matrix, target, bound)
        alphas = function.eigenvalues[0] * np.geomspace(1e-12, 1e12, 2401)
        crossings = np.count_nonzero(np.diff(np.sign(alphas - function(alphas))))
    return {
        "share": bound / threshold,
        "cost": abs(found.worst_case_residual / cost - 1),
        "identity": abs(identity),
        "zero_agrees": float((bound >= threshold) == (length == 0) == vanishes),
        "attained": abs(attained / found.worst_case_residual - 1),
        "exceeded": float(sampled.max() / found.worst_case_residual),
        "crossings": float(crossings),
        "several": float(matrix.shape[1] > 1 and length > 0),
    }


def non_unique_trial(rng: np.random.Generator) -> dict[str, float]:
    """Section 2's degenerate case: b along one singular direction of A, and the bound that singular value.

    Costs |A x - b| + eta |x| of the estimates between zero and least squares: ``spread``, largest less smallest over
    the smallest; ``solver``, that of `min_max_solve` over it, less 1; ``elsewhere``, smallest of 100 other estimates
    over it, less 1.
    """
    rows = int(rng.integers(3, 20))
    unknowns = int(rng.integers(2, rows))
    matrix = rng.standard_normal((rows, unknowns))
    left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
    k = int(rng.integers(unknowns))
    target, least, bound = sizes[k] * left[:, k], right[k], sizes[k]

    def cost(x):
        return np.linalg.norm(matrix @ x - target) + bound * np.linalg.norm(x)

    between = np.array([cost(share * least) for share in np.linspace(0, 1, 21)])
    elsewhere = min(cost(rng.random() * least + 0.1 * rng.standard_normal(unknowns)) for _ in range(100))
    solved = cost(solve_silently(matrix, target, bound).estimate)
    return {
        "spread": np.ptp(between) / between.min(),
        "solver": solved / between.min() - 1,
        "elsewhere": elsewhere / between.min() - 1,
    }


def solve_cone_program(matrix: ArrayLike, target: ArrayLike, bound: float) -> tuple[np.ndarray, float]:
    """Minimise |A x - b| + eta |x| (2) as a second-order cone program, by Clarabel: the estimate and its cost.

    It shares no code and no formula with `min_max_solve`. Compare costs, not estimates: near the minimum
    the cost is flat, and a solver that is right to 1e-8 in cost is right to 1e-4 in x.
    """
    matrix = np.asarray(matrix, float)
    target = np.asarray(target, float)
    n = matrix.shape[1]

    def parts(x: np.ndarray) -> list[np.ndarray]:
        """The estimate is followed by bounds of both lengths."""
        return [np.r_[x[n], matrix @ x[:n] - target], np.r_[x[n + 1], x[:n]]]

    estimate = minimise(np.r_[np.zeros(n), 1.0, bound], parts)[0][:n]
    return estimate, float(np.linalg.norm(matrix @ estimate - target) + bound * np.linalg.norm(estimate))


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
        axes.text(alpha[0], 1.01 * function.threshold, " τ: zero from here on", va="bottom", fontsize=8)
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
