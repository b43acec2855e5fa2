"""Kernels of the recursive estimators that factorise: exact, approximate, ridge, and plain RLS.

State of the min-max kernels: `information` R <- lam R + a a' (its lower triangle), `correlation`
s <- lam s + a y, `energy` z <- lam z + y^2, the regularisation alpha, the number of rows seen, the estimate x.
"""

import numpy as np

from stillwork.base.algebra import (
    add_scaled,
    copy_vector,
    factorise,
    inner_product,
    minus_row,
    plus_left,
    solve_backward,
    solve_forward,
)
from stillwork.base.kernels import inlined_kernel, kernel
from stillwork.estimation.covariance_forms import hold_diagonal, update_covariance
from stillwork.estimation.secular import ROUNDING, narrow_bracket, next_alpha

ALPHA, ENERGY, COUNT = 0, 1, 2  # places in the array `scalars`: alpha, z, samples seen
# Unknowns and samples for which a kernel of their number alone is worth its compilation: it saves a tenth of a
# microsecond a sample, and takes two seconds to compile.
FEW, LONG = 8, 100_000


def known_length(unknowns: int, samples: int) -> tuple[float, ...]:
    """As many zeros as unknowns: a tuple's length is known when a kernel is compiled, which unrolls its loops.

    Empty for more than a few unknowns, or a short record: then the kernel that serves every length runs, to the same bits.
    """
    return (0.0,) * unknowns if samples >= LONG and unknowns <= FEW else ()


@inlined_kernel
def _accumulate_row(row, output, forgetting, information, correlation):
    # returns |s|^2 and the trace of R
    trace = 0.0
    for i in range(len(row)):
        for j in range(i + 1):
            information[i, j] = forgetting * information[i, j] + row[i] * row[j]
        correlation[i] = forgetting * correlation[i] + row[i] * output
        trace += information[i, i]
    return inner_product(correlation, correlation), trace


@inlined_kernel
def _squared_norms(information, correlation, energy, solution):
    # |x|^2 and |A x - b|^2 = z - 2 x's + x'R x, clamped at zero as in (20)
    norm = 0.0
    residual = energy
    for i in range(len(solution)):
        half = 0.5 * information[i, i] * solution[i] - correlation[i]
        residual += 2.0 * plus_left(half, information, i, solution) * solution[i]
        norm += solution[i] * solution[i]
    return norm, max(residual, 0.0)


@inlined_kernel
def _exact_solution(
    information, correlation, energy, bound, start, least, x, factor, inverse_pivots, half, work, turned
):
    # Theorem 1 without an SVD: one factorisation per trial alpha, which stays at or above `least`
    alpha = max(start, least)
    low = 0.0
    high = np.inf
    evaluations = 0
    while True:
        factorise(information, alpha, correlation, factor, inverse_pivots, half, work)
        solve_backward(factor, inverse_pivots, half, x)
        norm, residual = _squared_norms(information, correlation, energy, x)
        evaluations += 1
        if residual == 0.0 or evaluations == 100:
            return alpha, evaluations
        solve_forward(factor, x, half)
        solve_backward(factor, inverse_pivots, half, turned)
        first = 0.0
        second = 0.0
        for i in range(len(x)):
            first += x[i] * turned[i]
            second += turned[i] * turned[i]
        image = bound * np.sqrt(residual / norm)
        low, high = narrow_bracket(alpha, image, low, high)
        step, near = next_alpha(alpha, image, norm, residual, first, second, low, high)
        if near and step > least:
            # two terms of the series of x in alpha make up for the last step
            change = step - alpha
            solve_forward(factor, turned, half)
            solve_backward(factor, inverse_pivots, half, work)
            for i in range(len(x)):
                x[i] -= change * (turned[i] - change * work[i])
            return step, evaluations
        step = max(step, least)
        if step == alpha:
            return alpha, evaluations
        alpha = step


