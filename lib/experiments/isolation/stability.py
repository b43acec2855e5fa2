"""Numerical stability of the covariance recursion (29): five ways to write it, in any precision.

On paper they are one formula. In rounded arithmetic they differ in what becomes of an error of P that is
antisymmetric, and of one that makes P indefinite.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array, require_choice, require_count, require_number
from stillwork.base.kernels import inlined_kernel, kernel

FORMS = ("one product", "both products", "triangle", "Joseph", "square root")
OVERFLOW = 1e100  # so large that its square is still a number
ONE_PRODUCT, BOTH_PRODUCTS, TRIANGLE, JOSEPH, SQUARE_ROOT = range(5)


@dataclass(frozen=True)
class CovarianceRun:
    """What became of P, at equally spaced moments.

    Attributes
    ----------
    time_constants : ndarray, shape (kept,)
        Samples seen times (1 - forgetting).
    asymmetry : ndarray, shape (kept,)
        Norm of the antisymmetric part of P over the norm of P.
    error : ndarray, shape (kept,)
        Norm of P minus the inverse of the information matrix, over the norm of that inverse.
    smallest : ndarray, shape (kept,)
        Smallest eigenvalue of the symmetric part of P in units of the inverse's smallest; negative: indefinite.
    largest : ndarray, shape (kept,)
        Largest eigenvalue of the symmetric part over that of the initial P.
    """

    time_constants: Float64[np.ndarray, "kept"]
    asymmetry: Float64[np.ndarray, "kept"]
    error: Float64[np.ndarray, "kept"]
    smallest: Float64[np.ndarray, "kept"]
    largest: Float64[np.ndarray, "kept"]

    @property
    def breakdown(self) -> float:
        """Time constants until P is first seen indefinite or not finite; infinite when it never is."""
        broken = ~(self.smallest > 0)
        return float(self.time_constants[np.argmax(broken)]) if broken.any() else float("inf")

    def breakdown_tens(self) -> float:
        """`breakdown` to tens: rounding errors decide it, and another processor's are of the same size alone."""
        return round(self.breakdown, -1) if np.isfinite(self.breakdown) else self.breakdown

    def growth_rate(self, low: float = 1e-12, high: float = 1e-3) -> float:
        """Growth rate of the asymmetry per time constant, fitted where it lies between `low` and `high`."""
        inside = (self.asymmetry > low) & (self.asymmetry < high) & (self.time_constants < self.breakdown)
        if inside.sum() < 3:
            return 0.0
        return float(np.polyfit(self.time_constants[inside], np.log(self.asymmetry[inside]), 1)[0])


def covariance_run(
    form: str,
    regressors: ArrayLike,
    forgetting: float,
    initial: ArrayLike,
    time_constants: float,
    precision: str = "float64",
    per_time_constant: int = 4,
) -> CovarianceRun:
    """Run the covariance recursion over a record, again and again, and watch P.

    Parameters
    ----------
    form : str
        One of `FORMS`: ``one product``, P - (g / den) g' with g = P psi; ``both products``, with P psi and
        psi' P computed apart as printed; ``triangle``, one triangle and its mirror image; ``Joseph``; ``square
        root`` after Potter.
    regressors : array_like, shape (n, samples)
        psi_N; the record is repeated as often as needed.
    forgetting : float
        lambda in (0, 1).
    initial : array_like, shape (n, n)
        P(-1).
    time_constants : float
        How long to run, in units of 1 / (1 - lambda) samples.
    precision : str
        ``float64`` or ``float32``.
    per_time_constant : int
        How often to look at P.
    """
    code = FORMS.index(require_choice("form", form, FORMS))
    dtype = np.dtype(require_choice("precision", precision, ("float64", "float32")))
    record = np.ascontiguousarray(require_array("regressors", regressors, ndim=2).T)
    n = record.shape[1]
    start = require_array("initial", initial, shape=(n, n))
    forgetting = require_number("forgetting", forgetting, above=0.0, below=1.0)
    step = int(1 / (1 - forgetting) / require_count("per_time_constant", per_time_constant))
    if not 0 < step <= len(record):
        raise InputError(f"regressors has {len(record)} samples; give at least {step}, or look more often")

    matrix = (np.linalg.cholesky(start) if code == SQUARE_ROOT else start).astype(dtype)
    information, rounded = np.linalg.inv(start), float(dtype.type(forgetting))
    weights = rounded ** (np.arange(step)[::-1] / 2)
    rows, place = [], 0
    for k in range(int(time_constants * per_time_constant)):
        place = 0 if place + step > len(record) else place
        # Rounded once for both, so that the error is the recursion's and not the data's.
        block = record[place : place + step].astype(dtype)
        place += step
        _recur(code, matrix, block, dtype.type(forgetting), np.empty((3, n), dtype))
        weighted = block.astype(np.float64) * weights[:, None]
        information = rounded**step * information + weighted.T @ weighted
        rows.append(((k + 1) * step * (1 - forgetting), *_health(code, matrix, information)))
        if not np.isfinite(rows[-1][2]):
            break
    table = np.array(rows).T
    table[4] /= np.linalg.eigvalsh(start)[-1]
    return CovarianceRun(*table)


