"""Units of the states in which a model's matrices are of one size."""

import numpy as np
from jaxtyping import Float64
from scipy import linalg

from stillwork.base.validation import checked


@checked
def state_scale(
    a: Float64[np.ndarray, "states states"],
    b: Float64[np.ndarray, "states inputs"],
    c: Float64[np.ndarray, "outputs states"],
) -> Float64[np.ndarray, " states"]:
    """Units of the states that balance A, B and C together, in the units that B and C are given in.

    A alone does not determine the scale of a rigid body. The balanced model is ``a * s / s[:, None]``, ``b / s[:, None]``, ``c * s``.
    """
    n, size = len(a), max(b.shape[1], len(c))
    whole = np.zeros((n + size, n + size))
    whole[:n, :n], whole[:n, n : n + b.shape[1]], whole[n : n + len(c), :n] = a, b, c
    _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    return scale[:n]
