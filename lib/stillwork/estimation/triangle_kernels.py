"""One row more in the triangle of a record, and the min-max estimate from it without a singular value decomposition."""

import numpy as np

from stillwork.base.algebra import cholesky_solve
from stillwork.base.kernels import kernel
from stillwork.estimation.secular import ROUNDING, narrow_bracket, next_alpha

# Below these shares of the data the rank decides, which singular values show and a triangle does not.
LEAST_EXCESS, LEAST_PENALTY = 1e-9, 1e-20
EVALUATIONS = 60


@kernel
def add_row(triangle, row, root):
    """The triangle of `root` times the rows that it stands for and one row more, in place; `row` is used up."""
    if root != 1.0:
        triangle *= root
    for k in range(len(row)):
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
