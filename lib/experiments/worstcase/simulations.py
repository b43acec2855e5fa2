"""The simulations of Section 9: FIR identification (Fig. 1) and tracking (Fig. 2 and its variations).

The paper leaves open the true parameters and the square wave's period of Fig. 1, and the regressors, the
noise and the length of Fig. 2; what is assumed is a parameter here and named in the notebooks.
"""

import numpy as np

from stillwork.base.checks import InputError

FIG_2_PARAMETERS = (-0.0134, -0.0316, 0.0265, -0.0114, 0.0132)


def path(kind: str, parameters: tuple[float, ...], samples: int) -> np.ndarray:
    """True parameters along time, shape (unknowns, samples): ``constant``, ``jump`` or ``drift``.

    A jump changes the sign of all parameters at half of the record. A drift turns the first two parameters
    by one revolution along it.
    """
    parameters = np.asarray(parameters, float)
    values = np.repeat(parameters[:, None], samples, axis=1)
    if kind == "jump":
        values[:, samples // 2 :] *= -1
    elif kind == "drift" and len(parameters) > 1:
        angle, (first, second) = 2 * np.pi * np.arange(samples) / samples, parameters[:2]
        values[0] = np.cos(angle) * first - np.sin(angle) * second
        values[1] = np.sin(angle) * first + np.cos(angle) * second
    elif kind != "constant":
        raise InputError(f"kind is {kind!r}; use 'constant', 'jump' or, for two parameters or more, 'drift'")
    return values


def sample_problem(seed: int, rows: int, unknowns: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Data A, b with standard normal regressors, parameters 1, -1/2, 1/3, ... and Gaussian noise on b."""
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((rows, unknowns))
    truth = (-1.0) ** np.arange(unknowns) / np.arange(1.0, unknowns + 1)
    return matrix, matrix @ truth + noise * rng.standard_normal(rows)
