"""Recursive estimators with one interface: `run` over a record, `Stepper` for one sample at a time."""

import warnings
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float64, Int64
from numpy.typing import ArrayLike

from stillwork.checks import (
    InputError,
    require_array,
    require_choice,
    require_count,
    require_number,
)
from stillwork.worstcase import rank_one, steps
from stillwork.worstcase.batch import ZeroEstimateWarning

UPDATES = ("exact", "approximate", "fast")


@dataclass(frozen=True)
class Track:
    """What an estimator gave along a record.

    Attributes
    ----------
    estimates : ndarray, shape (unknowns, samples)
        x_t after the sample at t; zero before there are more samples than unknowns (min-max only).
    errors : ndarray, shape (samples,)
        Prediction error y_t - a_t'x_(t-1), before the sample is used.
    alphas : ndarray, shape (samples,)
        Regularisation: x_t = (R_t + alpha_t I)^-1 s_t; infinite where x_t = 0; 0 for least squares.
    evaluations : ndarray of int, shape (samples,)
        Evaluations of the secular function that each step took.
    """

    estimates: Float64[np.ndarray, "unknowns samples"]
    errors: Float64[np.ndarray, " samples"]
    alphas: Float64[np.ndarray, " samples"]
    evaluations: Int64[np.ndarray, " samples"]


@dataclass(frozen=True)
class _MinMaxUpdate:
    # Shared by the two windows below: how alpha is found, and the kernels behind it. The state stands apart
    # from the settings, so one estimator serves many records; `advance` changes the state in place.

    def start(self, unknowns: int) -> tuple[np.ndarray, ...]:
        square = np.zeros((unknowns, unknowns))
        state = (square, np.zeros(unknowns), np.array([np.inf, 0.0, 0.0]), np.zeros(unknowns))
        if self.update == "fast":
            return (np.zeros(unknowns), np.eye(unknowns), *state[1:])
        if self.update == "approximate":
            return (*state, np.zeros((unknowns, unknowns)), np.zeros(unknowns))
        return state

    def advance(self, state, first: int, rows, outputs) -> Track:
        out = _empty(rows)
        bounds = self.bounds(first, len(rows))
        if self.update == "fast":
            rank_one._run_fast(rows, outputs, bounds, self._weight, *state, *out)
        elif self.update == "approximate":
            steps._run_approximate(rows, outputs, bounds, self._weight, self.iterations, *state, *out)
        else:
            steps._run_exact(rows, outputs, bounds, self._weight, *state, *out)
        return _track(*out)

    def _check(self) -> None:
        require_choice("update", self.update, UPDATES)
        require_count("iterations", self.iterations)
        if self.iterations > 1 and self.update != "approximate":
            raise InputError("iterations is for update 'approximate'; the others solve for alpha exactly")


@dataclass(frozen=True)
class MinMax(_MinMaxUpdate):
    """Exponentially weighted min-max estimator: constant bound on the perturbation of the weighted data.

    At every t it minimises the largest |(A_t + dA) x - b_t| over |dA| <= `bound`, where row j of A_t and b_t
    carries the weight forgetting^((t - j) / 2); problem (11).

    Attributes
    ----------
    bound : float
        eta, in the unit of the regressors; `exponential_bound` gives it from a bound on each row.
    forgetting : float
        lambda, between 0 and 1.
    update : str
        ``exact``: Theorem 2, one O(n^3) factorisation per Newton step. ``approximate``: algorithm (20).
        ``fast``: the exact root from rank-one updates of the eigenvectors of R, Section 7.
    iterations : int
        Fixed-point steps of the approximate update; the published algorithm takes 1.

    Notes
    -----
    The residual comes from sums of squares: below 1e-7 of |b| it drowns in rounding. Use `min_max_solve`
    for data that fit to more digits than that.

    References
    ----------
    Sayed, Garulli, Nascimento, Chandrasekaran, "Exponentially-weighted iterative solutions for worst-case
    parameter estimation", Theorem 2, (20), Section 7. With h as printed, (15) and (18) need lam alpha_t.
    """

    bound: float
    forgetting: float
    update: str = "exact"
    iterations: int = 1

    def __post_init__(self):
        require_number("bound", self.bound, at_least=0.0)
        require_number("forgetting", self.forgetting, above=0.0, below=1.0)
        self._check()

    @property
    def _weight(self) -> float:
        return float(self.forgetting)

    def bounds(self, first: int, count: int) -> np.ndarray:
        return np.full(count, float(self.bound))


