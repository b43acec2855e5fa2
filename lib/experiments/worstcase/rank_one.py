"""Eigendecomposition after a rank-one update, and the fast min-max recursion that it allows (Section 7).

Gu and Eisenstat, "A stable and efficient algorithm for the rank-one modification of the symmetric
eigenproblem" (1994): eigenvalues from their own secular equation, then eigenvectors from the weights
that belong exactly to the computed eigenvalues, so that they are orthogonal to rounding.
"""

from dataclasses import dataclass

import numpy as np

from stillwork.base.algebra import add_scaled, copy_vector, inner_product, minus_row, set_product
from stillwork.base.kernels import kernel
from stillwork.base.validation import by_value
from stillwork.estimation.recursive_kernels import ALPHA, COUNT, ENERGY
from stillwork.estimation.recursive_settings import MinMax
from stillwork.estimation.secular import secular_root

EPSILON = 2.220446049250313e-16
# |s|^2 of data as small as 1e-70 starts at 1e-280; below this its parts would underflow one by one.
FORGOTTEN = 1e-300


@kernel
def _eigenvalue(poles, weights, j, differences):
    """Eigenvalue j of diag(poles) + w w'; writes poles - eigenvalue, each to full relative accuracy.

    Root of 1 + sum w_i^2 / (poles_i - x) between pole j and the next, in the distance to the nearer of the
    two; rational interpolation through both poles (Bunch, Nielsen, Sorensen), bisection as safeguard.
    """
    k = len(poles)
    last = j == k - 1
    width = inner_product(weights, weights) if last else poles[j + 1] - poles[j]
    middle = 1.0
    for i in range(k):
        middle += weights[i] * weights[i] / ((poles[i] - poles[j]) - 0.5 * width)
    origin = j if last or middle >= 0.0 else j + 1
    # the distance to the origin: in (0, width / 2] from the left pole, in [-width / 2, 0) from the right
    low = 0.0 if origin == j else -0.5 * width
    high = (width if last and middle < 0.0 else 0.5 * width) if origin == j else 0.0
    distance = 0.5 * (low + high)
    for _ in range(100):
        below = 0.0
        below_slope = 0.0
        above = 0.0
        above_slope = 0.0
        for i in range(k):
            gap = (poles[i] - poles[origin]) - distance
            differences[i] = gap
            part = weights[i] / gap
            if i <= j:
                below += weights[i] * part
                below_slope += part * part
            else:
                above += weights[i] * part
                above_slope += part * part
        value = 1.0 + below + above
        if abs(value) <= EPSILON * k * (1.0 - below + above):
            break
        if value < 0.0:
            low = distance
        else:
            high = distance
        left = differences[j]
        if last:
            # a single pole: value ~ constant + weight / (left - step)
            constant = value - left * below_slope
            step = left + left * left * below_slope / constant if constant > 0.0 else np.inf
        else:
            right = differences[j + 1]
            slope = below_slope + above_slope
            constant = value - left * below_slope - right * above_slope
            linear = (left + right) * value - left * right * slope
            square = left * right * value
            root = np.sqrt(max(linear * linear - 4.0 * square * constant, 0.0))
            if linear <= 0.0:
                step = (linear - root) / (2.0 * constant) if constant != 0.0 else square / linear
            else:
                step = 2.0 * square / (linear + root)
        following = distance + step
        if not low < following < high:
            following = 0.5 * (low + high)
        if following == distance or following == low or following == high:
            break
        distance = following
    for i in range(k):
        differences[i] = (poles[i] - poles[origin]) - distance
    return poles[origin] + distance


@kernel
def _deflate(values, vectors, weights, tolerance, kept):
    # Eigenpairs that the update leaves alone get weight 0: those orthogonal to the row, and one of every
    # pair of (numerically) equal eigenvalues, after a rotation that moves the weight to the other.
    n = len(values)
    count = 0
    for i in range(n):
        if abs(weights[i]) <= tolerance:
            continue
        if count > 0:
            j = kept[count - 1]
            length = np.hypot(weights[i], weights[j])
            cosine = weights[i] / length
            sine = weights[j] / length
            gap = values[i] - values[j]
            if abs(gap * cosine * sine) <= tolerance:
                for m in range(n):
                    first = vectors[j, m]
                    second = vectors[i, m]
                    vectors[j, m] = cosine * first - sine * second
                    vectors[i, m] = sine * first + cosine * second
                values[j] += gap * sine * sine
                values[i] -= gap * sine * sine
                weights[i] = length
                kept[count - 1] = i
                continue
        kept[count] = i
        count += 1
    return count


