"""Random problems on which the paper's statements are tried: trials for `workbook.studies.run_study`."""

import numpy as np

from stillwork.estimation.secular import SecularFunction


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


def counter_example(bound: float, excess: float) -> SecularFunction:
    """Two unknowns, singular values 1 and 0.1, c = (1, 0.1): f is steep where the small one is being hidden."""
    return SecularFunction(np.array([1.0, 0.01]), np.array([1.0, 0.1]), float(excess), float(bound))
