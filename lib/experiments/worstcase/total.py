"""Total least squares, which the paper compares with in Fig. 1: both A and b may be corrected."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array


@dataclass(frozen=True)
class TotalLeastSquaresSolution:
    """Smallest correction of [A b] that makes (A + dA) x = b + db solvable."""

    estimate: Float64[np.ndarray, " unknowns"]  # x
    matrix_correction: Float64[np.ndarray, "rows unknowns"]  # dA, in the unit of A
    target_correction: Float64[np.ndarray, " rows"]  # db, in the unit of b


def total_least_squares(matrix: ArrayLike, target: ArrayLike) -> TotalLeastSquaresSolution:
    """Total least squares by the SVD of [A b] (Golub and Van Loan, Matrix Computations, section 6.3).

    A and b are taken as equally noisy, so scale them to be so. Where the smallest correction lies in A alone there is
    no solution.
    """
    matrix = require_array("matrix", matrix, ndim=2)
    rows, unknowns = matrix.shape
    target = require_array("target", target, shape=(rows,))
    if rows <= unknowns:
        raise InputError(f"matrix has {rows} rows for {unknowns} unknowns; give more rows than unknowns")
    left, singular, right = np.linalg.svd(np.column_stack([matrix, target]), full_matrices=False)
    direction = right[-1]
    if abs(direction[-1]) <= 1e-12:
        raise InputError(
            "total least squares has no solution here: the smallest singular vector of [matrix target] does "
            "not touch target; remove linearly dependent columns of matrix"
        )
    correction = -singular[-1] * np.outer(left[:, -1], direction)
    return TotalLeastSquaresSolution(
        -direction[:-1] / direction[-1],
        np.ascontiguousarray(correction[:, :-1]),
        np.ascontiguousarray(correction[:, -1]),
    )
