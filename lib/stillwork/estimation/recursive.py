"""Estimates at every sample of a record: least squares, ridge regression and min-max estimation, from one triangle."""

import warnings
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Matrix, Natural, Positive, within
from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
)
from stillwork.base.validation import by_value, checked
from stillwork.estimation.min_max import ZeroEstimateWarning
from stillwork.estimation.triangle_kernels import (
    APPROXIMATE,
    EXACT,
    LEAST,
    RIDGE,
    least_share,
    start_record,
    track_rows,
    worst_residuals,
)

# The kernels work with |X'y|^2, the fourth power of the data, which must neither overflow nor vanish.
LARGEST = 1e70


@by_value
@dataclass(frozen=True)
class Track:
    """Results of an estimator over a record."""

    estimates: Float64[np.ndarray, "unknowns samples"]  # x_t; min-max: 0 up to as many samples
    errors: Float64[np.ndarray, " samples"]  # y_t - a_t'x_(t-1), before the sample is used
    alphas: Float64[np.ndarray, " samples"]  # x_t = (R_t + alpha_t I)^-1 s_t; infinite where x_t = 0
    evaluations: Int64[np.ndarray, " samples"]  # of the secular function, a step
    held: Bool[np.ndarray, " unknowns"]  # whose variance `growth_limit` held down at the last sample


@checked(infinite=True)
def track(
    regressors: Matrix,
    outputs: ArrayLike,
    forgetting: Annotated[float, within(above=0.0, at_most=1.0)] = 1.0,
    *,
    bound: ArrayLike | None = None,
    iterations: Natural = 0,
    penalty: Positive | None = None,
    initial_covariance: Positive | None = None,
    growth_limit: float = 1e6,
    silent: bool = False,
) -> Track:
    """Estimates of all rows so far at every sample, of which row j counts forgetting^(t - j).

    Without `bound` and `penalty` they are of least squares.

    Parameters
    ----------
    regressors : array_like, shape (unknowns, samples)
        Columns a_t; `fir_regressors` makes them from a signal.
    outputs : array_like, shape (samples,)
        y_t.
    forgetting : float
        lambda in (0, 1].
    bound : float or array_like, shape (samples,), optional
        eta, in the unit of the regressors: the min-max estimate minimises the largest |(A_t + dA) x - b_t| over
        |dA| <= eta of the weighted data; `exponential_bound` gives it from a bound on each row.
    iterations : int
        0 for the exact min-max estimate, Theorem 1 at each sample; else so many fixed-point steps of algorithm (20), of
        which the published one takes 1.
    penalty : float, optional
        Of ridge regression, x = (R + penalty I)^-1 s, in the unit of the squared regressors, summed over the window.
    initial_covariance : float, optional
        P_0 = initial_covariance I before the first sample, in the unit of 1 / regressor^2: large means that the start at
        x = 0 has no weight. Without it the start has none.
    growth_limit : float
        How far the variance of a combination may grow beyond its smallest while nothing excites it; of least squares.
    silent : bool
        Whether to leave out the warnings, for sweeps in which a zero estimate is a result.

    Returns
    -------
    Track

    Raises
    ------
    InputError
        For NaN or infinite samples, shapes that do not fit, no more samples than unknowns, or data so large or small
        (1e70, 1e-70) that their squares leave the range of floating-point numbers.

    Warns
    -----
    ZeroEstimateWarning
        When a min-max bound is so large that every estimate is zero.
    GrowthLimitWarning
        When the record ends while `growth_limit` holds a variance: that unknown is not excited, or follows slowly.

    References
    ----------
    Sayed, Garulli, Nascimento, Chandrasekaran, "Exponentially-weighted iterative solutions for worst-case
    parameter estimation", Theorem 1, (20). With h as printed, (15) and (18) need lam alpha_t.

    Examples
    --------
    >>> estimation.track(np.ones((1, 5)), 2 * np.ones(5), 0.98).errors.round(2)  # before each sample is used
    array([2., 0., 0., 0., 0.])
    >>> rows = identification.fir_regressors(np.random.default_rng(1).standard_normal(500), taps=2)
    >>> bounded = estimation.track(rows, [0.7, 0.2] @ rows, 0.98, bound=1.0).estimates[:, -1]
    >>> bool(np.linalg.norm(bounded) <= np.hypot(0.7, 0.2))  # the uncertainty only shrinks
    True
    """
    outputs = _require_record(regressors, outputs)
    kind, each = _kind(bound, iterations, penalty, outputs.shape)
    rows = np.ascontiguousarray(regressors.T)
    first = np.zeros((1, rows.shape[1]))
    state = start_record(first, initial_covariance)
    estimates, errors, alphas = np.zeros(rows.shape), np.zeros(len(rows)), np.zeros(len(rows))
    evaluations = np.zeros(len(rows), np.int64)
    found = estimates, errors, alphas, evaluations
    share = least_share(growth_limit) if kind == LEAST else 0.0
    held = track_rows(kind, state, rows, outputs, float(forgetting), share, each, iterations, *found)
    result = Track(np.ascontiguousarray(estimates.T), errors, alphas, evaluations, held & (kind == LEAST))
    if not silent:
        _warn(result, kind in (EXACT, APPROXIMATE) and np.any(regressors @ outputs))
    return result


