"""Kernels of the recursive estimators that factorise: exact, approximate, ridge, and plain RLS.

State of the min-max kernels: `information` R <- lam R + a a' (its lower triangle), `correlation` s <- lam s + a y, `energy`
z <- lam z + y^2, the regularisation alpha, the number of rows seen, and the estimate x.
"""

import numpy as np

from stillwork.kernels import kernel
from stillwork.worstcase.secular import ROUNDING, _bracket, _next_alpha

ALPHA, ENERGY, COUNT = 0, 1, 2  # places in the array `scalars`


@kernel
def _accumulate(row, output, forgetting, information, correlation, scalars):
    # returns |s|^2 and the mean eigenvalue of R
    size = 0.0
    trace = 0.0
    for i in range(len(row)):
        for j in range(i + 1):
            information[i, j] = forgetting * information[i, j] + row[i] * row[j]
        correlation[i] = forgetting * correlation[i] + row[i] * output
        size += correlation[i] * correlation[i]
        trace += information[i, i]
    scalars[ENERGY] = forgetting * scalars[ENERGY] + output * output
    scalars[COUNT] += 1.0
    return size, trace / len(row)


@kernel
def _factorise(information, alpha, right, factor, inverse_pivots, half, work):
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
def _solve_forward(factor, right, half):
    for i in range(len(right)):
        rest = right[i]
        for j in range(i):
            rest -= factor[i, j] * half[j]
        half[i] = rest


@kernel
def _solve_backward(factor, inverse_pivots, half, solution):
    n = len(half)
    for i in range(n - 1, -1, -1):
        rest = half[i] * inverse_pivots[i]
        for j in range(i + 1, n):
            rest -= factor[j, i] * solution[j]
        solution[i] = rest


@kernel
def _squares(information, correlation, energy, solution):
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


@kernel
def _exact_solution(
    information, correlation, energy, bound, start, least, x, factor, inverse_pivots, half, work, turned
):
    # Theorem 1 without an SVD: one factorisation per trial alpha, which stays at or above `least`
    alpha = max(start, least)
    low = 0.0
    high = np.inf
    evaluations = 0
    while True:
        _factorise(information, alpha, correlation, factor, inverse_pivots, half, work)
        _solve_backward(factor, inverse_pivots, half, x)
        norm, residual = _squares(information, correlation, energy, x)
        evaluations += 1
        if residual == 0.0 or evaluations == 100:
            return alpha, evaluations
        _solve_forward(factor, x, half)
        _solve_backward(factor, inverse_pivots, half, turned)
        first = 0.0
        second = 0.0
        for i in range(len(x)):
            first += x[i] * turned[i]
            second += turned[i] * turned[i]
        image = bound * np.sqrt(residual / norm)
        low, high = _bracket(alpha, image, low, high)
        step, near = _next_alpha(alpha, image, norm, residual, first, second, low, high)
        if near and step > least:
            # two terms of the series of x in alpha make up for the last step
            change = step - alpha
            _solve_forward(factor, turned, half)
            _solve_backward(factor, inverse_pivots, half, work)
            for i in range(len(x)):
                x[i] -= change * (turned[i] - change * work[i])
            return step, evaluations
        step = max(step, least)
        if step == alpha:
            return alpha, evaluations
        alpha = step


@kernel
def _run_exact(
    rows, outputs, bounds, forgetting, information, correlation, scalars, estimate,
    estimates, errors, alphas, evaluations,
):  # fmt: skip
    """Theorem 2: the min-max solution of all data so far, at every step, warm started."""
    n = len(estimate)
    factor = np.zeros((n, n))
    inverse_pivots = np.zeros(n)
    half = np.zeros(n)
    work = np.zeros(n)
    turned = np.zeros(n)
    for t in range(len(outputs)):
        error = outputs[t]
        for i in range(n):
            error -= rows[t, i] * estimate[i]
        errors[t] = error
        size, mean = _accumulate(rows[t], outputs[t], forgetting, information, correlation, scalars)
        energy = scalars[ENERGY]
        if scalars[COUNT] <= n or bounds[t] * bounds[t] * energy >= size:  # Theorem 1, |A'b| <= eta |b|
            scalars[ALPHA] = np.inf
            evaluations[t] = 0
            for i in range(n):
                estimate[i] = 0.0
        else:
            # alpha_t itself is nearer to alpha_t+1 than lam alpha_t, from which (15) starts
            start = scalars[ALPHA] if scalars[ALPHA] < np.inf else mean
            least = ROUNDING * n * mean
            alpha, count = _exact_solution(
                information, correlation, energy, bounds[t], start, least, estimate,
                factor, inverse_pivots, half, work, turned,
            )  # fmt: skip
            scalars[ALPHA] = alpha
            evaluations[t] = count
        alphas[t] = scalars[ALPHA]
        for i in range(n):
            estimates[t, i] = estimate[i]


