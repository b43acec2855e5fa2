"""The one kernel of linear least squares in streams: a triangle to which each row adds by rotations.

The record is one array, ``state``. Its first rows are the triangle of [X, y] without what all rows have in common where
there is an intercept: R of weighted deviations, and beside it Q'y. The five rows below are, for each column, its weighted
mean; the sum of the squares of a feature, or what no feature explains of those of an output; the largest |R_jj| so far;
the share of the last time constant in which row j was held; and (first element) the sum of the weights.

From it come least squares, ridge regression, and the min-max estimate: all sums of squares are those of the rows.
"""

import math

import numpy as np

from stillwork.base.algebra import copy_vector, factorise, solve_backward, solve_forward
from stillwork.base.checks import require_array, require_number
from stillwork.base.kernels import borrowing_kernel, kernel, pasted_kernel
from stillwork.estimation.gaussian import require_covariance
from stillwork.estimation.secular import ROUNDING, narrow_bracket, next_alpha

MEAN, POWER, PEAK, HELD, MASS, BESIDE = range(6)  # places below the triangle, and how many
SINGULAR = 1e-13  # |R_jj| over the size of feature j, below which the features before it explain all of it
LEAST_EXCESS = (
    1e-9  # of the output outside the features' space, below which singular values decide of min-max
)
WEAKEST = 1e-10  # pivot over the trace, below which the normal equations lose digits that a correction does not give back
LEAVES = 1e-2  # what a downdate leaves of a square; below it the window is taken in anew
EVALUATIONS = 60
NO_BOUNDS = np.empty(0)  # of least squares


def empty_record(features: int, outputs: int) -> np.ndarray:
    """A record of no rows."""
    return np.zeros((features + BESIDE, features + outputs))


def start_record(first: np.ndarray, covariance) -> np.ndarray:
    """A record whose estimate is the `first`, a row for each output, of this covariance: a number, its diagonal or all of it.

    None is known of an intercept, or of anything where `covariance` is None or infinite.
    """
    outputs, features = first.shape
    state = empty_record(features, outputs)
    if covariance is None or (isinstance(covariance, float) and covariance == np.inf):
        return state
    given = require_array("initial_covariance", covariance)
    whole = require_covariance(
        "initial_covariance", np.full(features, given) if given.ndim == 0 else given, features
    )
    state[:features, :features] = np.linalg.cholesky(np.linalg.inv(whole)).T
    state[:features, features:] = state[:features, :features] @ first.T
    state[features + POWER, :features] = (state[:features, :features] ** 2).sum(axis=0)
    state[features + PEAK, :features] = np.diag(state[:features, :features])
    return state


def least_share(growth_limit: float) -> float:
    """Of |R_jj| over its peak, for variances that may grow by this limit."""
    if growth_limit != np.inf:
        require_number("growth_limit", growth_limit, at_least=1.0)
    # so much less that it counts for nothing, and no number vanishes
    return max(1 / math.sqrt(growth_limit), 1e-100)


@pasted_kernel
def add_row(triangle, row, features):
    """The triangle with one row more, in place; of `row` is left what the features do not explain."""
    for k in range(features):
        if row[k] == 0.0:
            continue
        length = math.sqrt(triangle[k, k] * triangle[k, k] + row[k] * row[k])
        if length == 0.0:
            continue
        along, across = triangle[k, k] / length, row[k] / length
        triangle[k, k] = length
        for j in range(k + 1, len(row)):
            upper = triangle[k, j]
            triangle[k, j] = along * upper + across * row[j]
            row[j] = along * row[j] - across * upper


@borrowing_kernel
def _remove_row(triangle, row, features):
    # The triangle without one row, by hyperbolic rotations in their stable order; false where digits would be lost.
    for k in range(features):
        if row[k] == 0.0:
            continue
        whole = triangle[k, k]
        left = (whole - row[k]) * (whole + row[k])
        if not left > LEAVES * whole * whole:
            return False
        triangle[k, k] = math.sqrt(left)
        along, across = triangle[k, k] / whole, row[k] / whole
        for j in range(k + 1, len(row)):
            triangle[k, j] = (triangle[k, j] - across * row[j]) / along
            row[j] = along * row[j] - across * triangle[k, j]
    return True


@pasted_kernel
def _forget(state, features, forgetting):
    root = math.sqrt(forgetting)
    for i in range(features):
        for j in range(i, state.shape[1]):
            state[i, j] *= root
        state[features + HELD, i] *= forgetting
    for j in range(state.shape[1]):
        state[features + POWER, j] *= forgetting
    state[features + MASS, 0] *= forgetting