@kernel
def update_eigenpairs(values, vectors, row, forgetting):
    """Turn the eigenpairs of R (values ascending, vectors as rows) into those of lam R + a a', in place.

    O(n^2) but for the last product of the vectors, which costs 2 n^3.
    """
    n = len(values)
    weights = np.zeros(n)
    set_product(vectors, row, weights)
    length = inner_product(weights, weights)
    for i in range(n):
        values[i] *= forgetting
    if length == 0.0:
        return
    scale = max(values[n - 1], length)
    # both tests in one unit: a weight of this size moves an eigenvalue by rounding
    for i in range(n):
        weights[i] /= np.sqrt(scale)
        values[i] /= scale
    kept = np.zeros(n, np.int64)
    count = _deflate(values, vectors, weights, 4.0 * EPSILON, kept)
    poles = np.zeros(count)
    poles_weights = np.zeros(count)
    for i in range(count):
        poles[i] = values[kept[i]]
        poles_weights[i] = weights[kept[i]]
    new_values = np.zeros(count)
    new_vectors = np.zeros((count, count))  # row j: poles - eigenvalue j, then eigenvector j
    for j in range(count):
        new_values[j] = _eigenvalue(poles, poles_weights, j, new_vectors[j])
    # weights that make the computed eigenvalues exact (Loewner)
    for i in range(count):
        product = -new_vectors[i, i]
        for j in range(count):
            if j != i:
                product *= new_vectors[j, i] / (poles[i] - poles[j])
        poles_weights[i] = np.copysign(np.sqrt(max(product, 0.0)), poles_weights[i])
    old = np.zeros((count, n))
    for j in range(count):
        vector = new_vectors[j]
        for i in range(count):
            vector[i] = poles_weights[i] / vector[i]
        size = np.sqrt(inner_product(vector, vector))
        for i in range(count):
            vector[i] /= size
        copy_vector(vectors[kept[j]], old[j])
    turned = np.dot(new_vectors, old)
    for j in range(count):
        values[kept[j]] = new_values[j]
        copy_vector(turned[j], vectors[kept[j]])
    for i in range(n):
        values[i] *= scale
        # into ascending order: few are out of place, for only those that the update left alone can be passed
        j = i
        while j > 0 and values[j - 1] > values[j]:
            values[j - 1], values[j] = values[j], values[j - 1]
            for m in range(n):
                vectors[j - 1, m], vectors[j, m] = vectors[j, m], vectors[j - 1, m]
            j -= 1


@kernel
def run_fast(
    rows, outputs, bounds, forgetting, values, vectors, correlation, scalars, estimate,
    estimates, errors, alphas, evaluations,
):  # fmt: skip
    """The exact min-max solution at every step: eigenpairs by rank-one updates, then O(n) per Newton step."""
    n = len(estimate)
    shares = np.zeros(n)
    squares = np.zeros(n)
    for t in range(len(outputs)):
        errors[t] = minus_row(outputs[t], rows, t, estimate)
        for i in range(n):
            correlation[i] = forgetting * correlation[i] + rows[t, i] * outputs[t]
        size = inner_product(correlation, correlation)
        scalars[ENERGY] = forgetting * scalars[ENERGY] + outputs[t] * outputs[t]
        scalars[COUNT] += 1.0
        update_eigenpairs(values, vectors, rows[t], forgetting)
        count = 0
        alpha = np.inf
        for i in range(n):
            estimate[i] = 0.0
        if scalars[COUNT] > n and max(bounds[t] * bounds[t] * scalars[ENERGY], FORGOTTEN) < size:
            excess = scalars[ENERGY]
            mean = 0.0
            set_product(vectors, correlation, shares)
            for i in range(n):
                mean += values[i] / n
            # below rounding an eigenvalue holds no information; after a silence all but one are
            first = 0
            while first < n - 1 and not values[first] > n * EPSILON * values[n - 1]:
                first += 1
            for i in range(first, n):
                squares[i] = shares[i] * shares[i] / values[i]
                excess -= squares[i]
            start = scalars[ALPHA] if scalars[ALPHA] < np.inf else mean
            alpha, count = secular_root(values[first:], squares[first:], max(excess, 0.0), bounds[t], start)
            for i in range(first, n):
                add_scaled(shares[i] / (values[i] + alpha), vectors[i], estimate)
        scalars[ALPHA] = alpha
        alphas[t] = alpha
        evaluations[t] = count
        copy_vector(estimate, estimates[t])


@by_value
@dataclass(frozen=True)
class FastMinMax(MinMax):
    """`MinMax` whose exact root comes from rank-one updates of the eigenvectors of R, Section 7."""

    def start(self, unknowns: int) -> tuple[np.ndarray, ...]:
        """Eigenvalues and eigenvectors of R, s, and what the update of alpha keeps."""
        return np.zeros(unknowns), np.eye(unknowns), *super().start(unknowns)[1:4]

    def fill(self, state, bounds, rows, outputs, *track) -> None:
        run_fast(rows, outputs, bounds, self.forgetting, *state, *track)
