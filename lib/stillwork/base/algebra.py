"""Algebra of small matrices inside kernels: products, factorisations, and what one measurement does to a covariance.

Every sum runs in index order, whatever calls it, so that two kernels that compute one thing agree to the last bit.
"""

from stillwork.base.kernels import inlined_kernel, pasted_kernel


@inlined_kernel
def copy_vector(source, target):
    """In a loop: a slice assignment would triple the time to compile."""
    for i in range(len(source)):
        target[i] = source[i]


@pasted_kernel
def inner_product(left, right):
    """Left' right."""
    total = 0.0
    for i in range(len(left)):
        total += left[i] * right[i]
    return total


@pasted_kernel
def plus_row(start, matrix, i, vector):
    """Start + row `i` of the matrix times the vector; no view of the row is made, which a `kernel` would count."""
    for j in range(matrix.shape[1]):
        start += matrix[i, j] * vector[j]
    return start


@pasted_kernel
def minus_row(start, matrix, i, vector):
    """Start - row `i` of the matrix times the vector."""
    for j in range(matrix.shape[1]):
        start -= matrix[i, j] * vector[j]
    return start


@pasted_kernel
def plus_column(start, matrix, j, vector):
    """Start + column `j` of the matrix, transposed, times the vector."""
    for i in range(matrix.shape[0]):
        start += matrix[i, j] * vector[i]
    return start


@pasted_kernel
def plus_left(start, matrix, i, vector):
    """Start + what stands left of the diagonal in row `i`, times the vector."""
    for j in range(i):
        start += matrix[i, j] * vector[j]
    return start


@pasted_kernel
def minus_left(start, matrix, i, vector):
    """Start - what stands left of the diagonal in row `i`, times the vector."""
    for j in range(i):
        start -= matrix[i, j] * vector[j]
    return start


@inlined_kernel
def add_scaled(factor, vector, target):
    """Target += factor vector."""
    for i in range(len(vector)):
        target[i] += factor * vector[i]


@pasted_kernel
def set_product(matrix, vector, out):
    """Out = matrix vector."""
    for i in range(matrix.shape[0]):
        out[i] = plus_row(0.0, matrix, i, vector)


@pasted_kernel
def project(matrix, vector, start, out):
    """Out = matrix vector; returns start + vector' out. All in the precision of the matrix."""
    zero = matrix.dtype.type(0)
    for i in range(len(vector)):
        out[i] = plus_row(zero, matrix, i, vector)
        start += out[i] * vector[i]
    return start


@inlined_kernel
def add_product(matrix, vector, out):
    """Out += matrix vector."""
    for i in range(matrix.shape[0]):
        out[i] = plus_row(out[i], matrix, i, vector)


@inlined_kernel
def advance_state(a, b, drive, state, following):
    """State = b drive + a state, for one input; `following` is scratch."""
    for i in range(len(state)):
        following[i] = plus_row(b[i] * drive, a, i, state)
    copy_vector(following, state)


@pasted_kernel
def multiply(left, right, out):
    """Out = left right."""
    for i in range(left.shape[0]):
        for j in range(right.shape[1]):
            total = 0.0
            for k in range(left.shape[1]):
                total += left[i, k] * right[k, j]
            out[i, j] = total


@pasted_kernel
def congruence(matrix, middle, half, out):
    """Out = matrix middle matrix', exactly symmetric; `half` is scratch, `out` may be `middle`."""
    multiply(matrix, middle, half)
    for i in range(matrix.shape[0]):
        for j in range(i + 1):
            out[i, j] = out[j, i] = plus_row(0.0, half, i, matrix[j])


@pasted_kernel
def add_square(factor, out):
    """Out += factor factor', on an exactly symmetric `out`."""
    for i in range(factor.shape[0]):
        for j in range(i + 1):
            out[i, j] = out[j, i] = plus_row(out[i, j], factor, i, factor[j])


@pasted_kernel
def measure(covariance, rows, o, noise, cross):
    """Fill cross = covariance row' with row o; returns the variance of what is measured, row covariance row' + noise."""
    return project(covariance, rows[o], noise, cross)


@pasted_kernel
def condition(covariance, cross, variance):
    """Covariance once the measurement is taken in: -= cross cross' / variance."""
    for i in range(len(cross)):
        for j in range(len(cross)):
            covariance[i, j] -= cross[i] * cross[j] / variance


@pasted_kernel
def take_in_turn(covariance, rows, noise, gain, cross):
    """Take in independent measurements one after the other; `gain` becomes that of all of them together."""
    for o in range(rows.shape[0]):
        variance = measure(covariance, rows, o, noise[o], cross)
        for j in range(o):
            seen = plus_column(0.0, gain, j, rows[o])
            for i in range(rows.shape[1]):
                gain[i, j] -= cross[i] / variance * seen
        for i in range(rows.shape[1]):
            gain[i, o] = cross[i] / variance
        condition(covariance, cross, variance)


@inlined_kernel
def factorise(information, alpha, right, factor, inverse_pivots, half, work):
    # R + alpha I = L D L' with L in `factor`; half = L^-1 right on the way. Sums run along rows: at a few
    # unknowns the chain of pivots is what costs time, and this order keeps it shortest.
    for i in range(len(half)):
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


@inlined_kernel
def solve_forward(factor, right, half):
    # Written out: of a call, a kernel compiled for its number of unknowns would not unroll the loop.
    for i in range(len(half)):
        total = right[i]
        for j in range(i):
            total -= factor[i, j] * half[j]
        half[i] = total


@inlined_kernel
def solve_backward(factor, inverse_pivots, half, solution):
    n = len(half)
    for i in range(n - 1, -1, -1):
        rest = half[i] * inverse_pivots[i]
        for j in range(i + 1, n):
            rest -= factor[j, i] * solution[j]
        solution[i] = rest


@pasted_kernel
def cholesky_root(matrix, root, size):
    """Lower root of a symmetric matrix; false when it is not positive definite."""
    for i in range(size):
        for j in range(i + 1):
            total = minus_left(matrix[i, j], root, j, root[i])
            if i == j:
                if not total > 0.0:
                    return False
                root[i, i] = total**0.5
            else:
                root[i, j] = total / root[j, j]
    return True


@pasted_kernel
def cholesky_solve(root, right, solution):
    """Solution = (root root')^-1 right, with the lower root of `cholesky_root`; it may be `right`."""
    n = len(solution)
    for i in range(n):
        solution[i] = minus_left(right[i], root, i, solution) / root[i, i]
    for i in range(n - 1, -1, -1):
        total = solution[i]
        for j in range(i + 1, n):
            total -= root[j, i] * solution[j]
        solution[i] = total / root[i, i]


@pasted_kernel
def copy_matrix(source, target):
    """In loops: a slice assignment would triple the time to compile."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@pasted_kernel
def squared_size(number):
    """Of a complex number: real^2 + imag^2."""
    return number.real * number.real + number.imag * number.imag
