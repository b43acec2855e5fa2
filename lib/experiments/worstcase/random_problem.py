"""A random least-squares problem, as small as an example needs."""

import numpy as np


def sample_problem(seed: int, rows: int, unknowns: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Data A, b with standard normal regressors, parameters 1, -1/2, 1/3, ... and Gaussian noise on b."""
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, unknowns))
    truth = (-1.0) ** np.arange(unknowns) / np.arange(1.0, unknowns + 1)
    return matrix, matrix @ truth + noise * rng.standard_normal(rows)
