"""Random problems on which the paper's statements are tried: trials for `workbook.studies.run_study`."""

import numpy as np

from stillwork.estimation.secular import SecularFunction, secular_function


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