@dataclass(frozen=True)
class GrowingMinMax(_MinMaxUpdate):
    """Min-max estimator in which all rows count alike and the bound grows: eta_t = row_bound sqrt(t).

    This is the setting of Fig. 1 (forgetting 1); parameters as in `MinMax`, with

    Attributes
    ----------
    row_bound : float
        epsilon, the bound on the 2-norm of the perturbation of one regressor.
    """

    row_bound: float
    update: str = "exact"
    iterations: int = 1
    _weight: ClassVar[float] = 1.0

    def __post_init__(self):
        require_number("row_bound", self.row_bound, at_least=0.0)
        self._check()

    def bounds(self, first: int, count: int) -> np.ndarray:
        return self.row_bound * np.sqrt(np.arange(first + 1.0, first + count + 1))


@dataclass(frozen=True)
class LeastSquares:
    """Exponentially weighted recursive least squares (RLS) in covariance form.

    Attributes
    ----------
    forgetting : float
        lambda, between 0 and 1.
    initial_covariance : float
        P_0 = initial_covariance I: large means that the start at x = 0 is not believed.
    """

    forgetting: float
    initial_covariance: float = 1e4

    def __post_init__(self):
        require_number("forgetting", self.forgetting, above=0.0, below=1.0)
        require_number("initial_covariance", self.initial_covariance, above=0.0)

    def start(self, unknowns: int) -> tuple[np.ndarray, ...]:
        return float(self.initial_covariance) * np.eye(unknowns), np.zeros(unknowns)

    def advance(self, state, first: int, rows, outputs) -> Track:
        out = _empty(rows)
        steps._run_least_squares(rows, outputs, float(self.forgetting), *state, *out[:2])
        out[2][:] = 0
        return _track(*out)


@dataclass(frozen=True)
class Ridge:
    """Exponentially weighted ridge regression with a constant penalty: x = (R + penalty I)^-1 s.

    Attributes
    ----------
    penalty : float
        Above 0; in the unit of the squared regressors, summed over the window.
    forgetting : float
        lambda, between 0 and 1.
    """

    penalty: float
    forgetting: float

    def __post_init__(self):
        require_number("penalty", self.penalty, above=0.0)
        require_number("forgetting", self.forgetting, above=0.0, below=1.0)

    def start(self, unknowns: int) -> tuple[np.ndarray, ...]:
        return np.zeros((unknowns, unknowns)), np.zeros(unknowns), np.zeros(unknowns)

    def advance(self, state, first: int, rows, outputs) -> Track:
        out = _empty(rows)
        settings = float(self.penalty), float(self.forgetting)
        steps._run_ridge(rows, outputs, *settings, *state, *out[:2])
        out[2][:] = self.penalty
        return _track(*out)


Estimator = MinMax | GrowingMinMax | LeastSquares | Ridge