@kernel
def run_min_max(
    known, rows, outputs, bounds, forgetting, iterations, information, correlation, scalars, estimate,
    factor, inverse_pivots, estimates, errors, alphas, evaluations,
):  # fmt: skip
    """Min-max estimates of all data so far at every step, from R, s and z.

    With 0 `iterations` the exact ones of Theorem 2. Else algorithm (20): so many steps of the fixed-point map from
    lam alpha in place of its root; `factor` then holds P^-1 of the last step, from which h follows by a rank-one
    update, as in RLS.
    """
    n = len(known) if len(known) > 0 else len(estimate)
    x = np.zeros(n)  # loops run over arrays that are made here, whose length is known where n is
    copy_vector(estimate, x)
    half = np.zeros(n)
    work = np.zeros(n)
    gain = np.zeros(n)
    row = np.zeros(n)
    alpha = scalars[ALPHA]
    energy = scalars[ENERGY]
    seen = scalars[COUNT]
    for t in range(len(outputs)):
        output = outputs[t]
        error = output
        for i in range(n):
            row[i] = rows[t, i]
            error -= row[i] * x[i]
        errors[t] = error
        size, trace = _accumulate_row(row, output, forgetting, information, correlation)
        energy = forgetting * energy + output * output
        seen += 1.0
        least = ROUNDING * trace
        bound = bounds[t]
        count = 0
        if seen <= n or bound * bound * energy >= size:  # Theorem 1: eta >= |A'b| / |b|
            alpha = np.inf
            for i in range(n):
                x[i] = 0.0
        elif iterations == 0 or alpha == np.inf:
            # alpha_t itself is nearer to alpha_(t+1) than lam alpha_t, from which (15) starts; out of the zero
            # solution, and at the first step, there is neither
            start = alpha if alpha < np.inf else trace / n
            alpha, count = _exact_solution(
                information, correlation, energy, bound, start, least, x,
                factor, inverse_pivots, half, work, gain,
            )  # fmt: skip
            if iterations > 0:
                factorise(information, alpha, correlation, factor, inverse_pivots, half, work)
        else:
            solve_forward(factor, row, half)
            weight = forgetting
            for i in range(n):
                weight += half[i] * half[i] * inverse_pivots[i]
            share = error / weight
            solve_backward(factor, inverse_pivots, half, gain)
            add_scaled(share, gain, x)  # h = x + P a e / (lam + a'P a)
            for _ in range(iterations):
                norm, residual = _squared_norms(information, correlation, energy, x)
                alpha = max(bound * np.sqrt(residual / norm), least)
                factorise(information, alpha, correlation, factor, inverse_pivots, half, work)
                solve_backward(factor, inverse_pivots, half, x)
            count = iterations
        alphas[t] = alpha
        evaluations[t] = count
        copy_vector(x, estimates[t])
    copy_vector(x, estimate)
    scalars[ALPHA] = alpha
    scalars[ENERGY] = energy
    scalars[COUNT] = seen


@kernel
def run_ridge(rows, outputs, penalty, forgetting, information, correlation, estimate, estimates, errors):
    """(R + penalty I)^-1 s at every step."""
    n = len(estimate)
    factor = np.zeros((n, n))
    inverse_pivots = np.zeros(n)
    half = np.zeros(n)
    work = np.zeros(n)
    for t in range(len(outputs)):
        errors[t] = minus_row(outputs[t], rows, t, estimate)
        _accumulate_row(rows[t], outputs[t], forgetting, information, correlation)
        factorise(information, penalty, correlation, factor, inverse_pivots, half, work)
        solve_backward(factor, inverse_pivots, half, estimate)
        copy_vector(estimate, estimates[t])


@kernel
def run_least_squares(rows, outputs, forgetting, covariance, estimate, limits, held, estimates, errors):
    """Exponentially weighted recursive least squares, covariance form, P kept below limits of its diagonal.

    `held` marks the limits that acted at the last sample.
    """
    n = len(estimate)
    gain = np.zeros(n)
    for t in range(len(outputs)):
        row = rows[t]
        errors[t] = error = minus_row(outputs[t], rows, t, estimate)
        _, shrink = update_covariance(covariance, row, forgetting, gain)
        share = error * shrink
        for i in range(n):
            estimate[i] += gain[i] * share
            estimates[t, i] = estimate[i]
        reached = False
        for i in range(n):
            held[i] = False
            reached |= covariance[i, i] > limits[i]
        if reached:
            hold_diagonal(covariance, limits, held, gain)


@kernel
def worst_residuals(rows, outputs, bounds, forgetting, estimates, worst):
    # |A x - b| + eta |x| of any estimates x_t, from R, s and z
    n = rows.shape[1]
    information = np.zeros((n, n))
    correlation = np.zeros(n)
    energy = 0.0
    for t in range(len(outputs)):
        _accumulate_row(rows[t], outputs[t], forgetting, information, correlation)
        energy = forgetting * energy + outputs[t] * outputs[t]
        norm, residual = _squared_norms(information, correlation, energy, estimates[t])
        worst[t] = np.sqrt(residual) + bounds[t] * np.sqrt(norm)
