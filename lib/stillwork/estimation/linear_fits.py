"""A linear relation from one block of rows: penalties that follow from the data, and estimates for flawed rows.

All of them but Huber's are the same for any orthogonal transformation of the rows, so for the triangle of a QR
decomposition, too.
"""

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Matrix, Vector
from stillwork.base.checks import InputError, pluralise, require_array
from stillwork.base.validation import checked
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel, estimate

# Deviations, beyond which an error counts less: 95 % as good as least squares in Gaussian noise.
HUBER = 1.345
PENALTIES = np.geomspace(1e-10, 1e6, 321)  # over the largest squared singular value


def _spectrum(matrix, target) -> tuple[np.ndarray, np.ndarray, float]:
    """Squared singular values, squared coordinates of the target along them, and what of its square lies outside."""
    target = require_array("target", target, shape=(len(matrix),))
    left, sizes, _ = np.linalg.svd(matrix, full_matrices=False)
    along = (left.T @ target) ** 2
    return sizes**2, along, max(float(target @ target - along.sum()), 0.0)


@checked
def cross_validated_penalty(matrix: Matrix, target: Vector, samples: float) -> float:
    """Penalty with the smallest generalised cross-validation |A x - b|^2 / (samples - trace)^2, on a grid.

    Golub, Heath and Wahba (1979); `samples` counts the rows of weighted data, all of them or the memory.
    """
    squares, along, outside = _spectrum(matrix, target)
    penalties = squares[0] * PENALTIES
    kept = squares / (squares + penalties[:, None])
    scores = (((1 - kept) ** 2) @ along + outside) / (samples - kept.sum(axis=1)) ** 2
    return float(penalties[scores.argmin()])


@checked
def evidence_penalty(matrix: Matrix, target: Vector, samples: float) -> float:
    """Penalty with the largest evidence for parameters and noise of unknown variances (MacKay, 1992), on a grid."""
    squares, along, outside = _spectrum(matrix, target)
    penalties = squares[0] * PENALTIES
    shrunk = penalties[:, None] / (squares + penalties[:, None])
    misfit = shrunk @ along + outside  # |A x - b|^2 + penalty |x|^2
    score = samples * np.log(misfit) - np.log(shrunk).sum(axis=1)
    return float(penalties[score.argmin()])


@checked
def huber_estimate(matrix: Matrix, target: Vector, weights: Vector) -> Float64[np.ndarray, " unknowns"]:
    """Huber's estimate by reweighting, its scale the weighted median of |residuals| over 0.6745; `weights` of squares."""
    target = require_array("target", target, shape=(len(matrix),))
    counted = weights = require_array("weights", weights, shape=(len(matrix),))
    for _ in range(20):
        root = np.sqrt(counted)
        found = np.linalg.lstsq(root[:, None] * matrix, root * target)[0]
        sizes = np.abs(target - matrix @ found)
        order = np.argsort(sizes)
        middle = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
        limit = HUBER * sizes[order[min(middle, len(order) - 1)]] / 0.6745
        counted = weights * np.minimum(1.0, limit / np.maximum(sizes, 1e-300))
        if not counted.any():  # half of the rows are met exactly
            break
    return found


@checked
def instrumental_variables(
    matrix: Matrix, target: Vector, instruments: Matrix
) -> Float64[np.ndarray, " unknowns"]:
    """Two-stage least squares: rows are replaced by their projection on the instruments (Söderström and Stoica, 1983)."""
    target = require_array("target", target, shape=(len(matrix),))
    instruments = require_array("instruments", instruments, shape=(len(matrix), None))
    explained = instruments @ np.linalg.lstsq(instruments, matrix, rcond=None)[0]
    return np.linalg.lstsq(explained, target)[0]


@checked
def total_least_squares(matrix: Matrix, target: Vector) -> Float64[np.ndarray, " unknowns"]:
    """The x for which the smallest correction of [A b] makes (A + dA) x = b + db solvable, by its SVD.

    A and b are taken as equally noisy, so scale them to be so. Where the smallest correction lies in A alone there is
    no solution (Golub and Van Loan, Matrix Computations, section 6.3).
    """
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


@checked
def hinfinity_model(
    matrix: Matrix, variance: float, covariance: Matrix, forgetting: float
) -> TimeVaryingModel:
    """Constant parameters of a `covariance` as a state that is seen through the rows; sample 0 is the start.

    Forgetting is the growth of the state times forgetting^(-t/2) (Sayed and Kailath, 1994).
    """
    taps = matrix.shape[1]
    none, one = np.zeros((taps, 1)), np.ones((1, 1))
    seen = np.concatenate([np.zeros((1, 1, taps)), matrix[:, None]])
    growth = np.eye(taps) / np.sqrt(forgetting)
    return TimeVaryingModel(growth, none, none, seen, one, variance * one, covariance)


@checked
def last_estimate(gains: FilterGains, target: Vector, forgetting: float) -> Float64[np.ndarray, " unknowns"]:
    """The parameters of a `hinfinity_model` after its last row: its state, which has grown, taken back."""
    samples = len(target) + 1
    scale = forgetting ** (-np.arange(samples) / 2)
    outputs = scale * np.append(0.0, target)
    return estimate(gains, np.zeros((1, samples)), outputs[None])[:, -1] / scale[-1]


@checked
def hinfinity_estimate(
    matrix: Matrix,
    target: Vector,
    variance: float,
    size: float,
    forgetting: float = 1.0,
) -> Float64[np.ndarray, " unknowns"]:
    """The parameters at the end by the a-posteriori H-infinity filter of all of them, near its smallest level.

    `variance` is that of the noise, `size` the squared norm of the parameters; the level is 1.1
    times the smallest that there is. Hassibi, Sayed and Kailath (1999), chapter 4.
    """
    wanted = np.eye(matrix.shape[1])
    model = hinfinity_model(matrix, variance, size * wanted / len(wanted), forgetting)
    gains = hinfinity_gains(model, wanted, 1.1 * smallest_level(model, wanted, 1e-2))
    return last_estimate(gains, target, forgetting)
