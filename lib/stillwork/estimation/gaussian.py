"""Shared by both Kalman filters: a Cholesky root, and the correction of a Gaussian by a measurement.

Their workspace is a stack of square blocks, one per name below; the block MEANS holds vectors, one per row.
"""

import numpy as np
from jaxtyping import Float64

from stillwork.base.algebra import cholesky_root, cholesky_solve
from stillwork.base.checks import InputError, require_array
from stillwork.base.kernels import pasted_kernel
from stillwork.base.validation import checked

POINTS, OBSERVED, COVARIANCE, ROOT, INNOVATION, CROSS, GAIN, MEANS = range(8)
BLOCKS = 8
ASYMMETRY, LEAST_DEFINITE = 1e-9, 1e-14  # of a covariance whose variances are 1
ESTIMATE, EXPECTED, MEASURED, _, PAST = range(5)  # rows of MEANS


def require_covariance(name: str, value, size: int, *, definite: bool = True) -> np.ndarray:
    """Return a symmetric positive definite matrix from a matrix or from its diagonal, else raise `InputError`.

    Not `definite`: zero eigenvalues are allowed, for a process without noise. It is judged in the deviations of its own
    elements, so that units do not matter.
    """
    matrix = require_array(name, value)
    if matrix.shape == (size,):
        matrix = np.diag(matrix)
    if matrix.shape != (size, size):
        raise InputError(f"{name} has shape {matrix.shape}; give {size} x {size}, or the {size} variances")
    scaled = in_deviations(matrix)
    if np.abs(scaled - scaled.T).max(initial=0.0) > ASYMMETRY:
        raise InputError(f"{name} is not symmetric; give a covariance, such as (C + C.T) / 2")
    smallest = np.linalg.eigvalsh(scaled)[0]
    if smallest < (LEAST_DEFINITE if definite else -ASYMMETRY):
        wanted = "positive definite" if definite else "positive semidefinite"
        raise InputError(
            f"{name} is not {wanted} (eigenvalue {smallest:.3g}, scaled); give a covariance of noise"
        )
    return matrix


@checked
def in_deviations(covariance: Float64[np.ndarray, "size size"]) -> Float64[np.ndarray, "size size"]:
    """A covariance over the deviations of its elements; where one has none, as it is."""
    deviation = np.sqrt(np.abs(np.diag(covariance)))
    deviation[deviation == 0] = 1.0
    return covariance / deviation / deviation[:, None]


@pasted_kernel
def correct_gaussian(work, size, outputs):
    """(17): gain = cross innovation^-1, mean += gain (z - expected), P -= gain innovation gain'."""
    covariance, innovation, cross = work[COVARIANCE], work[INNOVATION], work[CROSS]
    gain, root, means = work[GAIN], work[ROOT], work[MEANS]
    if not cholesky_root(innovation, root, outputs):
        return False
    for i in range(size):
        cholesky_solve(root, cross[i], gain[i, :outputs])
    for i in range(size):
        for j in range(outputs):
            means[ESTIMATE, i] += gain[i, j] * (means[MEASURED, j] - means[EXPECTED, j])
        for j in range(i + 1):  # gain innovation gain' = cross gain'
            total = covariance[i, j]
            for k in range(outputs):
                total -= cross[i, k] * gain[j, k]
            covariance[i, j] = total
            covariance[j, i] = total
    return True
