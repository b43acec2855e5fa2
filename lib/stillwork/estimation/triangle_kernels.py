"""The triangle of a record, to which each row adds by rotations: least squares of a stream, and the min-max estimate.

The record of least squares is one array, ``state``. Its first rows are the triangle of [X, y] without what all rows have
in common where there is an intercept: R of weighted deviations, and beside it Q'y. The five rows below are, for each
column, its weighted mean, the sum of its squares, the largest |R_jj| so far, the share of the last time constant in which
row j was held, and (first element) the sum of the weights.
"""

import math

import numpy as np

from stillwork.base.algebra import cholesky_solve
from stillwork.base.checks import require_number
from stillwork.base.kernels import kernel
from stillwork.estimation.secular import ROUNDING, narrow_bracket, next_alpha

# Below these shares of the data the rank decides, which singular values show and a triangle does not.
LEAST_EXCESS, LEAST_PENALTY = 1e-9, 1e-20
EVALUATIONS = 60
MEAN, POWER, PEAK, HELD, MASS, BESIDE = range(6)  # places below the triangle, and how many
SINGULAR = 1e-13  # |R_jj| over the size of feature j, below which the features before it explain all of it


def empty_record(features: int, outputs: int) -> np.ndarray:
    """A record of no rows."""
    return np.zeros((features + BESIDE, features + outputs))


def least_share(growth_limit: float) -> float:
    """Of |R_jj| over its peak, for variances that may grow by this limit."""
    if growth_limit != np.inf:
        require_number("growth_limit", growth_limit, at_least=1.0)
    return max(
        1 / math.sqrt(growth_limit), 1e-100
    )  # so much less that it counts for nothing, and no number vanishes


@kernel
def add_row(triangle, row, root):
    """The triangle of `root` times the rows that it stands for and one row more, in place; `row` is used up."""
    if root != 1.0:
        triangle *= root
    for k in range(len(triangle)):
        if row[k] == 0.0:
            continue
        length = np.hypot(triangle[k, k], row[k])
        along, across = triangle[k, k] / length, row[k] / length
        triangle[k, k] = length
        for j in range(k + 1, len(row)):
            upper = triangle[k, j]
            triangle[k, j] = along * upper + across * row[j]
            row[j] = along * row[j] - across * upper


@kernel
def _forget(state, features, forgetting):
    root = np.sqrt(forgetting)
    for i in range(features):
        for j in range(i, state.shape[1]):
            state[i, j] *= root
    for j in range(features):
        state[features + POWER, j] *= forgetting
        state[features + HELD, j] *= forgetting
    state[features + MASS, 0] *= forgetting


@kernel
def _hold(state, features, forgetting, share):
    # Row j of [R, Q'y] times a number is as if its combination of features were seen again with what the estimate says:
    # the estimate stays. So |R_jj| is kept above a share of its peak, and above what rounding would lose.
    for j in range(features):
        pivot, peak = abs(state[j, j]), state[features + PEAK, j]
        if pivot > peak:
            state[features + PEAK, j] = pivot
            continue
        least = 2.0 * SINGULAR * np.sqrt(state[features + POWER, j])
        least = max(share * peak, least if peak > least else 0.0)
        if 0.0 < pivot < least:
            for k in range(j, state.shape[1]):
                state[j, k] *= least / pivot
            state[features + HELD, j] += 1.0 - forgetting


@kernel
def _take_in(state, features, row, weight, forgetting, share, centred):
    # One row [x, y] more, which is used up.
    if forgetting < 1.0:
        _forget(state, features, forgetting)
    if weight > 0.0:
        mass = state[features + MASS, 0]
        state[features + MASS, 0] = mass + weight
        for j in range(features):
            state[features + POWER, j] += weight * row[j] * row[j]
        root = np.sqrt(weight)
        if centred:
            gain = weight / (mass + weight)
            root *= np.sqrt(mass / (mass + weight))
            for j in range(len(row)):
                row[j] -= state[features + MEAN, j]
                state[features + MEAN, j] += gain * row[j]
        for j in range(len(row)):
            row[j] *= root
        add_row(state[:features], row, 1.0)
    if forgetting < 1.0:
        _hold(state, features, forgetting, share)


@kernel
def _solve_record(state, features, centred, coef):
    # The least-squares estimate; a feature that those before it explain gets 0. The last of `coef` is the intercept.
    outputs, dependent = state.shape[1] - features, False
    for j in range(features):
        dependent |= not abs(state[j, j]) > SINGULAR * np.sqrt(state[features + POWER, j])
    if dependent:
        state = state.copy()
        for j in range(features):
            if not abs(state[j, j]) > SINGULAR * np.sqrt(state[features + POWER, j]):
                # what is left of its row belongs to the features after it
                row = state[j].copy()
                state[j] = 0.0
                row[: j + 1] = 0.0
                add_row(state[:features], row, 1.0)
    for o in range(outputs):
        for i in range(features - 1, -1, -1):
            coef[o, i] = 0.0
            if state[i, i] != 0.0:
                total = state[i, features + o]
                for k in range(i + 1, features):
                    total -= state[i, k] * coef[o, k]
                coef[o, i] = total / state[i, i]
        if centred:
            coef[o, features] = state[features + MEAN, features + o]
            for i in range(features):
                coef[o, features] -= coef[o, i] * state[features + MEAN, i]


@kernel
def learn_rows(state, X, y, weights, forgetting, share, centred, coef):
    """Rows of features and outputs more in a record, and in `coef` the estimate of all so far, an intercept last.

    A row of weight 0 is lost: time passes. `share` is the least of |R_jj| over its peak: forgetting of a combination of
    features that nothing excites ends there.
    """
    features = X.shape[1]
    row = np.empty(state.shape[1])
    for t in range(len(X)):
        for j in range(features):
            row[j] = X[t, j]
        for j in range(y.shape[1]):
            row[features + j] = y[t, j]
        _take_in(state, features, row, weights[t], forgetting, share, centred)
    _solve_record(state, features, centred, coef)


