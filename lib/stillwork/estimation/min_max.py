"""Min-max estimation from one block of data: Theorem 1 with all of its cases."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Matrix, NonNegative, Vector
from stillwork.base.validation import by_value, checked
from stillwork.estimation.secular import ROUNDING, SecularFunction, decompose


class ZeroEstimateWarning(UserWarning):
    """The bound admits a perturbation that explains all of the data away: the estimate is zero."""


@by_value
@dataclass(frozen=True)
class MinMaxSolution:
    """Solution of min over x of max over |dA| <= eta of |(A + dA) x - b|, Theorem 1.

    The case is ``regularised`` (a positive root alpha); ``zero`` (eta at or above `threshold`); ``least squares``
    (eta = 0, or b in the column space and eta at most `free_bound`); ``segment`` (b in the column space and
    eta = `free_bound` = `threshold`: every point between zero and least squares is optimal, least squares is returned).
    """

    estimate: Float64[np.ndarray, " unknowns"]  # x
    alpha: float  # x = (A'A + alpha I)^-1 A'b; infinite when x = 0
    worst_case_residual: float  # |A x - b| + eta |x|, the largest that the bound admits
    perturbation: Float64[np.ndarray, "rows unknowns"]  # dA that attains it; 0 when x = 0: each does
    case: str
    threshold: float  # tau = |A'b| / |b|: from this bound on the estimate is zero
    free_bound: float  # up to this least squares; 0 unless b is in the column space of A
    rank: int  # numerical, of A
    evaluations: int  # of the secular function, for the root


@checked(infinite=True)
def min_max_solve(matrix: ArrayLike, target: ArrayLike, bound: NonNegative) -> MinMaxSolution:
    """Estimate x in b = (A + dA) x + v when only a bound on the 2-norm of dA is known.

    The estimate minimises the worst residual that a perturbation of norm at most `bound` can cause. It is
    ridge regression whose penalty follows from the bound through a scalar equation, which is solved by
    a safeguarded Newton iteration on the singular values. Data are scaled before and by the solve: the
    answer does not depend on their units.

    Parameters
    ----------
    matrix : array_like, shape (rows, unknowns)
        A, at least as many rows as unknowns; rank deficiency is allowed and gives the shortest solution.
    target : array_like, shape (rows,)
        b.
    bound : float
        eta >= 0, in the unit of A.

    Returns
    -------
    MinMaxSolution

    Raises
    ------
    InputError
        For data that are not finite or of the wrong shape, fewer rows than unknowns, a bad bound.

    Warns
    -----
    ZeroEstimateWarning
        When the bound is so large that the estimate is zero.

    References
    ----------
    Sayed, Garulli, Nascimento, Chandrasekaran, "Exponentially-weighted iterative solutions for worst-case
    parameter estimation", Theorem 1 and the remarks after it. The case of b in the column space of A
    follows from the limit of eq. (4) for |d| to 0.

    Examples
    --------
    >>> solution = estimation.min_max_solve([[1.0], [1.0]], [2.0, 1.0], bound=0.5)
    >>> solution.estimate.round(3)  # 1.5 by least squares
    array([1.311])
    """
    solution = solve_silently(matrix, target, bound)
    if solution.case == "zero" and solution.threshold > 0:
        warnings.warn(
            f"bound {bound:g} is at or above {solution.threshold:g} = |A'b|/|b|, so the estimate is zero: a "
            "perturbation of this size explains all of the data; give a smaller bound or more data",
            ZeroEstimateWarning,
            stacklevel=3,
        )
    return solution


@checked(infinite=True)
def solve_silently(matrix: ArrayLike, target: ArrayLike, bound: NonNegative) -> MinMaxSolution:
    """`min_max_solve` without its warning, where a zero estimate is a result."""
    return solve_sweep(matrix, target, [bound])[0]


@checked(infinite=True)
def solve_sweep(matrix: Matrix, target: Vector, bounds: Iterable[NonNegative]) -> list[MinMaxSolution]:
    """`solve_silently` for several bounds, with one decomposition of the data."""
    bounds = list(bounds)
    matrix_unit = _size(matrix)
    target_unit = _size(target)
    scaled, aimed = matrix / matrix_unit, target / target_unit
    function, right, rank = decompose(scaled, aimed, 0.0)
    return [
        _solution(
            scaled, aimed, replace(function, bound=bound / matrix_unit), right, rank, matrix_unit, target_unit
        )
        for bound in bounds
    ]


def _solution(
    scaled: np.ndarray,
    aimed: np.ndarray,
    function: SecularFunction,
    right: np.ndarray,
    rank: int,
    matrix_unit: float,
    target_unit: float,
) -> MinMaxSolution:
    """Solution of the data, which are given over their units."""
    bound = function.bound
    threshold = free = 0.0
    if np.any(function.coefficients):
        threshold = function.threshold
        free = min(function.free_bound, threshold) if function.excess == 0 else 0.0
    tie = len(scaled) * ROUNDING * threshold
    evaluations = 0
    if threshold == 0:
        case, alpha = "zero", np.inf
    elif bound == 0:
        case, alpha = "least squares", 0.0
    elif function.excess == 0 and abs(threshold - free) <= tie and abs(bound - free) <= tie:
        case, alpha = "segment", 0.0
    elif bound >= threshold:
        case, alpha = "zero", np.inf
    elif bound <= free:
        case, alpha = "least squares", 0.0
    else:
        case = "regularised"
        alpha, evaluations = function.root()
    weights = np.sqrt(function.eigenvalues) * function.coefficients / (function.eigenvalues + alpha)
    estimate = right @ weights
    residual = scaled @ estimate - aimed
    worst = np.linalg.norm(residual) + bound * np.linalg.norm(estimate)
    return MinMaxSolution(
        estimate=estimate * (target_unit / matrix_unit),
        alpha=float(alpha * matrix_unit**2),
        worst_case_residual=float(worst * target_unit),
        perturbation=_worst_perturbation(residual, estimate, bound * matrix_unit),
        case=case,
        threshold=threshold * matrix_unit,
        free_bound=free * matrix_unit,
        rank=rank,
        evaluations=evaluations,
    )


@checked
def qr_r(rows: np.ndarray) -> np.ndarray:
    """Triangle with the norm of every combination of the columns: what least squares and min-max need of rows."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _size(values: np.ndarray) -> float:
    return float(np.max(np.abs(values), initial=0.0)) or 1.0


def _worst_perturbation(residual, estimate, bound) -> np.ndarray:
    # eta r x' / (|r| |x|) turns all of its size into residual
    length = np.linalg.norm(estimate)
    size = np.linalg.norm(residual)
    if length == 0:
        return np.zeros((len(residual), len(estimate)))
    direction = residual / size if size > 0 else np.eye(len(residual))[0]
    return bound * np.outer(direction, estimate / length)