@pasted_kernel
def _hold(state, features, forgetting, share):
    # Row j of [R, Q'y] times a number is as if its combination of features were seen again with what the estimate says:
    # the estimate stays. So |R_jj| is kept above a share of its peak, and above what rounding would lose.
    for j in range(features):
        pivot, peak = abs(state[j, j]), state[features + PEAK, j]
        if pivot > peak:
            state[features + PEAK, j] = pivot
            continue
        least = 2.0 * SINGULAR * math.sqrt(state[features + POWER, j])
        least = max(share * peak, least if peak > least else 0.0)
        if 0.0 < pivot < least:
            for k in range(j, state.shape[1]):
                state[j, k] *= least / pivot
            state[features + HELD, j] += 1.0 - forgetting


@borrowing_kernel
def take_in(state, features, row, weight, forgetting, share, centred):
    """One row [x, y] more, which is used up; one of weight 0 is lost: time passes."""
    if forgetting < 1.0:
        _forget(state, features, forgetting)
    if weight > 0.0:
        mass = state[features + MASS, 0]
        state[features + MASS, 0] = mass + weight
        for j in range(features):
            state[features + POWER, j] += weight * row[j] * row[j]
        root = math.sqrt(weight)
        if centred:
            gain = weight / (mass + weight)
            root *= math.sqrt(mass / (mass + weight))
            for j in range(len(row)):
                row[j] -= state[features + MEAN, j]
                state[features + MEAN, j] += gain * row[j]
        for j in range(len(row)):
            row[j] *= root
        add_row(state, row, features)
        for j in range(features, len(row)):
            state[features + POWER, j] += row[j] * row[j]
    if forgetting < 1.0:
        _hold(state, features, forgetting, share)


@borrowing_kernel
def _take_out(state, features, row, weight, centred):
    # One row [x, y] less; false, with the record spoilt, where digits would be lost.
    mass = state[features + MASS, 0]
    left = mass - weight
    if not left > LEAVES * mass:
        return False
    state[features + MASS, 0] = left
    for j in range(features):
        state[features + POWER, j] = max(state[features + POWER, j] - weight * row[j] * row[j], 0.0)
    root = math.sqrt(weight)
    if centred:
        root *= math.sqrt(mass / left)
        for j in range(len(row)):
            row[j] -= state[features + MEAN, j]
            state[features + MEAN, j] -= weight / left * row[j]
    for j in range(len(row)):
        row[j] *= root
    if not _remove_row(state, row, features):
        return False
    for j in range(features, len(row)):
        whole = state[features + POWER, j]
        state[features + POWER, j] = max(whole - row[j] * row[j], 0.0)
    return True


@pasted_kernel
def _back(state, features, o, coef):
    # R coef = Q'y of one output; 0 where there is no pivot
    for i in range(features - 1, -1, -1):
        coef[i] = 0.0
        if state[i, i] != 0.0:
            total = state[i, features + o]
            for k in range(i + 1, features):
                total -= state[i, k] * coef[k]
            coef[i] = total / state[i, i]


@kernel
def solve_least_squares(state, features, coef):
    """The least-squares estimate, a row for each output; a feature that those before it explain gets 0."""
    dependent = False
    for j in range(features):
        dependent |= not abs(state[j, j]) > SINGULAR * math.sqrt(state[features + POWER, j])
    if dependent:
        state = state.copy()
        for j in range(features):
            if not abs(state[j, j]) > SINGULAR * math.sqrt(state[features + POWER, j]):
                # what is left of its row belongs to the features after it
                row = state[j].copy()
                state[j] = 0.0
                row[: j + 1] = 0.0
                add_row(state, row, features)
    for o in range(state.shape[1] - features):
        _back(state, features, o, coef[o])


@borrowing_kernel
def set_normal(state, features, o, units, square, lines):
    """R'R and R'Q'y of one output, with features over these units, in their places; the trace, |y|^2 and |R'Q'y|^2."""
    trace, size, energy = 0.0, 0.0, state[features + POWER, features + o]
    for i in range(features):
        for j in range(i + 1):
            total = 0.0
            for k in range(j + 1):
                total += state[k, i] * state[k, j]
            square[0, i, j] = total / units[i] / units[j]
        total = 0.0
        for k in range(i + 1):
            total += state[k, i] * state[k, features + o]
        lines[0, i] = total / units[i]
        size += lines[0, i] * lines[0, i]
        trace += square[0, i, i]
        energy += state[i, features + o] * state[i, features + o]
    return trace, energy, size


@pasted_kernel
def _residual(state, features, o, units, x, left):
    # `left` of the rows of the triangle, and |y - X x|^2 of all rows
    total = state[features + POWER, features + o]
    for i in range(features):
        left[i] = state[i, features + o]
        for j in range(i, features):
            left[i] -= state[i, j] * x[j] / units[j]
        total += left[i] * left[i]
    return total