@kernel
def _run_approximate(
    rows, outputs, bounds, forgetting, iterations, information, correlation, scalars, estimate,
    factor, inverse_pivots, estimates, errors, alphas, evaluations,
):  # fmt: skip
    """Algorithm (20): `iterations` steps of the fixed-point map from lam alpha, in place of its root.

    `factor` holds P^-1 of the last step: h follows from it by a rank-one update, as in RLS.
    """
    n = len(estimate)
    half = np.zeros(n)
    gain = np.zeros(n)
    work = np.zeros(n)
    for t in range(len(outputs)):
        error = outputs[t]
        for i in range(n):
            error -= rows[t, i] * estimate[i]
        errors[t] = error
        size, mean = _accumulate(rows[t], outputs[t], forgetting, information, correlation, scalars)
        energy = scalars[ENERGY]
        bound = bounds[t]
        least = ROUNDING * n * mean
        count = 0
        solves = iterations
        if scalars[COUNT] <= n or bound * bound * energy >= size:
            solves = 0
            alpha = np.inf
            for i in range(n):
                estimate[i] = 0.0
        elif scalars[ALPHA] == np.inf:
            # out of the zero solution, and at the first step, there is no lam alpha: solve exactly
            solves = 1
            alpha, count = _exact_solution(
                information, correlation, energy, bound, mean, least, estimate,
                factor, inverse_pivots, half, work, gain,
            )  # fmt: skip
        else:
            _solve_forward(factor, rows[t], half)
            _solve_backward(factor, inverse_pivots, half, gain)
            weight = forgetting
            for i in range(n):
                weight += rows[t, i] * gain[i]
            for i in range(n):
                estimate[i] += gain[i] * (error / weight)
            norm, residual = _squares(information, correlation, energy, estimate)
            alpha = max(bound * np.sqrt(residual / norm), least)
            count = iterations
        for repeat in range(solves):
            if repeat > 0:
                norm, residual = _squares(information, correlation, energy, estimate)
                alpha = max(bound * np.sqrt(residual / norm), least)
            _factorise(information, alpha, correlation, factor, inverse_pivots, half, work)
            _solve_backward(factor, inverse_pivots, half, estimate)
        scalars[ALPHA] = alpha
        alphas[t] = alpha
        evaluations[t] = count
        for i in range(n):
            estimates[t, i] = estimate[i]


@kernel
def _run_ridge(
    rows, outputs, penalty, forgetting, information, correlation, scalars, estimate, estimates, errors
):
    """(R + penalty I)^-1 s at every step."""
    n = len(estimate)
    factor = np.zeros((n, n))
    inverse_pivots = np.zeros(n)
    half = np.zeros(n)
    work = np.zeros(n)
    for t in range(len(outputs)):
        error = outputs[t]
        for i in range(n):
            error -= rows[t, i] * estimate[i]
        errors[t] = error
        _accumulate(rows[t], outputs[t], forgetting, information, correlation, scalars)
        _factorise(information, penalty, correlation, factor, inverse_pivots, half, work)
        _solve_backward(factor, inverse_pivots, half, estimate)
        for i in range(n):
            estimates[t, i] = estimate[i]


@kernel
def _run_least_squares(rows, outputs, forgetting, covariance, estimate, estimates, errors):
    """Exponentially weighted recursive least squares, covariance form."""
    n = len(estimate)
    growth = 1.0 / forgetting
    spread = np.zeros(n)
    for t in range(len(outputs)):
        error = outputs[t]
        weight = forgetting
        for i in range(n):
            inner = 0.0
            for j in range(n):
                inner += covariance[i, j] * rows[t, j]
            spread[i] = inner
            weight += rows[t, i] * inner
            error -= rows[t, i] * estimate[i]
        errors[t] = error
        for i in range(n):
            estimate[i] += spread[i] * (error / weight)
            estimates[t, i] = estimate[i]
            share = spread[i] / weight
            for j in range(n):
                covariance[i, j] = (covariance[i, j] - share * spread[j]) * growth


@kernel
def _worst_residuals(rows, outputs, bounds, forgetting, estimates, worst):
    # |A x - b| + eta |x| of any estimates x_t, from R, s and z
    n = rows.shape[1]
    information = np.zeros((n, n))
    correlation = np.zeros(n)
    scalars = np.zeros(3)
    for t in range(len(outputs)):
        _accumulate(rows[t], outputs[t], forgetting, information, correlation, scalars)
        norm, residual = _squares(information, correlation, scalars[ENERGY], estimates[t])
        worst[t] = np.sqrt(residual) + bounds[t] * np.sqrt(norm)
