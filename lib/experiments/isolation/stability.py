"""Numerical stability of the covariance recursion (29): seven ways to write it, in any precision.

On paper they are one formula. In rounded arithmetic they differ in what becomes of an error of P that is
antisymmetric, and of one that makes P indefinite.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import (
    InputError,
    counted,
    require_array,
    require_choice,
    require_count,
    require_number,
)
from stillwork.base.kernels import borrowing_kernel, inlined_kernel
from stillwork.estimation import covariance_forms
from stillwork.estimation.covariance_forms import TRIANGLE, factor_of, update_covariance, update_form

# What one writes first, and what (29) prints; then the library's forms.
FORMS = ("one product", "both products", *covariance_forms.FORMS)
ONE_PRODUCT, BOTH_PRODUCTS = 0, 1
REGRESSORS = 9  # of the synthetic records, as the rig has
OVERFLOW = 1e100  # so large that its square is still a number


@dataclass(frozen=True)
class CovarianceRun:
    """What became of P, at equally spaced moments."""

    time_constants: Float64[np.ndarray, "kept"]  # samples seen times (1 - forgetting)
    asymmetry: Float64[np.ndarray, "kept"]  # norm of the antisymmetric part of P over that of P
    error: Float64[np.ndarray, "kept"]  # norm of P - R^-1, R the information matrix, over that of R^-1
    smallest: Float64[np.ndarray, "kept"]  # eigenvalue of (P + P')/2 over the smallest of R^-1
    distance: Float64[np.ndarray, "kept"]  # largest of |eigenvalue of P R - 1|; from 1 on P may be indefinite
    largest: Float64[np.ndarray, "kept"]  # eigenvalue of (P + P')/2 over the largest of the initial P

    @property
    def breakdown(self) -> float:
        """Time constants until P is first seen indefinite or not finite; infinite when it never is."""
        broken = ~(self.smallest > 0)
        return float(self.time_constants[np.argmax(broken)]) if broken.any() else float("inf")

    @property
    def worst(self) -> float:
        """Largest `distance`, at most one, the size of P: beyond it P means nothing, and its numbers are chaos."""
        return min(float(np.nanmax(self.distance)), 1.0)

    def breakdown_tens(self) -> float:
        """`breakdown` to tens: rounding errors decide it, and another processor's are of the same size alone."""
        return round(self.breakdown, -1) if np.isfinite(self.breakdown) else self.breakdown

    def growth_rate(self) -> float:
        """Growth rate of the asymmetry per time constant, fitted where it lies between 1e-12 and 1e-3."""
        inside = (self.asymmetry > 1e-12) & (self.asymmetry < 1e-3) & (self.time_constants < self.breakdown)
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
    """Run the covariance recursion over a record (n, samples), repeated for so many `time_constants`, and watch P.

    Of `FORMS`, ``one product`` is P - (g / den) g' with g = P psi; ``both products``, with P psi and psi' P computed
    apart as printed; the others are the library's, `covariance_forms`. P is looked at so often `per_time_constant`.
    """
    code = FORMS.index(require_choice("form", form, FORMS))
    dtype = np.dtype(require_choice("precision", precision, ("float64", "float32")))
    record = np.ascontiguousarray(require_array("regressors", regressors, ndim=2).T)
    n = record.shape[1]
    start = require_array("initial", initial, shape=(n, n))
    forgetting = require_number("forgetting", forgetting, above=0.0, below=1.0)
    step = int(1 / (1 - forgetting) / require_count("per_time_constant", per_time_constant))
    if not 0 < step <= len(record):
        raise InputError(
            f"regressors has {counted(len(record), 'sample')}; give at least {step}, or look more often"
        )

    matrix = (start if form in FORMS[:2] else factor_of(form, start)).astype(dtype)
    information, rounded = np.linalg.inv(start), float(dtype.type(forgetting))
    weights = rounded ** (np.arange(step)[::-1] / 2)
    # Rounded once for both, so that the error is the recursion's and not the data's.
    blocks = [record[at : at + step].astype(dtype) for at in range(0, len(record) - step + 1, step)]
    weighted = [block.astype(np.float64) * weights[:, None] for block in blocks]
    seen = [each.T @ each for each in weighted]
    rows = []
    for k in range(int(time_constants * per_time_constant)):
        at = k % len(blocks)
        recur(code, matrix, blocks[at], dtype.type(forgetting), np.empty(n, dtype), np.empty(n, dtype))
        information = rounded**step * information + seen[at]
        rows.append(((k + 1) * step * (1 - forgetting), *_health(form, matrix, information)))
        if not np.isfinite(rows[-1][2]):
            break
    table = np.array(rows).T
    table[5] /= np.linalg.eigvalsh(start)[-1]
    return CovarianceRun(*table)


