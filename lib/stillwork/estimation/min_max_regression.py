"""Min-max regression from a triangular factor of all samples.

A triangle has the residuals of all weighted rows, so that a stream ends where its batch does, and loses no digits.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from stillwork.base.checks import InputError, pluralise, require_array, require_choice
from stillwork.estimation.min_max import ZeroEstimateWarning, solve_plain
from stillwork.estimation.regression import TriangleRegressor
from stillwork.estimation.secular import ROUNDING, min_max_root
from stillwork.estimation.triangle_kernels import MASS, MEAN, NO_BOUNDS, POWER


def _column_sizes(matrix) -> np.ndarray:
    """Of columns in units of their own: what is small beside the others is no less known for it; 1 of an empty one."""
    sizes = np.sqrt((matrix**2).sum(axis=0))
    return np.where(sizes > 0, sizes, 1.0)


def _solve_around_known(matrix, target, known, estimate: Callable) -> np.ndarray:
    """Estimate of all columns by `estimate` of the others, once what the `known` columns explain is taken out of them."""
    if not known.any():
        return estimate(matrix, target)
    columns = matrix[:, known]
    units = _column_sizes(columns)
    basis = columns / units
    if basis.shape[1] > 1:
        left, sizes, _ = np.linalg.svd(basis, full_matrices=False)
        basis = left[:, sizes > len(matrix) * ROUNDING * np.max(sizes, initial=0.0)]
    uncertain, aimed = ((part - basis @ (basis.T @ part)) for part in (matrix[:, ~known], target))
    # of a feature that the known ones explain, such as a constant one beside an intercept, rounding is left
    left = np.sqrt((uncertain**2).sum(axis=0))
    uncertain[:, left <= 100 * len(matrix) * ROUNDING * _column_sizes(matrix[:, ~known])] = 0.0
    coef = np.zeros(len(known))
    if not known.all():
        coef[~known] = estimate(uncertain, aimed)
    left = target - matrix @ coef
    several = basis.shape[1] > 1 or len(units) > 1
    coef[known] = (np.linalg.lstsq(columns / units, left)[0] if several else basis.T @ left) / units
    return coef


@dataclass(eq=False)
class MinMaxRegressor(TriangleRegressor):
    """Least squares for features with a bounded error: minimises the largest residual.

    Over all perturbations dX with |dX diag(bound)^-1| <= 1 of the features seen so far it minimises the largest
    |y - (X + dX) coef|. Of sample j, row and output carry the weight (w_j forgetting^(t - j))^(1/2).

    Attributes
    ----------
    bound : float or array_like, shape (features,)
        eta, the bound on the 2-norm of the perturbation, in the unit of the features, or one for each column. A column
        of bound 0 is known exactly. `set_params` may change it at any time.
    bound_on : str
        ``record``: of what the bound holds is the perturbation of all weighted samples together, however many.
        ``sample``: of that of each sample, so that of all it grows as (sum of the weights)^(1/2).
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
    window : int, optional
        How many of the last samples count, lost ones among them; all without it.
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Estimate before the first sample.
    initial_covariance : float or array_like, optional
        Of the initial estimate, as in `RecursiveLeastSquares`; without it there is none.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; raised by `fit` and `partial_fit`.

    Notes
    -----
    What is kept of the samples is the triangle of `RecursiveLeastSquares`, which has their residuals, so that the estimate is
    exact at every time and loses no digits; it is that of `min_max_solve`. With an intercept the offset of a feature does not
    matter. The kernel of a row is compiled when the estimator is made. There is nothing to wind up: an estimate without excitation fades to
    zero where its bound does not fade as well.

    Warns
    -----
    ZeroEstimateWarning
        From `fit`, when the bound is so large that the estimate is zero.

    References
    ----------
    Sayed, Garulli, Nascimento, Chandrasekaran, "Exponentially-weighted iterative solutions for worst-case
    parameter estimation", Theorem 1.

    Examples
    --------
    >>> X, y = np.array([[1.0], [1.0], [-1.0]]), [12.0, 11.0, 9.0]
    >>> least, robust = (estimation.MinMaxRegressor(bound).fit(X, y) for bound in (0.0, 0.5))
    >>> least.coef_.round(2), robust.coef_.round(2)
    (array([1.25]), array([1.11]))
    """

    bound: Any
    bound_on: Any = "record"
    forgetting: Any = 1.0
    window: Any = None
    initial_coef: Any = None
    initial_covariance: Any = None
    fit_intercept: Any = True

    def __post_init__(self):
        super().__post_init__()
        _compile_root()

    def _warn(self):
        if self._zero:
            warnings.warn(
                "the estimate is zero: a perturbation within the bound explains all of the data; give a smaller bound or "
                "more samples",
                ZeroEstimateWarning,
                stacklevel=4,
            )

    def _update(self, X, outputs, weights, anew):
        if self.initial_coef is not None and self.initial_covariance is None:
            raise InputError("initial_covariance is None, so that initial_coef does not count; give a number")
        bounds = self._feature_bounds(X.shape[1])
        per_sample = require_choice("bound_on", self.bound_on, ("record", "sample")) == "sample"
        uncertain = 0.0 < bounds.min()
        coef, intercepts, decided = self._advance(
            X, outputs, weights, anew, 0.0, bounds if uncertain else NO_BOUNDS, per_sample
        )
        if uncertain and decided:
            self._zero = math.isinf(max(self._state.alphas.tolist()))
            return coef, intercepts
        mass = self._state.record[X.shape[1] + MASS, 0]
        return self._solve(bounds * math.sqrt(mass) if per_sample else bounds)

    def _feature_bounds(self, features) -> np.ndarray:
        if type(self.bound) is float and self.bound >= 0.0 and self.bound < np.inf:
            return np.full(features, self.bound)
        values = require_array("bound", self.bound)
        if values.shape not in ((), (features,)):
            raise InputError(
                f"bound has shape {values.shape}; give a number, or one for each of {pluralise(features, 'feature')}"
            )
        if np.any(values < 0):
            raise InputError("bound holds a negative number; give zero or above")
        positive = values[values > 0] if values.ndim else values
        if positive.size and positive.max() > 1e12 * positive.min():
            raise InputError(
                "bound holds numbers that differ by more than 1e12; give 0 for a column known so well"
            )
        return np.resize(values, features).astype(float)

    def _solve(self, bounds):
        # by singular values, and with features that are known exactly
        state, features = self._state.record, len(bounds)
        known, largest = bounds == 0, float(bounds.max())
        shares = np.where(known, 1.0, bounds / (largest or 1.0))[~known]
        self._zero = False  # whether the bound explains all of the data away

        def estimate(matrix, target):
            estimate, zero = solve_plain(matrix / shares, target, largest)
            self._zero |= zero
            return estimate / shares

        matrix = np.vstack([state[:features, :features], np.zeros(features)])
        rests = np.sqrt(state[features + POWER, features:])
        targets = np.vstack([state[:features, features:], rests]).T
        coef = np.array([_solve_around_known(matrix, each, known, estimate) for each in targets])
        means = state[features + MEAN]
        return coef, means[features:] - coef @ means[:features]


@cache
def _compile_root() -> None:
    # what decides where the kernel of a row cannot
    min_max_root(np.ones(1), np.ones(1), 1.0, 0.1, 0.1)
