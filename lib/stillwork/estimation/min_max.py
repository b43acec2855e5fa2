"""Min-max estimation from one block of data: Theorem 1 with all of its cases."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Matrix, NonNegative, Vector
from stillwork.base.validation import by_value, checked
from stillwork.estimation.secular import CASES, ROUNDING, ZERO, min_max_root, require_problem, spectrum


class ZeroEstimateWarning(UserWarning):
    """The bound admits a perturbation that explains all of the data: the estimate is zero."""


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
    result does not depend on their units.

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
        For data that are not finite or of the wrong shape, fewer rows than unknowns, or an invalid bound.

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
    scaled, aimed, units = _in_units(matrix, require_problem(matrix, target))
    parts = spectrum(scaled, aimed)
    return [_solution(scaled, aimed, units, parts, bound) for bound in bounds]


def solve_plain(matrix: np.ndarray, target: np.ndarray, bound: float) -> tuple[np.ndarray, bool]:
    """The estimate for arrays that need no check, and whether the bound makes it zero."""
    scaled, aimed, units = _in_units(matrix, target)
    case, _, threshold, _, _, estimate = _solved(spectrum(scaled, aimed), len(scaled), bound / units[0])
    return estimate * (units[1] / units[0]), bool(case == ZERO and threshold > 0)


def _in_units(matrix, target) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    units = _size(matrix), _size(target)
    return matrix / units[0], target / units[1], units


def _solved(parts, rows, bound):
    # in units of the data: what `min_max_root` gives, and the estimate
    eigenvalues, coefficients, excess, right = parts
    found = min_max_root(eigenvalues, coefficients, excess, bound, rows * ROUNDING)
    return *found, right @ (np.sqrt(eigenvalues) * coefficients / (eigenvalues + found[1]))


def _solution(scaled, aimed, units, parts, bound) -> MinMaxSolution:
    """Solution of the data, which are given over their units."""
    matrix_unit, target_unit = units
    case, alpha, threshold, free, evaluations, estimate = _solved(parts, len(scaled), bound / matrix_unit)
    residual = scaled @ estimate - aimed
    worst = np.linalg.norm(residual) + bound / matrix_unit * np.linalg.norm(estimate)
    return MinMaxSolution(
        estimate=estimate * (target_unit / matrix_unit),
        alpha=float(alpha * matrix_unit**2),
        worst_case_residual=float(worst * target_unit),
        perturbation=_worst_perturbation(residual, estimate, bound),
        case=CASES[case],
        threshold=threshold * matrix_unit,
        free_bound=free * matrix_unit,
        rank=len(parts[0]),
        evaluations=evaluations,
    )


@checked
def qr_r(rows: np.ndarray) -> np.ndarray:
    """R of the QR decomposition; it keeps the norm of every combination of the columns."""
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