@kernel
def track_rows(state, estimate, rows, outputs, forgetting, share, held, estimates, errors):
    """Row by row of one output, without an intercept: the `errors` before each, and the `estimates` after.

    `held` marks the features whose row was held at the last sample.
    """
    features = rows.shape[1]
    row, coef, before = np.empty(features + 1), np.empty((1, features)), np.empty(features)
    for t in range(len(rows)):
        error = outputs[t]
        for j in range(features):
            row[j] = rows[t, j]
            error -= row[j] * estimate[j]
            before[j] = forgetting * state[features + HELD, j]
        row[features] = outputs[t]
        errors[t] = error
        _take_in(state, features, row, 1.0, forgetting, share, False)
        _solve_record(state, features, False, coef)
        for j in range(features):
            estimate[j] = estimates[t, j] = coef[0, j]
            held[j] = state[features + HELD, j] > before[j]


@kernel
def _solve_back(triangle, values, count):
    for i in range(count - 1, -1, -1):
        for j in range(i + 1, count):
            values[i] -= triangle[i, j] * values[j]
        values[i] /= triangle[i, i]


@kernel
def _ridge(triangle, alpha, factor, row, x):
    # x of (A'A + alpha I) x = A'b for the triangle of [A, b]; its factor is left in `factor`; |A x - b|^2
    count = len(x)
    factor[:] = triangle
    for i in range(count):
        row[:] = 0.0
        row[i] = np.sqrt(alpha)
        add_row(factor, row, 1.0)
    x[:] = factor[:count, count]
    _solve_back(factor, x, count)
    residual = triangle[count, count] ** 2
    for i in range(count):
        left = -triangle[i, count]
        for j in range(i, count):
            left += triangle[i, j] * x[j]
        residual += left * left
    return residual


@kernel
def min_max_of_triangle(triangle, bound, start, x):
    """The min-max estimate of the triangle of [A, b] in `x`, in place, by a search that begins at `start`.

    Returned is the regularisation: infinite where the estimate is zero, negative where nothing is decided, because b is
    in the column space, or nearly: then singular values decide.
    """
    count = len(x)
    energy = 0.0
    for i in range(count + 1):
        energy += triangle[i, count] ** 2
    correlation = 0.0
    for j in range(count):
        part = 0.0
        for i in range(j + 1):
            part += triangle[i, j] * triangle[i, count]
        correlation += part * part
    if bound * bound * energy >= correlation:
        x[:] = 0.0
        return np.inf if correlation > 0.0 else -1.0
    if not abs(triangle[count, count]) > LEAST_EXCESS * np.sqrt(energy):
        return -1.0
    factor, row, turned = np.empty_like(triangle), np.empty(count + 1), np.empty(count)
    alpha, low, high = start, 0.0, np.inf
    if not 0.0 < alpha < np.inf:
        alpha = bound * np.sqrt(energy / correlation) * correlation / energy
    for _ in range(EVALUATIONS):
        if not alpha > LEAST_PENALTY:
            return -1.0
        residual = _ridge(triangle, alpha, factor, row, x)
        cholesky_solve(factor.T, x, turned)
        norm, first, second = 0.0, 0.0, 0.0
        for i in range(count):
            norm += x[i] * x[i]
            first += x[i] * turned[i]
            second += turned[i] * turned[i]
        image = bound * np.sqrt(residual / norm)
        low, high = narrow_bracket(alpha, image, low, high)
        step, near = next_alpha(alpha, image, norm, residual, first, second, low, high)
        if near or step == alpha:
            _ridge(triangle, step, factor, row, x)
            return step
        alpha = step
    return -1.0


@kernel
def advance_min_max(corner, row, root, order, known, shares, bound, coef, alphas):
    """One row of features and outputs into the triangle `corner`, and the estimates from it, in place.

    Of the columns in their `order` the first `known` are free of errors, the bounds on the others' errors are `bound` times
    their `shares`. `alphas`, one per output, are those of the row before, and become those of this one; returned is whether
    every estimate was found.
    """
    add_row(corner, row, root)
    columns = len(order)
    count = columns - known
    line = np.empty(columns + 1)
    for output in range(len(coef)):
        own = np.zeros((columns + 1, columns + 1))
        for i in range(len(corner)):
            for k in range(columns):
                line[k] = corner[i, order[k]]
            line[columns] = corner[i, columns + output]
            add_row(own, line, 1.0)
        for k in range(known):
            largest = 0.0
            for i in range(k + 1):
                largest = max(largest, abs(own[i, k]))
            if not abs(own[k, k]) > columns * ROUNDING * largest:
                return False
        part, unit, aimed = own[known:, known:].copy(), 0.0, 0.0
        for j in range(count):
            for i in range(j + 1):
                part[i, j] /= shares[j]
                unit = max(unit, abs(part[i, j]))
        for i in range(count + 1):
            aimed = max(aimed, abs(part[i, count]))
        if not (unit > 0.0 and aimed > 0.0):
            return False
        part[:, :count] /= unit
        part[:, count] /= aimed
        x = np.empty(count)
        alphas[output] = min_max_of_triangle(part, bound / unit, alphas[output], x)
        if not alphas[output] > 0.0:
            return False
        values = own[:, columns].copy()
        for j in range(count):
            x[j] *= aimed / unit / shares[j]
            coef[output, order[known + j]] = x[j]
            for i in range(known):
                values[i] -= own[i, known + j] * x[j]
        _solve_back(own, values, known)
        for k in range(known):
            coef[output, order[k]] = values[k]
    return True