@kernel
def solve_ridge(state, features, o, units, alpha, square, lines, x):
    """x of (X'X + alpha I) x = X'y after `set_normal`, features over `units`; |X x - y|^2, and the smallest pivot.

    The normal equations are corrected once by the residual of the rows, which gives back the digits that they lose
    (Björck, Numerical Methods for Least Squares Problems, 6.6.5).
    """
    information, factor = square[0], square[1]
    right, pivots, half, work, left = lines[0], lines[1], lines[2], lines[3], lines[4]
    factorise(information, alpha, right, factor, pivots, half, work)
    solve_backward(factor, pivots, half, x)
    _residual(state, features, o, units, x, left)
    for j in range(features):
        work[j] = 0.0
        for i in range(j + 1):
            work[j] += state[i, j] * left[i]
        work[j] = work[j] / units[j] - alpha * x[j]
    solve_forward(factor, work, half)
    solve_backward(factor, pivots, half, work)
    largest = 0.0
    for j in range(features):
        x[j] += work[j]
        largest = max(largest, pivots[j])
    return _residual(state, features, o, units, x, left), 1.0 / largest


@kernel
def search_min_max(state, features, o, units, bound, start, least, square, lines, x):
    """The min-max estimate of one output after `set_normal`, Theorem 1, for a bound below its threshold.

    The search begins at `start` and stays at or above `least`. Returned are alpha, how often the secular function was
    evaluated, and the smallest pivot.
    """
    factor, pivots, half, turned = square[1], lines[1], lines[2], lines[5]
    alpha, low, high = max(start, least), 0.0, np.inf
    for count in range(1, EVALUATIONS):
        residual, pivot = solve_ridge(state, features, o, units, alpha, square, lines, x)
        solve_forward(factor, x, half)
        solve_backward(factor, pivots, half, turned)
        norm, first, second = 0.0, 0.0, 0.0
        for i in range(features):
            norm += x[i] * x[i]
            first += x[i] * turned[i]
            second += turned[i] * turned[i]
        if not (residual > 0.0 and norm > 0.0):
            return alpha, count, pivot
        image = bound * math.sqrt(residual / norm)
        low, high = narrow_bracket(alpha, image, low, high)
        step, near = next_alpha(alpha, image, norm, residual, first, second, low, high)
        if near and step > least:
            _, pivot = solve_ridge(state, features, o, units, step, square, lines, x)
            return step, count, pivot
        step = max(step, least)
        if step == alpha:
            return alpha, count, pivot
        alpha = step
    return alpha, EVALUATIONS, 0.0


@kernel
def solve_min_max(state, features, bound, units, alphas, coef):
    """The min-max estimate of every output, of features with bounds `bound` times `units`; false where it is not decided.

    Undecided is an output in the space of the features, or nearly, and features of which the bound does not make a well
    conditioned problem: there singular values decide. `alphas` are where the searches begin, and become their results.
    """
    square, lines = np.empty((2, features, features)), np.empty((6, features))
    for o in range(len(coef)):
        x = coef[o]
        trace, energy, size = set_normal(state, features, o, units, square, lines)
        if not (size > 0.0 and energy > 0.0):
            return False
        if bound * bound * energy >= size:
            x[:] = 0.0
            alphas[o] = np.inf
            continue
        if not state[features + POWER, features + o] > LEAST_EXCESS * LEAST_EXCESS * energy:
            return False
        start = alphas[o] if 0.0 < alphas[o] < np.inf else bound * math.sqrt(size / energy)
        alphas[o], _, pivot = search_min_max(
            state, features, o, units, bound, start, 0.0, square, lines, x[:features]
        )
        if not pivot > WEAKEST * trace:
            return False
        for i in range(features):
            x[i] /= units[i]
    return True


