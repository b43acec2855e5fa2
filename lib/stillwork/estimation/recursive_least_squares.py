"""Recursive least squares of a stream: the triangle of all rows, or of those of a window."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from stillwork.estimation.recursive import warn_held
from stillwork.estimation.regression import TriangleRegressor
from stillwork.estimation.triangle_kernels import HELD, NO_BOUNDS, least_share


@dataclass(eq=False)
class RecursiveLeastSquares(TriangleRegressor):
    """Recursive least squares with exponential forgetting or over a window, all outputs with one triangle.

    It minimises sum_j forgetting^(t - j) w_j |y_j - coef x_j - intercept|^2 and, where `initial_covariance` is given,
    forgetting^t times the distance from the initial estimate, weighted by its inverse.

    Attributes
    ----------
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
    window : int, optional
        How many of the last samples count, lost ones among them; all without it.
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Estimate before the first sample; zero without. A feature that nothing excites, or that those before it explain,
        keeps it.
    initial_covariance : float or array_like, optional
        P of the coefficients before the first sample, its diagonal, or one number for the diagonal, in units of
        1 / feature^2: large if the initial estimate is uncertain; nothing is known of an intercept. Without it the start
        has no weight, and neither unit nor offset of a feature matters.
    growth_limit : float
        Guard against wind-up: how far the variance of a combination of features may grow beyond its smallest while
        nothing excites it; ``inf`` for as far as rounding allows. Without forgetting there is no wind-up, and it is not
        used.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    held_ : ndarray, shape (features,)
        Share of the last time constant, 0 to 1, in which `growth_limit` held a variance down, of a feature once what
        the features before it explain is taken out.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; raised by `fit` and `partial_fit`.

    Warns
    -----
    GrowthLimitWarning
        From `fit`, when `growth_limit` held a variance down through the last time constant.

    Notes
    -----
    Each row turns the triangle of weighted deviations from the weighted means by rotations, so that the estimate has
    the digits of a QR decomposition of all rows, and a stream ends where its batch does. What steps is compiled when the
    estimator is made. `set_params` between two calls of `partial_fit` changes `forgetting`; the start and the window
    remain as they were. A row leaves a window by hyperbolic rotations where these keep the digits, else, and once in each
    window, the rows of the window are taken in anew.

    References
    ----------
    Haykin, Adaptive Filter Theory (2002), chapters 9 and 14; Golub and Van Loan, Matrix
    Computations (2013), 6.5.4; West, Updating mean and variance estimates (1979).

    Examples
    --------
    >>> X = 101325 + 20 * np.random.default_rng(1).standard_normal((500, 2))  # Pa
    >>> y = np.append(X[:250] @ [1.0, 2.0], X[250:] @ [3.0, -5.0])  # it changes half way
    >>> estimation.RecursiveLeastSquares(forgetting=0.9).fit(X, y + 7.0).coef_.round(3)
    array([ 3., -5.])
    """

    forgetting: Any = 1.0
    window: Any = None
    initial_coef: Any = None
    initial_covariance: Any = None
    growth_limit: Any = 1e6
    fit_intercept: Any = True

    def _warn(self):
        if (self.held_ > 0.5).any():
            warn_held(np.flatnonzero(self.held_ > 0.5), stacklevel=5)

    @property
    def held_(self):
        """Share of the last time constant in which `growth_limit` held a variance down, shape (features,)."""
        self._require_fitted()
        n = self.n_features_in_
        return np.minimum(self._state.record[n + HELD, :n], 1.0)

    def _update(self, X, outputs, weights, anew):
        return self._advance(X, outputs, weights, anew, least_share(self.growth_limit), NO_BOUNDS)[:2]
