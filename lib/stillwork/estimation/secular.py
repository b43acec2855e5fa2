"""The secular equation alpha = f(alpha) of Theorem 1, whose root is the min-max regularisation."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Count, Matrix, NonNegative, Positive
from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
    require_samples,
)
from stillwork.base.kernels import kernel
from stillwork.base.validation import by_value, check_fields, checked

# A singular value (or a part of b outside the column space) below this share of the largest is rounding.
ROUNDING = 10 * np.finfo(float).eps
CASES = ("regularised", "zero", "least squares", "segment")
REGULARISED, ZERO, LEAST_SQUARES, SEGMENT = range(4)


@kernel
def narrow_bracket(alpha, image, low, high):
    # Theorem 3: the iterates f(alpha) approach the root monotonically, so each of them bounds it
    if image > alpha:
        return max(low, image), high
    return low, min(high, image)


@kernel
def next_alpha(alpha, image, norm, residual, first, second, low, high):
    """Halley step towards the root of the secular equation.

    It solves bound(1/alpha)^-1 = eta^-1, which is nearly straight in 1/alpha at both ends. With
    P = (A'A + alpha I)^-1: image f(alpha), norm |x|^2, residual |A x - b|^2, first x'P x, second x'P^2 x.
    Outside the bracket it falls back to the bracket's middle, or strides while one end is missing. The second value
    returned is whether the step was so short that its cube, the error it leaves, is rounding.
    """
    per_norm = first / norm
    per_residual = alpha * first / residual
    slope = 1.0 - alpha * (per_norm + per_residual)  # of log bound over log alpha
    bend = (
        alpha
        * alpha
        * (
            3.0 * second / norm
            - 2.0 * per_norm * per_norm
            - first / residual
            + 3.0 * alpha * second / residual
            + 2.0 * per_residual * per_residual
        )
    )  # 1 + alpha^2 d^2 log bound / d alpha^2
    curvature = (slope - 1.0) ** 2 - bend
    miss = 1.0 - alpha / image
    ratio = 1.0 - 2.0 * miss * slope / (2.0 * slope * slope - miss * curvature)
    step = alpha / ratio
    # the bracket itself is uncertain by rounding
    if (1.0 - 1e-9) * low <= step <= (1.0 + 1e-9) * high and step < np.inf:
        return step, abs(step - alpha) <= 1e-5 * alpha
    if low == 0.0:
        return image / 8.0, False
    if high == np.inf:
        return image * 8.0, False
    return np.sqrt(low * high), False


@kernel
def secular_root(eigenvalues, c_squared, d_squared, bound, start):
    alpha = start
    low = 0.0
    high = np.inf
    evaluations = 0
    while evaluations < 200:
        norm = 0.0
        residual = 0.0
        first = 0.0
        second = 0.0
        for i in range(len(eigenvalues)):
            inverse = 1.0 / (eigenvalues[i] + alpha)
            part = c_squared[i] * inverse * inverse
            residual += part
            part *= eigenvalues[i]
            norm += part
            first += part * inverse
            second += part * inverse * inverse
        residual = d_squared + alpha * alpha * residual
        evaluations += 1
        image = bound * np.sqrt(residual / norm)
        low, high = narrow_bracket(alpha, image, low, high)
        step, near = next_alpha(alpha, image, norm, residual, first, second, low, high)
        if near or step == alpha:
            return step, evaluations
        alpha = step
    return alpha, evaluations


@kernel
def spectral_sums(eigenvalues, coefficients, excess):
    """tau = |A'b| / |b| and the free bound |S^-1 c| / |S^-2 c| of Theorem 1, and where a search from afar begins.

    The last is times (tau / eta - 1): there bound(1/alpha)^-1, linear from alpha = infinity, would meet eta^-1.
    """
    lowest = 0.0
    middle = 0.0
    highest = 0.0
    once = 0.0
    twice = 0.0
    for i in range(len(eigenvalues)):
        square = coefficients[i] * coefficients[i]
        lowest += square
        middle += square * eigenvalues[i]
        highest += square * eigenvalues[i] * eigenvalues[i]
        once += square / eigenvalues[i]
        twice += square / eigenvalues[i] / eigenvalues[i]
    whole = lowest + excess * excess
    return np.sqrt(middle / whole), np.sqrt(once / twice), highest / middle - middle / whole


@kernel
def min_max_root(eigenvalues, coefficients, excess, bound, tolerance):
    """Case of Theorem 1, alpha, tau, free bound and evaluations; two bounds count as one within `tolerance` of tau."""
    threshold = 0.0
    free = 0.0
    spread = 0.0
    for i in range(len(coefficients)):
        if coefficients[i] != 0.0:
            threshold, free, spread = spectral_sums(eigenvalues, coefficients, excess)
            free = min(free, threshold) if excess == 0.0 else 0.0
            break
    tie = tolerance * threshold
    if threshold == 0.0:
        return ZERO, np.inf, threshold, free, 0
    if bound == 0.0:
        return LEAST_SQUARES, 0.0, threshold, free, 0
    if excess == 0.0 and abs(threshold - free) <= tie and abs(bound - free) <= tie:
        return SEGMENT, 0.0, threshold, free, 0
    if bound >= threshold:
        return ZERO, np.inf, threshold, free, 0
    if bound <= free:
        return LEAST_SQUARES, 0.0, threshold, free, 0
    start = spread / (threshold / bound - 1.0)
    alpha, count = secular_root(eigenvalues, coefficients * coefficients, excess * excess, bound, start)
    return REGULARISED, alpha, threshold, free, count


@by_value
@dataclass(frozen=True)
class SecularFunction:
    """The map f of eq. (4) for one problem: its fixed point is the min-max regularisation."""

    eigenvalues: Float64[np.ndarray, " rank"]  # squares of the nonzero singular values of A, descending
    coefficients: Float64[np.ndarray, " rank"]  # c = U1'b
    excess: NonNegative  # |d|, the part of b outside the column space of A; 0 when that is rounding
    bound: NonNegative  # eta, on the 2-norm of the perturbation of A

    def __post_init__(self):
        check_fields(self)
        if self.eigenvalues.shape != self.coefficients.shape or np.any(self.eigenvalues <= 0):
            raise InputError(
                "eigenvalues must be above zero, one for each of the coefficients; leave the others out"
            )

    @property
    @checked
    def threshold(self) -> float:
        """tau = |A'b| / |b|: a bound at or above it makes the estimate zero (Theorem 1)."""
        return float(self._sums[0])

    @property
    @checked
    def free_bound(self) -> float:
        """|S^-1 c| / |S^-2 c|: up to it least squares is the solution, when b is in the column space."""
        return float(self._sums[1])

    @property
    def _sums(self):
        return spectral_sums(self.eigenvalues, self.coefficients, self.excess)

    @checked
    def __call__(self, alpha: float | ArrayLike) -> np.ndarray | float:
        """f(alpha), eq. (4), for a number or an array of alphas."""
        norm, residual, _ = self._terms(alpha)
        return self.bound * np.sqrt(residual / norm)

    @checked
    def slope(self, alpha: float | ArrayLike) -> np.ndarray | float:
        """f'(alpha), elementwise: f (q / |x|^2 + alpha q / |r|^2) with q = x'(A'A + alpha I)^-1 x.

        Parameters
        ----------
        alpha : float or array_like
            Where, above 0 or at it.

        Raises
        ------
        InputError
            When it overflows there.
        """
        alpha = require_array("alpha", alpha)
        norm, residual, slope = self._terms(alpha)
        return self.bound * np.sqrt(residual / norm) * slope * (1 / norm + alpha / residual)

    @checked
    def iterates(self, start: Positive, steps: Count) -> np.ndarray:
        """start, f(start), f(f(start)), ...: the iteration (21), `steps` + 1 values.

        Parameters
        ----------
        start : float
            First value.
        steps : int
            How often f is taken.

        Raises
        ------
        InputError
            When an iterate overflows.
        """
        values = [start]
        for _ in range(require_samples("steps", steps)):
            values.append(float(self(values[-1])))
        return np.array(values)

    @checked
    def root(self) -> tuple[float, int]:
        """Unique positive fixed point and the number of evaluations of f it took.

        Raises
        ------
        InputError
            When there is none: the estimate is zero or plain least squares (see `min_max_solve`).
        """
        lowest = self.free_bound if self.excess == 0 else 0.0
        if not lowest < self.bound < self.threshold:
            raise InputError(
                f"bound is {self.bound:g}; the secular equation has a positive root only for a bound "
                f"between {lowest:g} and {self.threshold:g}"
            )
        start = float(self._sums[2] / (self.threshold / self.bound - 1))
        return secular_root(self.eigenvalues, self.coefficients**2, self.excess**2, self.bound, start)

    def _terms(self, alpha):
        alpha = require_array("alpha", alpha)[..., None]
        if np.any(alpha < 0):
            raise InputError("alpha holds a negative number; a regularisation is zero or above")
        part = (self.coefficients / (self.eigenvalues + alpha)) ** 2
        norm = (self.eigenvalues * part).sum(-1)
        residual = self.excess**2 + (alpha**2 * part).sum(-1)
        return norm, residual, (self.eigenvalues * part / (self.eigenvalues + alpha)).sum(-1)


@checked
def secular_function(matrix: Matrix, target: ArrayLike, bound: NonNegative) -> SecularFunction:
    """The secular function of min-max estimation for data A, b and a bound, eq. (3)-(4).

    A has at least as many rows as unknowns, and A'b = 0 is refused: then no bound gives a nonzero estimate.
    """
    eigenvalues, coefficients, excess, _ = spectrum(matrix, require_problem(matrix, target))
    if not np.any(coefficients):
        raise InputError("target is orthogonal to every column of matrix; the estimate is zero for any bound")
    return SecularFunction(eigenvalues, coefficients, excess, bound)


@checked
def require_problem(matrix: Matrix, target: ArrayLike) -> np.ndarray:
    """The target b as an array, of as many rows as A, which are no fewer than unknowns."""
    rows, unknowns = matrix.shape
    if unknowns == 0:
        raise InputError("matrix has no columns; give at least one unknown")
    if rows < unknowns:
        raise InputError(
            f"matrix has {pluralise(rows, 'row')} for {pluralise(unknowns, 'unknown')}; give at least as many rows as unknowns"
        )
    return require_array("target", target, shape=(rows,))


def spectrum(matrix: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Eigenvalues of A'A that are not rounding, c = U1'b, |d| and the right singular vectors (unknowns x rank)."""
    left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    tolerance = len(matrix) * ROUNDING
    rank = int(np.count_nonzero(singular > tolerance * singular[0]))
    left, singular, right = left[:, :rank], singular[:rank], right[:rank]
    coefficients = left.T @ target
    # from the difference itself: |b|^2 - |c|^2 would lose half of the digits
    rest = target - left @ coefficients
    excess, least = math.sqrt(rest @ rest), tolerance * math.sqrt(target @ target)
    if excess <= least:
        excess = 0.0
    if math.sqrt(coefficients @ coefficients) <= least:
        coefficients = np.zeros(rank)
    return singular**2, coefficients, excess, right.T
