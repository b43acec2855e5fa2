"""What both Kalman filters share: a Cholesky root, and the correction of a Gaussian by a measurement.

Their workspace is a stack of square blocks, one a name below; the block MEANS holds vectors, one a row.
"""

import numpy as np

from stillwork.base.algebra import cholesky_root
from stillwork.base.checks import InputError, require_array
from stillwork.base.kernels import pasted_kernel

POINTS, OBSERVED, COVARIANCE, ROOT, INNOVATION, CROSS, GAIN, MEANS = range(8)
BLOCKS = 8
ESTIMATE, EXPECTED, MEASURED, SCRATCH, PAST = range(5)  # rows of MEANS


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
    covariance, innovation, cross = work[COVARIANCE], work[INNOVATION], work[CROSS]
    gain, root, means = work[GAIN], work[ROOT], work[MEANS]
    if not cholesky_root(innovation, root, outputs):
        return False
    for i in range(size):
        for j in range(outputs):
            total = cross[i, j]
            for k in range(j):
                total -= root[j, k] * means[SCRATCH, k]
            means[SCRATCH, j] = total / root[j, j]
        for j in range(outputs - 1, -1, -1):
            total = means[SCRATCH, j]
            for k in range(j + 1, outputs):
                total -= root[k, j] * gain[i, k]
            gain[i, j] = total / root[j, j]
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
