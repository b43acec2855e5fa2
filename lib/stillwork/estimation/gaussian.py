"""What both Kalman filters share: a Cholesky root, and the correction of a Gaussian by a measurement.

Their workspace is a stack of square blocks, one a name below; the block MEANS holds vectors, one a row.
"""

import numpy as np

from stillwork.base.algebra import cholesky_root, cholesky_solve, minus_row, plus_row
from stillwork.base.checks import InputError, require_array
from stillwork.base.kernels import pasted_kernel

POINTS, OBSERVED, COVARIANCE, ROOT, INNOVATION, CROSS, GAIN, MEANS = range(8)
BLOCKS = 8
ESTIMATE, EXPECTED, MEASURED, SURPRISE, PAST = range(5)  # rows of MEANS


def require_covariance(name: str, value, size: int, *, definite: bool = True) -> np.ndarray:
    """Return a symmetric positive definite matrix from a matrix or from its diagonal, else raise `InputError`.

    Not `definite`: zero eigenvalues are allowed, for a process without noise.
    """
    matrix = require_array(name, value)
    if matrix.shape == (size,):
        matrix = np.diag(matrix)
    if matrix.shape != (size, size):
        raise InputError(f"{name} has shape {matrix.shape}; give {size} x {size}, or the {size} variances")
    scale = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > 1e-12 * scale:
        raise InputError(f"{name} is not symmetric; give a covariance, e.g. (C + C.T) / 2")
    smallest = np.linalg.eigvalsh(matrix)[0]
    if smallest < -1e-12 * scale or (definite and smallest <= 1e-15 * scale):
        wanted = "positive definite" if definite else "positive semidefinite"
        raise InputError(f"{name} is not {wanted} (eigenvalue {smallest:.3g}); give variances above zero")
    return np.ascontiguousarray(matrix)


@pasted_kernel
def correct_gaussian(work, size, outputs):
    """(17): gain = cross innovation^-1, mean += gain (z - expected), P -= gain innovation gain'."""
    covariance, root, means = work[COVARIANCE], work[ROOT], work[MEANS]
    cross, gain = work[CROSS, :, :outputs], work[GAIN, :, :outputs]
    surprise = means[SURPRISE]
    if not cholesky_root(work[INNOVATION], root, outputs):
        return False
    for j in range(outputs):
        surprise[j] = means[MEASURED, j] - means[EXPECTED, j]
    for i in range(size):
        cholesky_solve(root, cross[i], gain[i])
        means[ESTIMATE, i] = plus_row(means[ESTIMATE, i], gain, i, surprise)
        for j in range(i + 1):  # gain innovation gain' = cross gain'
            covariance[i, j] = covariance[j, i] = minus_row(covariance[i, j], cross, i, gain[j])
    return True
