"""Two forms of the covariance recursion of recursive least squares, one formula in exact arithmetic.

    P <- (P - g g' / den) / lambda,   g = P psi,   den = lambda + psi' g

What a form stores, in one square array: P itself (``triangle``), or U D U' (``UD``, Bierman) with D on the diagonal and
column j of U in row j. Factors have half as many digits to lose, and no product of them is indefinite. Notebook
isolation/07 compares them with five others. All kernels work in the precision of their arrays.

References
----------
Bierman, Factorization Methods for Discrete Sequential Estimation (1977).
"""

from typing import Annotated

import numpy as np

from stillwork.base.algebra import copy_vector, plus_left, project
from stillwork.base.bounds import one_of
from stillwork.base.checks import InputError, require_choice
from stillwork.base.kernels import borrowing_kernel, inlined_kernel, pasted_kernel
from stillwork.base.validation import checked

FORMS = ("triangle", "UD")


@checked
def factor_of(form: Annotated[str, one_of(FORMS)], covariance: np.ndarray) -> np.ndarray:
    """The array that a form stores for a covariance P, in the precision of P."""
    if covariance.ndim != 2 or covariance.shape[0] != covariance.shape[1]:
        raise InputError(f"covariance has shape {covariance.shape}; give a square one")
    if form == "triangle":
        return covariance.copy()
    upper = upper_root(covariance)
    root = np.diag(upper)
    return (upper / root).T - np.eye(len(root)) + np.diag(root**2)


def upper_root(covariance: np.ndarray) -> np.ndarray:
    """Upper triangular S with P = S S': Cholesky's factor of the matrix read backwards, read backwards."""
    return np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]


@checked
def covariance_of(form: str, matrix: np.ndarray) -> np.ndarray:
    """P from the array that a form stores."""
    if require_choice("form", form, FORMS) == "triangle":
        return matrix.copy()
    unit = np.tril(matrix, -1) + np.eye(len(matrix), dtype=matrix.dtype)
    return (unit.T * np.diag(matrix)) @ unit


@inlined_kernel
def update_covariance(covariance, regressor, forgetting, gain):
    """P itself in place; `gain` becomes P psi of before.

    One triangle is computed and mirrored: rounding that differs between the two grows as 1 / lambda^t.
    Returns lambda + psi' P psi and its inverse, which takes `gain` to P psi with the new P.
    """
    one, denominator = covariance.dtype.type(1), project(covariance, regressor, forgetting, gain)
    shrink = one / denominator
    downdate(covariance, gain, shrink, one / forgetting)
    return denominator, shrink


@pasted_kernel
def downdate(covariance, gain, share, forget):
    """P <- (P - share gain gain') forget."""
    for i in range(len(gain)):
        scaled = gain[i] * share
        for j in range(i + 1):
            covariance[i, j] = covariance[j, i] = (covariance[i, j] - scaled * gain[j]) * forget


@inlined_kernel
def update_ud(factor, regressor, forgetting, gain, inner):
    """Bierman's update of U and D in place."""
    n = len(regressor)
    forget = factor.dtype.type(1) / forgetting
    for j in range(n):
        inner[j] = plus_left(regressor[j], factor, j, regressor)
    denominator = forgetting
    for j in range(n):
        share = factor[j, j] * inner[j]
        following = denominator + share * inner[j]
        factor[j, j] *= denominator / following * forget
        turn = inner[j] / denominator
        for i in range(j):
            entry = factor[j, i]
            factor[j, i] = entry - turn * gain[i]
            gain[i] += share * entry
        gain[j] = share
        denominator = following
    return denominator


@pasted_kernel
def variance(factor, axis):
    """Diagonal element of P of its factors U and D."""
    total = factor[axis, axis]
    for j in range(axis + 1, len(factor)):
        total += factor[j, axis] * factor[j, axis] * factor[j, j]
    return total


@borrowing_kernel
def add_triangle_information(covariance, axis, information, gain):
    """Add to one diagonal element of the inverse of P, in place: a regressor along this axis, seen without forgetting.

    P stays symmetric, and positive definite for information above zero.
    """
    copy_vector(covariance[axis], gain)
    one = covariance.dtype.type(1)
    downdate(covariance, gain, information / (one + information * gain[axis]), one)


@borrowing_kernel
def hold_diagonal(covariance, limits, held, gain):
    """Add to the triangle what brings its diagonal back to these limits, and note whose variance is `held` by it.

    The one farthest above its limit comes first, each at most once: to bring one down lowers the others, so in the
    order of the regressors the result would depend on that order.
    """
    one = covariance.dtype.type(1)
    for i in range(len(limits)):
        held[i] = False
    for _ in range(len(limits)):
        farthest, ratio = -1, one
        for i in range(len(limits)):
            if not held[i] and covariance[i, i] > ratio * limits[i]:
                farthest, ratio = i, covariance[i, i] / limits[i]
        if farthest < 0:
            return
        held[farthest] = True
        information = one / limits[farthest] - one / covariance[farthest, farthest]
        add_triangle_information(covariance, farthest, information, gain)