def run(estimator: Estimator, regressors: ArrayLike, outputs: ArrayLike) -> Track:
    """Run an estimator over a record.

    Parameters
    ----------
    estimator : MinMax, GrowingMinMax, LeastSquares or Ridge
    regressors : array_like, shape (unknowns, samples)
        Columns a_t; `fir_regressors` and `arx_regressors` make them from signals.
    outputs : array_like, shape (samples,)
        y_t.

    Returns
    -------
    Track

    Raises
    ------
    InputError
        For NaN or infinite samples, shapes that do not fit, or no more samples than unknowns.

    Warns
    -----
    ZeroEstimateWarning
        When a min-max bound is so large that every estimate is zero.
    """
    track = run_silently(estimator, regressors, outputs)
    if isinstance(estimator, _MinMaxUpdate) and np.isinf(track.alphas).all():
        warnings.warn(
            "every estimate is zero: at each step the bound is at or above |A'b|/|b|, so a perturbation of "
            "that size explains all of the data; give a smaller bound",
            ZeroEstimateWarning,
            stacklevel=2,
        )
    return track


def run_silently(estimator: Estimator, regressors: ArrayLike, outputs: ArrayLike) -> Track:
    """`run` without its warning, for sweeps in which a zero estimate is a result."""
    regressors = require_array("regressors", regressors, ndim=2)
    unknowns, samples = regressors.shape
    if unknowns == 0:
        raise InputError("regressors has no rows; give at least one unknown")
    outputs = require_array("outputs", outputs, shape=(samples,))
    if samples <= unknowns:
        raise InputError(
            f"regressors has {samples} samples for {unknowns} unknowns; give more samples than unknowns"
        )
    return estimator.advance(estimator.start(unknowns), 0, np.ascontiguousarray(regressors.T), outputs)


class Stepper:
    """An estimator that is fed one sample at a time; same numbers as `run`.

    Parameters
    ----------
    estimator : MinMax, GrowingMinMax, LeastSquares or Ridge
    unknowns : int
        Number of parameters.
    """

    def __init__(self, estimator: Estimator, unknowns: int):
        self._estimator = estimator
        self._unknowns = require_count("unknowns", unknowns)
        self._state = estimator.start(self._unknowns)
        self._samples = 0

    def update(self, regressor: ArrayLike, output: float) -> np.ndarray:
        """Use one sample; returns the new estimate, shape (unknowns,).

        Raises
        ------
        InputError
            For a sample that is not finite or of the wrong shape; the state is then unchanged.
        """
        row = require_array("regressor", regressor, shape=(self._unknowns,))
        output = require_number("output", output)
        track = self._estimator.advance(self._state, self._samples, row[None], np.array([output]))
        self._samples += 1
        return track.estimates[:, 0].copy()


def worst_case_residuals(
    regressors: ArrayLike,
    outputs: ArrayLike,
    estimates: ArrayLike,
    bounds: ArrayLike,
    forgetting: float,
) -> np.ndarray:
    """|A_t x_t - b_t| + eta_t |x_t| of any estimates, the criterion that min-max estimation minimises.

    Parameters
    ----------
    regressors, estimates : array_like, shape (unknowns, samples)
    outputs, bounds : array_like, shape (samples,)
    forgetting : float
        lambda in (0, 1]; 1 weighs all rows alike.

    Returns
    -------
    ndarray, shape (samples,)
        In the unit of the outputs.
    """
    regressors = require_array("regressors", regressors, ndim=2)
    estimates = require_array("estimates", estimates, shape=regressors.shape)
    outputs = require_array("outputs", outputs, shape=regressors.shape[1:])
    bounds = require_array("bounds", bounds, shape=regressors.shape[1:])
    forgetting = require_number("forgetting", forgetting, above=0.0, at_most=1.0)
    worst = np.empty(len(outputs))
    rows, points = np.ascontiguousarray(regressors.T), np.ascontiguousarray(estimates.T)
    steps._worst_residuals(rows, outputs, bounds, forgetting, points, worst)
    return worst


def _empty(rows):
    return (
        np.zeros(rows.shape),
        np.zeros(len(rows)),
        np.zeros(len(rows)),
        np.zeros(len(rows), dtype=np.int64),
    )


def _track(estimates, errors, alphas, evaluations) -> Track:
    return Track(estimates.T, errors, alphas, evaluations)