def _health(form, matrix, information) -> tuple[float, ...]:
    covariance = matrix.astype(np.float64)
    if not np.all(np.abs(covariance) < OVERFLOW):
        return (np.nan,) * 5
    metric = np.linalg.cholesky(information)
    if form in ("square root", "UD", "inverse QR"):
        # A product has no negative eigenvalue; singular values keep the digits that forming it would lose.
        root = covariance if form == "square root" else covariance.T
        if form == "UD":
            root = (np.triu(root, 1) + np.eye(len(root))) * np.sqrt(np.diag(root))
        eigenvalues = np.linalg.svd(root, compute_uv=False)[::-1] ** 2
        relative = np.linalg.svd(metric.T @ root, compute_uv=False) ** 2
        covariance = root @ root.T
    else:
        eigenvalues = np.linalg.eigvalsh((covariance + covariance.T) / 2)
        relative = np.linalg.eigvalsh(metric.T @ (covariance + covariance.T) @ metric / 2)
    asymmetry = np.linalg.norm(covariance - covariance.T) / 2 / np.linalg.norm(covariance)
    exact = np.linalg.inv(information)
    error = np.linalg.norm(covariance - exact) / np.linalg.norm(exact)
    smallest = eigenvalues[0] * np.linalg.eigvalsh(information)[-1]
    return asymmetry, error, smallest, np.abs(relative - 1).max(), eigenvalues[-1]


def shared_motion(condition: float, samples: int, seed: int) -> np.ndarray:
    """Nine regressors of power one that share a motion, each with a rest of its own, (regressors, samples).

    The `condition` of their correlation is 1 + 9 c / (1 - c) for the share c of the power that is common.
    """
    ratio = (require_number("condition", condition, above=1.0) - 1) / REGRESSORS
    rng = np.random.default_rng(seed)
    common, own = rng.standard_normal(samples), rng.standard_normal((REGRESSORS, samples))
    return (np.sqrt(ratio) * common + own) / np.sqrt(1 + ratio)


def scaled_condition(regressors: ArrayLike) -> float:
    """Condition number of the regressors' correlation: of the information matrix in units that make its diagonal one."""
    return float(np.linalg.cond(np.corrcoef(require_array("regressors", regressors, ndim=2))))


def condition_bounds(forgetting: float, precision: str) -> tuple[float, float]:
    """Condition number up to which P stays definite for certain, and in the mean, but for a factor of order one.

    A sample rounds P by u times its size, and what was rounded before shrinks by lambda: the errors add up to
    u / (1 - lambda) of it where all have one sign, to u / sqrt(2 (1 - lambda)) where they are independent. P is
    indefinite when that reaches its smallest eigenvalue.
    """
    unit = float(np.finfo(precision).eps) / 2
    return (1 - forgetting) / unit, float(np.sqrt(2 * (1 - forgetting))) / unit