def _kind(bound, iterations, penalty, shape) -> tuple[int, np.ndarray]:
    # which estimate, and the number that it takes at each sample
    if bound is None:
        return (LEAST, np.zeros(shape)) if penalty is None else (RIDGE, np.full(shape, float(penalty)))
    if penalty is not None:
        raise InputError("penalty is of ridge regression, bound of min-max estimation; give one of them")
    bounds = require_array("bound", bound)
    if bounds.shape not in ((), shape) or np.any(bounds < 0):
        raise InputError(
            f"bound is {bounds.shape} numbers; give one of zero or above, or one for each sample"
        )
    return APPROXIMATE if iterations else EXACT, np.broadcast_to(bounds, shape).copy()


def _require_record(regressors, outputs) -> np.ndarray:
    unknowns, samples = regressors.shape
    if unknowns == 0:
        raise InputError("regressors has no rows; give at least one unknown")
    outputs = require_array("outputs", outputs, shape=(samples,))
    if samples <= unknowns:
        raise InputError(
            f"regressors has {pluralise(samples, 'sample')} for {pluralise(unknowns, 'unknown')}; give more samples than unknowns"
        )
    for name, values in (("regressors", regressors), ("outputs", outputs)):
        require_squares(name, values)
    return outputs


def _warn(result: Track, informative) -> None:
    # without any correlation zero is the solution for every bound
    if informative and np.isinf(result.alphas).all():
        warnings.warn(
            "every estimate is zero: at each step the bound is at or above |A'b|/|b|, so a perturbation of "
            "that size explains all of the data; give a smaller bound",
            ZeroEstimateWarning,
            stacklevel=4,
        )
    if result.held.any():
        warn_held(np.flatnonzero(result.held), stacklevel=6)


class GrowthLimitWarning(UserWarning):
    """The guard against wind-up acts at the end of a record: the unknown is not excited, or follows slowly."""


@checked
def warn_held(unknowns: ArrayLike, stacklevel: int) -> None:
    """Warn that `growth_limit` limits the variance of these unknowns, given by number."""
    numbers = ", ".join(f"{unknown:g}" for unknown in require_array("unknowns", unknowns, ndim=1))
    warnings.warn(
        f"growth_limit holds the variance of unknown {numbers} down at the last sample: nothing "
        "excites it, or its regressor has become much smaller and its estimate follows slowly; excite it, leave it "
        "out, or give a larger growth_limit",
        GrowthLimitWarning,
        stacklevel=stacklevel,
    )


def require_finite_squares(name: str, values) -> float:
    """Refuse numbers of which one is too large for the kernels; returns the largest, NaN left out."""
    largest = np.fmax.reduce(np.abs(values), axis=None, initial=0.0)
    if largest > LARGEST:
        raise InputError(f"{name} reaches {largest:g}, too large to be squared; use another unit")
    return largest


def require_squares(name: str, values) -> None:
    """As `require_finite_squares`, and refuse numbers that are all too small, but not zero."""
    largest = require_finite_squares(name, values)
    if 0 < largest < 1 / LARGEST:
        raise InputError(f"{name} is nowhere above {largest:g}, too small to be squared; use another unit")


@checked
def worst_case_residuals(
    regressors: Matrix,
    outputs: ArrayLike,
    estimates: ArrayLike,
    bounds: ArrayLike,
    forgetting: Annotated[float, within(above=0.0, at_most=1.0)],
) -> np.ndarray:
    """|A_t x_t - b_t| + eta_t |x_t| of any estimates, the criterion that min-max estimation minimises.

    Regressors and estimates are (unknowns, samples); the forgetting, at most 1, weighs all rows alike at 1.
    """
    estimates = require_array("estimates", estimates, shape=regressors.shape)
    outputs = require_array("outputs", outputs, shape=regressors.shape[1:])
    bounds = require_array("bounds", bounds, shape=regressors.shape[1:])
    if np.any(bounds < 0):
        raise InputError("bounds holds a negative value; give bounds on a norm, zero or above")
    worst = np.empty(len(outputs))
    rows, points = np.ascontiguousarray(regressors.T), np.ascontiguousarray(estimates.T)
    worst_residuals(rows, outputs, bounds, forgetting, points, worst)
    return worst
