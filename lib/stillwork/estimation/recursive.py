"""Recursive estimators with one interface: `run` over a record."""

import warnings
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.bounds import Matrix, within
from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
)
from stillwork.base.validation import checked
from stillwork.estimation import recursive_kernels
from stillwork.estimation.min_max import ZeroEstimateWarning
from stillwork.estimation.recursive_settings import Estimator, GrowingMinMax, MinMax, Track

# The recursions work with |s|^2, the fourth power of the data, which must neither overflow nor vanish.
LARGEST = 1e70


@checked(infinite=True)
def run(estimator: Estimator, regressors: ArrayLike, outputs: ArrayLike) -> Track:
    """Run an estimator over a record.

    Parameters
    ----------
    estimator : MinMax, GrowingMinMax, LeastSquares or Ridge
    regressors : array_like, shape (unknowns, samples)
        Columns a_t; `fir_regressors` makes them from a signal.
    outputs : array_like, shape (samples,)
        y_t.

    Returns
    -------
    Track

    Raises
    ------
    InputError
        For NaN or infinite samples, shapes that do not fit, no more samples than unknowns, data so large
        or small (1e70, 1e-70) that their squares leave the range of floating-point numbers, or an estimate
        that overflows; the message names the sample.

    Warns
    -----
    ZeroEstimateWarning
        When a min-max bound is so large that every estimate is zero.
    GrowthLimitWarning
        When the record ends while `growth_limit` of least squares limits a variance: that unknown is not
        excited, or follows slowly.

    Examples
    --------
    >>> track = estimation.run(estimation.LeastSquares(0.98), np.ones((1, 5)), 2 * np.ones(5))
    >>> track.errors.round(2)  # of the prediction, before each sample is used
    array([2., 0., 0., 0., 0.])
    """
    track = run_silently(estimator, regressors, outputs)
    # without any correlation zero is the solution for every bound
    informative = np.any(np.asarray(regressors, dtype=float) @ np.asarray(outputs, dtype=float))
    if _is_min_max(estimator) and informative and np.isinf(track.alphas).all():
        warnings.warn(
            "every estimate is zero: at each step the bound is at or above |A'b|/|b|, so a perturbation of "
            "that size explains all of the data; give a smaller bound",
            ZeroEstimateWarning,
            stacklevel=3,
        )
    if track.held.any():
        warn_held(np.flatnonzero(track.held), stacklevel=5)
    return track


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


@checked(missing=True)
def run_silently(estimator: Estimator, regressors: Matrix, outputs: ArrayLike) -> Track:
    """`run` without its warning, for sweeps in which a zero estimate is a result."""
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
    track = estimator.advance(estimator.start(unknowns), 0, np.ascontiguousarray(regressors.T), outputs)
    _require_finite(track.estimates.T, track.errors)
    return track


def _is_min_max(estimator) -> bool:
    return isinstance(estimator, MinMax | GrowingMinMax)


def _require_finite(estimates, errors) -> None:
    finite = np.isfinite(errors) & np.isfinite(estimates).all(axis=1)
    if not finite.all():
        raise InputError(
            f"the estimate overflows at sample {int(np.argmin(finite))}; use other units, "
            "or settings that bound it without excitation: a penalty, or a growth_limit for least squares"
        )


def require_finite_squares(name: str, values) -> float:
    """Refuse numbers of which one is too large for the recursions; returns the largest, NaN left out."""
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
    recursive_kernels.worst_residuals(rows, outputs, bounds, forgetting, points, worst)
    return worst
