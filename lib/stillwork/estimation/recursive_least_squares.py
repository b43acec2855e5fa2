"""Recursive least squares of a stream: the triangle of all rows, or a covariance from a given start."""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from sklearn.utils.validation import check_is_fitted

from stillwork.base.checks import InputError, require_choice, require_number
from stillwork.estimation.adaptive import FeRls
from stillwork.estimation.covariance_forms import FORMS
from stillwork.estimation.online import run_ferls
from stillwork.estimation.recursive import warn_held
from stillwork.estimation.regression import ONE, WeightedRegressor
from stillwork.estimation.triangle_kernels import (
    HELD,
    MASS,
    MEAN,
    POWER,
    SINGULAR,
    empty_record,
    learn_rows,
    least_share,
)


@dataclass(eq=False, repr=False)
class RecursiveLeastSquares(WeightedRegressor):
    """Recursive least squares with exponential forgetting, all outputs with one triangle or covariance.

    It minimises sum_j forgetting^(t - j) w_j |y_j - coef x_j - intercept|^2. Where `initial_covariance` is given, the
    covariance form runs, which adds forgetting^t times the distance from the initial estimate, weighted by its inverse.

    Attributes
    ----------
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Estimate before the first sample; zero without. A feature that nothing excites, or that those before it explain,
        keeps it.
    initial_covariance : float or array_like, optional
        P before the first sample, its diagonal, or one number for the diagonal, in units of 1 / feature^2: large if the
        initial estimate is uncertain; an intercept is the last of the unknowns. Without it the start has no weight, and
        neither unit nor offset of a feature matters.
    growth_limit : float
        Guard against wind-up: how far the variance of a combination of features may grow beyond its smallest while
        nothing excites it; ``inf`` for as far as rounding allows. With `initial_covariance` as `growth_limit` of `FeRls`.
        Without forgetting there is no wind-up, and it is not used.
    form : str
        How a covariance with `initial_covariance` is kept, as `form` of `FeRls`.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    held_ : ndarray, shape (features,)
        Share of the last time constant, 0 to 1, in which `growth_limit` held a variance down: of a feature once what the
        features before it explain is taken out, or with `initial_covariance` of its coefficient.
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
    estimator is made. `set_params` between two calls of `partial_fit` changes `forgetting`; the start and the form
    remain as they were.

    References
    ----------
    Haykin, Adaptive Filter Theory (2002), chapters 9 and 14; West, Updating mean and variance estimates (1979).

    Examples
    --------
    >>> X = 101325 + 20 * np.random.default_rng(1).standard_normal((500, 2))  # Pa
    >>> y = np.append(X[:250] @ [1.0, 2.0], X[250:] @ [3.0, -5.0])  # it changes half way
    >>> estimation.RecursiveLeastSquares(forgetting=0.9).fit(X, y + 7.0).coef_.round(3)
    array([ 3., -5.])
    """

    forgetting: Any = 1.0
    initial_coef: Any = None
    initial_covariance: Any = None
    growth_limit: Any = 1e6
    form: Any = "safe"
    fit_intercept: Any = True

    def __post_init__(self):
        if self.initial_covariance is None:
            _compile_triangle()
        else:
            factored = isinstance(self.form, str) and self.form not in ("safe", "triangle")
            _compile_covariance("UD" if factored else "safe")

    def _warn(self):
        if (self.held_ > 0.5).any():
            warn_held(np.flatnonzero(self.held_ > 0.5), stacklevel=5)

    @property
    def _has_triangle(self) -> bool:
        return isinstance(self._state, np.ndarray)

    @property
    def covariance_(self):
        """P after the last sample, an intercept last; times the variance of the noise that of the estimate.

        Infinite while the samples do not determine all coefficients.
        """
        check_is_fitted(self)
        if not self._has_triangle:
            return self._state[1].covariance
        state, n = self._state, self.n_features_in_
        unknowns = n + self._has_intercept
        sizes = np.sqrt(state[n + POWER, :n])
        if (np.abs(np.diag(state[:n, :n])) <= SINGULAR * sizes).any():
            return np.full((unknowns, unknowns), np.inf)
        turned = np.zeros((unknowns, n))
        turned[:n] = solve_triangular(state[:n, :n], np.eye(n))
        if self._has_intercept:
            turned[n] = -state[n + MEAN, :n] @ turned[:n]
        found = turned @ turned.T
        if self._has_intercept:
            found[n, n] += 1 / state[n + MASS, 0]
        return found

    @property
    def held_(self):
        """Share of the last time constant in which `growth_limit` held a variance down, shape (features,)."""
        check_is_fitted(self)
        n = self.n_features_in_
        return np.minimum(self._state[n + HELD, :n], 1.0) if self._has_triangle else self._state[1].held[:n]

    def _update(self, X, outputs, weights, anew):
        forgetting = self.forgetting
        if not (type(forgetting) is float and 0.0 < forgetting <= 1.0):
            forgetting = float(require_number("forgetting", forgetting, above=0.0, at_most=1.0))
        if anew:
            require_choice("form", self.form, ("safe", *FORMS))
            self._first = self._initial(self.initial_coef, X.shape[1], outputs.shape[1])
            self._state = (
                None if self.initial_covariance is not None else empty_record(X.shape[1], outputs.shape[1])
            )
        if self._state is None or not self._has_triangle:
            return self._update_covariance(forgetting, *self._weighted(X, outputs, weights))
        # the kernel is compiled for arrays as numpy makes them: not for those of a reader that are read-only or strided
        X, state = np.array(X, order="C"), self._state.copy()
        outputs = (
            outputs - X @ self._first.T if self.initial_coef is not None else np.array(outputs, order="C")
        )
        found = np.zeros((outputs.shape[1], X.shape[1] + 1))
        weights = weights if weights is ONE else np.array(weights, float)
        learn_rows(
            state, X, outputs, weights, forgetting, least_share(self.growth_limit), self._has_intercept, found
        )
        self._state = state
        return self._first + found[:, :-1], found[:, -1].copy()

    def _update_covariance(self, forgetting, rows, outputs):
        # the estimate, P, and how many samples
        if self._state is None:
            limit = self.growth_limit if forgetting < 1 else np.inf
            recursion = FeRls(self.initial_covariance, forgetting, limit, self.form).start(rows.shape[1])
            coef = np.zeros((outputs.shape[1], rows.shape[1]))
            coef[:, : self._first.shape[1]] = self._first
            self._state = coef, recursion, 0
        coef, recursion, samples = self._state
        coef, recursion = coef.copy(), recursion._replace(forgetting=forgetting).copy()
        if run_ferls(coef, recursion, *recursion[-2:], *_record_to_fit(rows, outputs), False, samples)[
            0
        ] < len(rows):
            raise InputError(
                "initial_covariance, growth_limit and X together make the covariance indefinite; give a smaller "
                "initial_covariance, a finite growth_limit, features of similar size, or form 'UD'"
            )
        self._state = coef, recursion, samples + len(rows)
        return self._parted(coef)


def _record_to_fit(rows, outputs) -> tuple:
    """What a kernel takes to fit a record: e = coef x - y, no ceiling on it, and no history."""
    nothing = np.empty((0, outputs.shape[1], rows.shape[1]))
    return np.array(rows, order="C"), -outputs, True, np.inf, nothing, len(rows) + 1


@cache
def _compile_triangle() -> None:
    learn_rows(empty_record(1, 1), np.zeros((1, 1)), np.zeros((1, 1)), ONE, 1.0, 1.0, True, np.zeros((1, 2)))


@cache
def _compile_covariance(form: str) -> None:
    # all forms but the triangle have one kernel
    recursion = FeRls(1.0, 1.0, 1.0, form).start(1).copy()
    run_ferls(
        np.zeros((1, 1)),
        recursion,
        *recursion[-2:],
        *_record_to_fit(np.zeros((1, 1)), np.zeros((1, 1))),
        False,
        0,
    )
