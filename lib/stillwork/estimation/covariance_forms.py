"""Five forms of the covariance recursion of recursive least squares, one formula in exact arithmetic.

    P <- (P - g g' / den) / lambda,   g = P psi,   den = lambda + psi' g

What a form stores, in one square array: P itself (``triangle``, ``Joseph``), S with P = S S' (``square root``, after
Potter), or a triangular factor whose row j is column j of U: U D U' with D on the diagonal (``UD``, Bierman), U U'
(``inverse QR``, by Givens rotations). A factor has half as many digits to lose, and no product of it is indefinite.
All kernels work in the precision of their arrays.

References
----------
Bierman, Factorization Methods for Discrete Sequential Estimation (1977); Haykin, Adaptive Filter Theory.
"""

import numpy as np

from stillwork.base.algebra import add_scaled, copy_vector, plus_column, plus_left, plus_row, project
from stillwork.base.checks import InputError, require_choice
from stillwork.base.kernels import borrowing_kernel, inlined_kernel, pasted_kernel
from stillwork.base.validation import checked

FORMS = ("triangle", "Joseph", "square root", "UD", "inverse QR")
TRIANGLE, JOSEPH, SQUARE_ROOT, UD, INVERSE_QR = range(5)


@checked
def factor_of(form: str, covariance: np.ndarray) -> np.ndarray:
    """The array that a form stores for a covariance P, in the precision of P."""
    code = FORMS.index(require_choice("form", form, FORMS))
    if covariance.ndim != 2 or covariance.shape[0] != covariance.shape[1]:
        raise InputError(f"covariance has shape {covariance.shape}; give a square one")
    if code in (TRIANGLE, JOSEPH):
        return covariance.copy()
    # Upper triangular: Cholesky's factor of the matrix read backwards, read backwards.
    upper = np.linalg.cholesky(covariance[::-1, ::-1])[::-1, ::-1]
    if code == SQUARE_ROOT:
        return upper.copy()
    if code == INVERSE_QR:
        return upper.T.copy()
    root = np.diag(upper)
    return (upper / root).T - np.eye(len(root)) + np.diag(root**2)


@checked
def covariance_of(form: str, matrix: np.ndarray) -> np.ndarray:
    """P from the array that a form stores."""
    code = FORMS.index(require_choice("form", form, FORMS))
    if code in (TRIANGLE, JOSEPH):
        return matrix.copy()
    if code == SQUARE_ROOT:
        return matrix @ matrix.T
    if code == INVERSE_QR:
        return matrix.T @ matrix
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


@borrowing_kernel
def update_joseph(covariance, regressor, forgetting, gain, row):
    """(I - k psi') P (I - k psi')' / lambda + k k' with k = g / den, in place."""
    zero, one, n = covariance.dtype.type(0), covariance.dtype.type(1), len(regressor)
    denominator = project(covariance, regressor, forgetting, gain)
    for i in range(n):
        row[i] = plus_column(zero, covariance, i, regressor)
    shrink, forget = one / denominator, one / forgetting
    for i in range(n):
        share = gain[i] * shrink
        add_scaled(-share, row, covariance[i])
        back = plus_row(zero, covariance, i, regressor)
        for j in range(n):
            step = gain[j] * shrink
            covariance[i, j] = (covariance[i, j] - back * step) * forget + share * step
    return denominator


@borrowing_kernel
def update_square_root(root, regressor, forgetting, gain, inner):
    """Potter's update of S in place."""
    zero, one, n = root.dtype.type(0), root.dtype.type(1), len(regressor)
    for j in range(n):
        inner[j] = 0
    for i in range(n):
        add_scaled(regressor[i], root[i], inner)
    denominator = forgetting
    for j in range(n):
        denominator += inner[j] * inner[j]
    share = one / (denominator + np.sqrt(forgetting * denominator))
    forget = one / np.sqrt(forgetting)
    for i in range(n):
        gain[i] = plus_row(zero, root, i, inner)
        scaled = gain[i] * share
        for j in range(n):
            root[i, j] = (root[i, j] - scaled * inner[j]) * forget
    return denominator


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


@borrowing_kernel
def update_inverse_qr(factor, regressor, forgetting, gain, inner):
    """Givens rotations of [sqrt(lambda), psi' U; 0, U] to [sqrt(den), 0; g / sqrt(den), sqrt(lambda) U], in place."""
    n, zero = len(regressor), factor.dtype.type(0)
    root = np.sqrt(forgetting)
    forget = factor.dtype.type(1) / root
    for j in range(n):
        inner[j] = plus_left(zero, factor, j, regressor) + factor[j, j] * regressor[j]
        gain[j] = 0
    denominator = forgetting
    for j in range(n):
        denominator += inner[j] * inner[j]
        length = np.sqrt(denominator)
        cosine, sine = root / length, inner[j] / length
        for i in range(j + 1):
            entry, share = factor[j, i], gain[i]
            gain[i] = cosine * share + sine * entry
            factor[j, i] = (cosine * entry - sine * share) * forget
        root = length
    for i in range(n):
        gain[i] *= root
    return denominator


@borrowing_kernel
def update_form(form, matrix, regressor, forgetting, gain, inner):
    """One sample of any form in place; `gain` becomes P psi of before, `inner` is workspace.

    Returns lambda + psi' P psi.
    """
    if form == TRIANGLE:
        return update_covariance(matrix, regressor, forgetting, gain)[0]
    if form == UD:
        return update_ud(matrix, regressor, forgetting, gain, inner)
    # The others are functions of their own: of one body with all of them the compiler would optimise none.
    if form == JOSEPH:
        return update_joseph(matrix, regressor, forgetting, gain, inner)
    if form == SQUARE_ROOT:
        return update_square_root(matrix, regressor, forgetting, gain, inner)
    return update_inverse_qr(matrix, regressor, forgetting, gain, inner)


@pasted_kernel
def variance(form, matrix, axis):
    """Diagonal element of P."""
    zero, total = matrix.dtype.type(0), matrix[axis, axis]
    if form == SQUARE_ROOT:
        return plus_row(zero, matrix, axis, matrix[axis])
    if form == INVERSE_QR:
        return plus_column(zero, matrix, axis, matrix[:, axis])
    if form == UD:
        for j in range(axis + 1, len(matrix)):
            total += matrix[j, axis] * matrix[j, axis] * matrix[j, j]
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
