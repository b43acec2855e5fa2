"""Kernels for one symmetric system: sums of products, their factorisation, solutions and residuals."""

from stillwork.base.kernels import kernel


@kernel
def accumulate_row(row, output, forgetting, information, correlation):
    # returns |s|^2 and the trace of R
    size = 0.0
    trace = 0.0
    for i in range(len(row)):
        for j in range(i + 1):
            information[i, j] = forgetting * information[i, j] + row[i] * row[j]
        correlation[i] = forgetting * correlation[i] + row[i] * output
        size += correlation[i] * correlation[i]
        trace += information[i, i]
    return size, trace


@kernel
def factorise(information, alpha, right, factor, inverse_pivots, half, work):
    # R + alpha I = L D L' with L in `factor`; half = L^-1 right on the way. Sums run along rows: at a few
    # unknowns the chain of pivots is what costs time, and this order keeps it shortest.
    for i in range(len(right)):
        rest = right[i]
        pivot = information[i, i] + alpha
        for j in range(i):
            entry = information[i, j]
            for m in range(j):
                entry -= work[m] * factor[j, m]
            work[j] = entry
            share = entry * inverse_pivots[j]
            factor[i, j] = share
            pivot -= entry * share
            rest -= share * half[j]
        inverse_pivots[i] = 1.0 / pivot
        half[i] = rest


@kernel
def solve_forward(factor, right, half):
    for i in range(len(right)):
        rest = right[i]
        for j in range(i):
            rest -= factor[i, j] * half[j]
        half[i] = rest


@kernel
def solve_backward(factor, inverse_pivots, half, solution):
    n = len(half)
    for i in range(n - 1, -1, -1):
        rest = half[i] * inverse_pivots[i]
        for j in range(i + 1, n):
            rest -= factor[j, i] * solution[j]
        solution[i] = rest


@kernel
def squared_norms(information, correlation, energy, solution):
    # |x|^2 and |A x - b|^2 = z - 2 x's + x'R x, clamped at zero as in (20)
    norm = 0.0
    residual = energy
    for i in range(len(solution)):
        inner = 0.5 * information[i, i] * solution[i] - correlation[i]
        for j in range(i):
            inner += information[i, j] * solution[j]
        residual += 2.0 * inner * solution[i]
        norm += solution[i] * solution[i]
    return norm, max(residual, 0.0)