@kernel
def learn_rows(
    state, recent, count, X, y, weights, forgetting, share, centred, bounds, per_sample, alphas, coef
):
    """Rows of features and outputs more in a record, and in `coef` the estimate of all so far, an intercept last.

    `share` is the least of |R_jj| over its peak: forgetting of a combination of features that nothing excites ends there.
    `recent` holds the rows of a window with their weights, of which there were `count`; an empty one is none. With
    `bounds` it is the min-max estimate, and false is returned where that is not decided; those `per_sample` are times the
    root of the sum of the weights.
    """
    features, window = X.shape[1], len(recent)
    row = np.empty(state.shape[1])
    for t in range(len(X)):
        for j in range(features):
            row[j] = X[t, j]
        for j in range(y.shape[1]):
            row[features + j] = y[t, j]
        if window == 0:
            take_in(state, features, row, weights[t], forgetting, share, centred)
            continue
        place = (count[0] + t) % window
        leaving = recent[place].copy()
        recent[place, 0] = weights[t]
        copy_vector(row, recent[place, 1:])
        take_in(state, features, row, weights[t], forgetting, share, centred)
        # at the end of each window all is taken in anew, so that rounding errors do not add up
        if leaving[0] > 0.0 and (
            place == window - 1
            or not _take_out(state, features, leaving[1:], leaving[0] * forgetting**window, centred)
        ):
            state[:] = 0.0
            for k in range(1, window + 1):
                copy_vector(recent[(place + k) % window, 1:], row)
                take_in(state, features, row, recent[(place + k) % window, 0], forgetting, share, centred)
    count[0] += len(X)
    decided = True
    if len(bounds) > 0:
        size = math.sqrt(state[features + MASS, 0]) if per_sample else 1.0
        decided = solve_min_max(state, features, size, bounds, alphas, coef)
    else:
        solve_least_squares(state, features, coef)
    for o in range(len(coef)):
        coef[o, features] = 0.0
        if centred:
            coef[o, features] = state[features + MEAN, features + o]
            for i in range(features):
                coef[o, features] -= coef[o, i] * state[features + MEAN, i]
    return decided


LEAST, RIDGE, EXACT, APPROXIMATE = range(4)  # what `track_rows` estimates


@kernel
def track_rows(
    kind,
    state,
    rows,
    outputs,
    forgetting,
    share,
    settings,
    iterations,
    estimates,
    errors,
    alphas,
    evaluations,
):
    """Row by row of one output, without an intercept: the `errors` before each, and the `estimates` after.

    Of `settings` each row has one: the penalty of ridge regression, the bound of min-max. With so many `iterations` it is
    algorithm (20): steps of the fixed-point map from lam alpha in place of its root. Returned is which features' rows were
    held at the last sample.
    """
    n = rows.shape[1]
    row, x, held = np.empty(n + 1), np.zeros(n), np.zeros(n)
    square, lines, ones, coef = np.empty((2, n, n)), np.empty((6, n)), np.ones(n), np.empty((1, n))
    alpha, ridge = np.inf, 0.0
    for t in range(len(rows)):
        error = row[n] = outputs[t]
        for j in range(n):
            row[j] = rows[t, j]
            error -= row[j] * x[j]
            held[j] = forgetting * state[n + HELD, j]
        errors[t] = error
        take_in(state, n, row, 1.0, forgetting, share, False)
        if kind == LEAST:
            solve_least_squares(state, n, coef)
            copy_vector(coef[0], x)
            alpha = 0.0
        else:
            trace, energy, size = set_normal(state, n, 0, ones, square, lines)
            least, bound, start = ROUNDING * trace, settings[t], forgetting * alpha
            if kind == RIDGE:
                alpha = bound
                solve_ridge(state, n, 0, ones, alpha, square, lines, x)
            elif t < n or bound * bound * energy >= size:  # Theorem 1: eta >= |A'b| / |b|
                alpha = np.inf
                x[:] = 0.0
            elif kind == EXACT or alpha == np.inf:
                # alpha_t itself is nearer to alpha_(t+1) than lam alpha_t; out of the zero solution there is neither
                start = alpha if alpha < np.inf else trace / n
                alpha, evaluations[t], _ = search_min_max(
                    state, n, 0, ones, bound, start, least, square, lines, x
                )
            else:
                ridge, _ = solve_ridge(state, n, 0, ones, start, square, lines, x)
                for _ in range(iterations):
                    norm = 0.0
                    for i in range(n):
                        norm += x[i] * x[i]
                    alpha = max(bound * math.sqrt(ridge / norm), least)
                    ridge, _ = solve_ridge(state, n, 0, ones, alpha, square, lines, x)
                evaluations[t] = iterations
        alphas[t] = alpha
        copy_vector(x, estimates[t])
    return state[n + HELD, :n] > held


@kernel
def worst_residuals(rows, outputs, bounds, forgetting, estimates, worst):
    """|A x - b| + eta |x| of any estimates x_t, one a row."""
    n = rows.shape[1]
    state, row, ones, left = np.zeros((n + BESIDE, n + 1)), np.empty(n + 1), np.ones(n), np.empty(n)
    for t in range(len(rows)):
        copy_vector(rows[t], row)
        row[n] = outputs[t]
        take_in(state, n, row, 1.0, forgetting, 0.0, False)
        norm = 0.0
        for i in range(n):
            norm += estimates[t, i] * estimates[t, i]
        residual = _residual(state, n, 0, ones, estimates[t], left)
        worst[t] = math.sqrt(residual) + bounds[t] * math.sqrt(norm)
