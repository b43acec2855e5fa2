"""Random problems on which the paper's statements are tried: trials for `workbook.studies.run_study`."""

import numpy as np
from numpy.typing import ArrayLike

from experiments.worstcase.rank_one import FastMinMax
from stillwork.estimation.min_max import solve_silently
from stillwork.estimation.recursive import run_silently
from stillwork.estimation.recursive_settings import MinMax
from stillwork.estimation.secular import SecularFunction, secular_function
from stillwork.identification.regressors import exponential_bound, exponential_weights


def random_problem(
    rng: np.random.Generator, unknowns: int, decades: float = 2.0, noise: tuple[float, float] = (-2.0, 0.0)
) -> tuple[np.ndarray, np.ndarray, float]:
    """A, b and the threshold |A'b| / |b|: columns over up to so many decades, the noise's between two powers of ten."""
    rows = unknowns + int(rng.integers(1, 30))
    matrix = rng.standard_normal((rows, unknowns)) * 10.0 ** (-decades * rng.random() * rng.random(unknowns))
    low, high = noise
    deviation = 10.0 ** (low + (high - low) * rng.random())
    target = matrix @ rng.standard_normal(unknowns) + deviation * rng.standard_normal(rows)
    return matrix, target, float(np.linalg.norm(matrix.T @ target) / np.linalg.norm(target))


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


def weighting_trial(rng: np.random.Generator, row_error: float, forgetting: float, samples: int) -> dict:
    """Section 5: norm of the weighted perturbation, rows within `row_error`, over the sum and over its limit."""
    unknowns = int(rng.integers(1, 7))
    rows = rng.standard_normal((samples, unknowns)) + rng.uniform(0, 3) * rng.standard_normal(unknowns)
    rows *= row_error / np.linalg.norm(rows, axis=1, keepdims=True)
    rows *= exponential_weights(samples, forgetting)[:, None]
    size = np.linalg.norm(rows, 2)
    return {
        "over_sum": size / exponential_bound(row_error, forgetting, samples),
        "over_limit": size / exponential_bound(row_error, forgetting),
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


def counter_example(bound: float, excess: float) -> SecularFunction:
    """Two unknowns, singular values 1 and 0.1, c = (1, 0.1): f is steep where the small one is being hidden."""
    return SecularFunction(np.array([1.0, 0.01]), np.array([1.0, 0.1]), float(excess), float(bound))


def recursion_trial(
    rng: np.random.Generator, truth: np.ndarray, bound: float, forgetting: float, noise: float
) -> dict[str, np.ndarray]:
    """All min-max updates on one record, with white regressors of unit variance, beside the batch solution at every step.

    ``exact``, ``fast``, ``approximate_1`` to ``_3``: distance of the estimates from batch, over the largest norm of
    the batch estimates. ``alpha_1`` to ``alpha_3``: relative error of alpha, NaN where x = 0. ``alpha``: the batch
    alpha. ``size`` and ``size_*``: norms of the estimates. ``as_printed`` and ``corrected``: relative distance of h
    (15) from its definition with alpha_t and with lam alpha_t. ``image_as_printed`` and ``image_corrected``: the same
    of eq. (17) from f(alpha_t) and from f(lam alpha_t).
    """
    unknowns, samples = truth.shape
    regressors = rng.standard_normal((unknowns, samples))
    outputs = np.sum(regressors * truth, axis=0) + noise * rng.standard_normal(samples)
    batch = np.zeros((unknowns, samples))
    alphas = np.full(samples, np.inf)
    weighted = []
    for t in range(samples):
        weights = exponential_weights(t + 1, forgetting)
        weighted.append((regressors[:, : t + 1].T * weights[:, None], outputs[: t + 1] * weights))
        if t >= unknowns:
            found = solve_silently(*weighted[t], bound)
            batch[:, t], alphas[t] = found.estimate, found.alpha
    sizes = np.linalg.norm(batch, axis=0)
    scale = sizes.max() or 1.0  # where the bound leaves no estimate but zero
    settings = {"exact": MinMax(bound, forgetting), "fast": FastMinMax(bound, forgetting)}
    settings |= {f"approximate_{k}": MinMax(bound, forgetting, "approximate", k) for k in (1, 2, 3)}
    found = {"alpha": np.where(np.isfinite(alphas), alphas, np.nan), "size": sizes}
    for name, estimator in settings.items():
        track = run_silently(estimator, regressors, outputs)
        found[name] = np.linalg.norm(track.estimates - batch, axis=0) / scale
        found[f"size_{name}"] = np.linalg.norm(track.estimates, axis=0)
        if estimator.update == "approximate":
            ours = np.where(np.isfinite(track.alphas), track.alphas, np.nan)
            found[f"alpha_{estimator.iterations}"] = np.abs(ours / found["alpha"] - 1)
    for name in ("as_printed", "corrected", "image_as_printed", "image_corrected"):
        found[name] = np.full(samples, np.nan)
    for t in range(unknowns, samples - 1):
        if np.isfinite(alphas[t]):
            _one_update(found, t, weighted, batch[:, t], alphas[t], bound, forgetting)
    return found


def _one_update(found, t, weighted, estimate, alpha, bound, forgetting):
    # h by (15), its image by (17), and what they stand for with alpha_t (as printed) and with lam alpha_t
    (matrix, _), (later, target) = weighted[t], weighted[t + 1]
    identity = np.eye(len(estimate))
    inverse = np.linalg.inv(matrix.T @ matrix + alpha * identity)
    row, output = later[-1], target[-1]
    gain = inverse @ row / (forgetting + row @ inverse @ row)
    h = estimate + gain * (output - row @ estimate)
    image = bound * np.linalg.norm(later @ h - target) / np.linalg.norm(h)
    for name, start in (("as_printed", alpha), ("corrected", forgetting * alpha)):
        defined = np.linalg.solve(later.T @ later + start * identity, later.T @ target)
        found[name][t + 1] = np.linalg.norm(h - defined) / np.linalg.norm(h)
        direct = bound * np.linalg.norm(later @ defined - target) / np.linalg.norm(defined)
        found[f"image_{name}"][t + 1] = abs(image / direct - 1)


def solve_cone_program(matrix: ArrayLike, target: ArrayLike, bound: float) -> tuple[np.ndarray, float]:
    """Minimise |A x - b| + eta |x| (2) as a second-order cone program, by cvxpy and Clarabel: the estimate and its cost.

    It shares no code and no formula with `min_max_solve`. Compare costs, not estimates: near the minimum
    the cost is flat, and a solver that is right to 1e-8 in cost is right to 1e-4 in x.
    """
    import cvxpy

    matrix = np.asarray(matrix, float)
    target = np.asarray(target, float)
    unknown = cvxpy.Variable(matrix.shape[1])
    cost = cvxpy.norm(matrix @ unknown - target, 2) + bound * cvxpy.norm(unknown, 2)
    cvxpy.Problem(cvxpy.Minimize(cost)).solve(solver=cvxpy.CLARABEL)
    estimate = np.asarray(unknown.value, dtype=float)
    return estimate, float(np.linalg.norm(matrix @ estimate - target) + bound * np.linalg.norm(estimate))