def _health(code, matrix, information) -> tuple[float, float, float, float]:
    covariance = matrix.astype(np.float64)
    if not np.all(np.abs(covariance) < OVERFLOW):
        return np.nan, np.nan, np.nan, np.nan
    if code == SQUARE_ROOT:
        # S S' has no negative eigenvalue; singular values keep the digits that forming it would lose.
        eigenvalues = np.linalg.svd(covariance, compute_uv=False)[::-1] ** 2
        covariance = covariance @ covariance.T
    else:
        eigenvalues = np.linalg.eigvalsh((covariance + covariance.T) / 2)
    asymmetry = np.linalg.norm(covariance - covariance.T) / 2 / np.linalg.norm(covariance)
    exact = np.linalg.inv(information)
    error = np.linalg.norm(covariance - exact) / np.linalg.norm(exact)
    return asymmetry, error, eigenvalues[0] * np.linalg.eigvalsh(information)[-1], eigenvalues[-1]


@kernel
def _recur(form, matrix, regressors, forgetting, scratch):
    """Update P, or its factor for the square root, over a block in place, in the arrays' precision."""
    # A loop a form: asked at every sample for its form, the compiler would optimise none of them.
    if form == ONE_PRODUCT:
        for k in range(len(regressors)):
            _one_product(matrix, regressors[k], forgetting, scratch)
    elif form == BOTH_PRODUCTS:
        for k in range(len(regressors)):
            _both_products(matrix, regressors[k], forgetting, scratch)
    elif form == TRIANGLE:
        for k in range(len(regressors)):
            _triangle(matrix, regressors[k], forgetting, scratch)
    elif form == JOSEPH:
        for k in range(len(regressors)):
            _joseph(matrix, regressors[k], forgetting, scratch)
    else:
        for k in range(len(regressors)):
            _square_root(matrix, regressors[k], forgetting, scratch)


@inlined_kernel
def _multiply(matrix, psi, forgetting, column):
    """P psi into `column`; returns lambda + psi' P psi."""
    n = len(psi)
    denominator = forgetting
    for i in range(n):
        total = matrix[i, 0] * psi[0]
        for j in range(1, n):
            total += matrix[i, j] * psi[j]
        column[i] = total
        denominator += psi[i] * total
    return denominator


@inlined_kernel
def _multiply_left(matrix, psi, row):
    """psi' P into `row`."""
    n = len(psi)
    for i in range(n):
        total = matrix[0, i] * psi[0]
        for j in range(1, n):
            total += matrix[j, i] * psi[j]
        row[i] = total


@inlined_kernel
def _one_product(matrix, psi, forgetting, scratch):
    one, n, column = matrix.dtype.type(1), len(psi), scratch[0]
    shrink = one / _multiply(matrix, psi, forgetting, column)
    forget = one / forgetting
    for i in range(n):
        gain = column[i] * shrink
        for j in range(n):
            matrix[i, j] = (matrix[i, j] - gain * column[j]) * forget


@inlined_kernel
def _both_products(matrix, psi, forgetting, scratch):
    one, n, column, row = matrix.dtype.type(1), len(psi), scratch[0], scratch[1]
    shrink = one / _multiply(matrix, psi, forgetting, column)
    forget = one / forgetting
    _multiply_left(matrix, psi, row)
    for i in range(n):
        gain = column[i] * shrink
        for j in range(n):
            matrix[i, j] = (matrix[i, j] - gain * row[j]) * forget


@inlined_kernel
def _triangle(matrix, psi, forgetting, scratch):
    one, n, column = matrix.dtype.type(1), len(psi), scratch[0]
    shrink = one / _multiply(matrix, psi, forgetting, column)
    forget = one / forgetting
    for i in range(n):
        gain = column[i] * shrink
        for j in range(i + 1):
            matrix[i, j] = (matrix[i, j] - gain * column[j]) * forget
            matrix[j, i] = matrix[i, j]


@inlined_kernel
def _joseph(matrix, psi, forgetting, scratch):
    """(I - k psi') P (I - k psi')' / lambda + k k' with k = P psi / den."""
    one, n, column, row, back = matrix.dtype.type(1), len(psi), scratch[0], scratch[1], scratch[2]
    shrink = one / _multiply(matrix, psi, forgetting, column)
    forget = one / forgetting
    _multiply_left(matrix, psi, row)
    for i in range(n):
        column[i] *= shrink
        gain = column[i]
        for j in range(n):
            matrix[i, j] -= gain * row[j]
        total = matrix[i, 0] * psi[0]
        for j in range(1, n):
            total += matrix[i, j] * psi[j]
        back[i] = total
    for i in range(n):
        gain, rest = column[i], back[i]
        for j in range(n):
            matrix[i, j] = (matrix[i, j] - rest * column[j]) * forget + gain * column[j]


@inlined_kernel
def _square_root(factor, psi, forgetting, scratch):
    """Potter's update of S with P = S S'."""
    one = factor.dtype.type(1)
    n = len(psi)
    inner, outer = scratch[0], scratch[1]
    denominator = forgetting
    for j in range(n):
        inner[j] = factor[0, j] * psi[0]
        for i in range(1, n):
            inner[j] += factor[i, j] * psi[i]
        denominator += inner[j] * inner[j]
    share = one / (denominator + np.sqrt(forgetting * denominator))
    forget = one / np.sqrt(forgetting)
    for i in range(n):
        outer[i] = factor[i, 0] * inner[0]
        for j in range(1, n):
            outer[i] += factor[i, j] * inner[j]
        outer[i] *= share
    for i in range(n):
        for j in range(n):
            factor[i, j] = (factor[i, j] - outer[i] * inner[j]) * forget
