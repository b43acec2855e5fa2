"""Min-max regression from a triangular factor of all samples.

A triangle has the residuals of all weighted rows, so that a stream ends where its batch does, and loses no digits.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np

from stillwork.base.checks import InputError, pluralise, require_array, require_choice, require_number
from stillwork.estimation.min_max import ZeroEstimateWarning, solve_plain
from stillwork.estimation.regression import WeightedRegressor
from stillwork.estimation.secular import ROUNDING, min_max_root
from stillwork.estimation.triangle_kernels import advance_min_max


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


class _Bounds:
    """Bounds of columns as a kernel takes them: those known exactly first, the others over the largest."""

    def __init__(self, bound, values):
        self.bound, self.values, self.columns = bound, values, len(values)
        self.largest = float(np.max(values, initial=0.0))
        free = np.flatnonzero(values)
        self.known = len(values) - len(free)
        self.order = np.concatenate([np.flatnonzero(values == 0), free])
        self.shares = values[free] / (self.largest or 1.0)
        if np.min(self.shares, initial=1.0) < 1e-12:
            raise InputError(
                "bound holds numbers that differ by more than 1e12; give 0 for a column known so well"
            )


@dataclass(eq=False, repr=False)
class MinMaxRegressor(WeightedRegressor):
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
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Estimate before the first sample.
    initial_covariance : float
        Of the initial estimate, which counts as so many samples more; ``inf`` for no initial estimate.
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
    What is kept of the samples is a triangle that has their residuals, so that the estimate is exact at every time and
    loses no digits; it is that of `min_max_solve`. With an intercept the offset of a feature does not matter. The kernel of a
    row is compiled when the estimator is made. There is nothing to wind up: an estimate without excitation fades to
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
    initial_coef: Any = None
    initial_covariance: Any = np.inf
    fit_intercept: Any = True

    _bounds: ClassVar[Any] = None  # those of the last call

    def __post_init__(self):
        _compile()

    def _warn(self):
        if self._zero:
            warnings.warn(
                "the estimate is zero: a perturbation within the bound explains all of the data; give a smaller bound or "
                "more samples",
                ZeroEstimateWarning,
                stacklevel=4,
            )

    def _start(self, columns, outputs) -> np.ndarray:
        size = columns + outputs
        corner = np.zeros((size, size))
        if not (isinstance(self.initial_covariance, float) and self.initial_covariance == np.inf):
            root = np.full(
                columns, 1 / np.sqrt(require_number("initial_covariance", self.initial_covariance, above=0.0))
            )
            first = np.zeros((outputs, columns))
            features = columns - self._has_intercept
            root[features:] = 0.0  # nothing is known of an intercept
            first[:, :features] = self._initial(self.initial_coef, features, outputs)
            corner[:columns, :columns] = np.diag(root)
            corner[:columns, columns:] = root[:, None] * first.T
        elif self.initial_coef is not None:
            raise InputError(
                "initial_covariance is inf, so that initial_coef does not count; give a finite one"
            )
        return corner

    def _update(self, X, outputs, weights, anew):
        rows, outputs = self._weighted(X, outputs, weights)
        columns, bounds = rows.shape[1], self._bounds
        if anew:
            # the triangle of [X, y], the sum of the weights, and the regularisation of each output
            self._state = self._start(columns, outputs.shape[1]), 0.0, np.zeros(outputs.shape[1])
        corner, mass, alphas = self._state
        same = not anew and bounds is not None and bounds.bound is self.bound
        if not (same and isinstance(self.bound, float | int)):
            bounds = self._bounds = _Bounds(self.bound, self._per_column("bound", columns))
        forgetting = self.forgetting
        if not (isinstance(forgetting, float) and 0.0 < forgetting <= 1.0):
            forgetting = require_number("forgetting", forgetting, above=0.0, at_most=1.0)
        if len(rows) == 1 and bounds.largest > 0:
            # a row of a stream takes one kernel, which begins where the one before it ended
            mass, coef = forgetting * mass + float(weights[0]), np.empty((outputs.shape[1], columns))
            row, bound = np.concatenate([rows[0], outputs[0]]), bounds.largest * self._growth(mass)
            corner, alphas = corner.copy(), alphas.copy()
            root = math.sqrt(forgetting)
            how = row, root, bounds.order, bounds.known, bounds.shares, bound, coef, alphas
            solved = advance_min_max(corner, *how)
            self._zero = math.isinf(max(alphas.tolist()))
        else:
            fading = forgetting ** np.arange(len(weights) - 1, -1, -1)
            mass, solved = forgetting ** len(weights) * mass + float(weights @ fading), False
            table = np.sqrt(fading)[:, None] * np.hstack([rows, outputs])
            corner = np.concatenate([forgetting ** (len(weights) / 2) * corner, table])
            corner = np.linalg.qr(corner, mode="r")
        if not solved:
            coef = self._solve(corner, columns, mass)
        self._state = corner, mass, alphas
        return self._parted(coef)

    def _per_column(self, name, columns) -> np.ndarray:
        # a setting that is one number or one for each feature; an intercept's is zero
        features = columns - self._has_intercept
        values = require_array(name, getattr(self, name))
        if values.shape not in ((), (features,)):
            raise InputError(
                f"{name} has shape {values.shape}; give a number, or one for each of {pluralise(features, 'feature')}"
            )
        if np.any(values < 0):
            raise InputError(f"{name} holds a negative number; give zero or above")
        return np.append(np.resize(values, features), np.zeros(columns - features))

    def _growth(self, mass) -> float:
        # of the bound over that of one sample, or of all
        if require_choice("bound_on", self.bound_on, ("record", "sample")) == "sample":
            return math.sqrt(mass)
        return 1.0

    def _solve(self, corner, columns, mass):
        largest, shares = self._bounds.largest * self._growth(mass), self._bounds.shares
        self._zero = False  # whether the bound explains all of the data away
        known, targets = self._bounds.values == 0, corner.T[columns:]

        def estimate(matrix, target):
            estimate, zero = solve_plain(matrix / shares, target, largest)
            self._zero |= zero
            return estimate / shares

        return np.array([_solve_around_known(corner[:, :columns], each, known, estimate) for each in targets])


@cache
def _compile() -> None:
    # the kernel of a row, and the one that decides where it cannot
    one = np.ones(1)
    advance_min_max(np.eye(2), np.ones(2), 1.0, np.zeros(1, int), 0, one, 0.1, np.ones((1, 1)), np.zeros(1))
    min_max_root(one, one, 1.0, 0.1, 0.1)
