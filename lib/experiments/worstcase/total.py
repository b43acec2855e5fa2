"""Total least squares, which the paper compares with in Fig. 1: both A and b may be corrected."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, pluralise, require_array


def total_least_squares(matrix: ArrayLike, target: ArrayLike) -> Float64[np.ndarray, " unknowns"]:
    """The x for which the smallest correction of [A b] makes (A + dA) x = b + db solvable, by its SVD.

    A and b are taken as equally noisy, so scale them to be so. Where the smallest correction lies in A alone there is
    no solution (Golub and Van Loan, Matrix Computations, section 6.3).
    """
    matrix = require_array("matrix", matrix, ndim=2)
    rows, unknowns = matrix.shape
    target = require_array("target", target, shape=(rows,))
    if rows <= unknowns:
        raise InputError(
            f"matrix has {pluralise(rows, 'row')} for {pluralise(unknowns, 'unknown')}; give more rows than unknowns"
        )
    direction = np.linalg.svd(np.column_stack([matrix, target]), full_matrices=False)[2][-1]
    if abs(direction[-1]) <= 1e-12:
        raise InputError(
            "total least squares has no solution here: the smallest singular vector of [matrix target] does "
            "not touch target; remove linearly dependent columns of matrix"
        )
    return -direction[:-1] / direction[-1]