def steady_start(regressors: ArrayLike, forgetting: float) -> Float64[np.ndarray, "n n"]:
    """P that the recursion settles at; also of regressors that `steady_covariance` refuses."""
    psi = require_array("regressors", regressors, ndim=2)
    size = np.sqrt(np.mean(psi**2, axis=1))
    scaled = psi / size[:, None]
    inverse = np.linalg.inv(scaled @ scaled.T / scaled.shape[1]) / np.outer(size, size)
    return (1 - forgetting) * (inverse + inverse.T) / 2


def breakdowns_from_diagonal(
    regressors: ArrayLike, forgetting: float, forms, time_constants: float
) -> dict[str, float]:
    """Time constants to the breakdown of each form in float32, from the steady P of uncorrelated regressors."""
    psi = require_array("regressors", regressors, ndim=2)
    start = np.diag((1 - forgetting) / np.mean(psi**2, axis=1))
    return {
        form: covariance_run(form, psi, forgetting, start, time_constants, "float32").breakdown
        for form in forms
    }


def stability_map(
    conditions, precisions, forms, seeds: int, samples_per_constant: int, time_constants: float
) -> dict[tuple[str, str], Float64[np.ndarray, "2 conditions seeds"]]:
    """`worst` distance of P, and time constants to its breakdown, from the steady P on, by (precision, form)."""
    forgetting = float(np.exp(-1 / samples_per_constant))
    found = {each: np.empty((2, len(conditions), seeds)) for each in product(precisions, forms)}
    for i, condition in enumerate(conditions):
        for seed in range(seeds):
            psi = shared_motion(condition, samples_per_constant, seed)
            start = steady_start(psi, forgetting)
            for (precision, form), table in found.items():
                run = covariance_run(form, psi, forgetting, start, time_constants, precision, 2)
                table[:, i, seed] = run.worst, run.breakdown
    return found


def recur(form, matrix, regressors, forgetting, column, row):
    """Update what the form keeps over a block in place, in the arrays' precision."""
    # A kernel a form: asked at every sample for its form, the compiler would optimise none of them, and who looks at
    # one of them does not wait for the others. Those that keep a factor are functions of their own anyway.
    if form == ONE_PRODUCT:
        _one_products(matrix, regressors, forgetting, column)
    elif form == BOTH_PRODUCTS:
        _both_products(matrix, regressors, forgetting, column, row)
    elif form - 2 == TRIANGLE:
        _triangles(matrix, regressors, forgetting, column)
    else:
        _forms(form - 2, matrix, regressors, forgetting, column, row)


@borrowing_kernel
def _triangles(matrix, regressors, forgetting, column):
    for k in range(len(regressors)):
        update_covariance(matrix, regressors[k], forgetting, column)


@borrowing_kernel
def _forms(form, matrix, regressors, forgetting, column, row):
    for k in range(len(regressors)):
        update_form(form, matrix, regressors[k], forgetting, column, row)


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


@borrowing_kernel
def _one_products(matrix, regressors, forgetting, column):
    one, n = matrix.dtype.type(1), len(matrix)
    forget = one / forgetting
    for k in range(len(regressors)):
        shrink = one / _multiply(matrix, regressors[k], forgetting, column)
        for i in range(n):
            gain = column[i] * shrink
            for j in range(n):
                matrix[i, j] = (matrix[i, j] - gain * column[j]) * forget


@borrowing_kernel
def _both_products(matrix, regressors, forgetting, column, row):
    one, n = matrix.dtype.type(1), len(matrix)
    forget = one / forgetting
    for k in range(len(regressors)):
        psi = regressors[k]
        shrink = one / _multiply(matrix, psi, forgetting, column)
        for i in range(n):
            row[i] = matrix[0, i] * psi[0]
        for j in range(1, n):
            for i in range(n):
                row[i] += matrix[j, i] * psi[j]
        for i in range(n):
            gain = column[i] * shrink
            for j in range(n):
                matrix[i, j] = (matrix[i, j] - gain * row[j]) * forget
