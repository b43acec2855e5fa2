"""Regressors for data that least squares does not suit: outliers, and noise of unknown statistics."""

import heapq
from dataclasses import dataclass
from typing import Any

import numpy as np

from stillwork.base.checks import InputError, require_number
from stillwork.estimation.hinfinity import hinfinity_gains
from stillwork.estimation.linear_fits import hinfinity_model, huber_estimate, last_estimate
from stillwork.estimation.recursive import LARGEST
from stillwork.estimation.regression import RecursiveRegressor, UnweightedRegressor
from stillwork.estimation.time_varying import FilterGains

MARGIN = 1.1  # level over the smallest that there is


@dataclass(eq=False, repr=False)
class HuberRegressor(RecursiveRegressor):
    """Huber's regression: errors beyond 1.345 robust deviations count less. There is no recursion.

    Attributes
    ----------
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
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
        When a setting is out of its range, or a table does not fit; raised by `fit`.

    Notes
    -----
    That of scikit-learn gives 0 for features of 1e-6: its search has units.

    References
    ----------
    Huber, Robust statistics (1981).

    Examples
    --------
    >>> X, y = np.arange(10.0)[:, None], 2 * np.arange(10.0)
    >>> y[3] = 1000.0
    >>> estimation.HuberRegressor().fit(X, y).coef_.round(1)
    array([2.])
    """

    forgetting: Any = 1.0
    fit_intercept: Any = True

    def fit(self, X, y, sample_weight=None):
        """Learn from samples in their order.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            Weight of each sample, beside that of forgetting; 0 for a lost sample.

        Returns
        -------
        HuberRegressor
            The estimator itself, with `coef_` and `intercept_`.

        Raises
        ------
        InputError
            When a setting is out of its range, a table does not fit, or no sample is without NaN.

        Examples
        --------
        >>> X, y = [[1.0], [2.0], [3.0]], [2.0, 4.0, 99.0]
        >>> estimation.HuberRegressor(fit_intercept=False).fit(X, y, sample_weight=[1, 1, 0]).coef_.round(3)
        array([2.])
        """
        return self._learn(X, y, sample_weight, anew=True)

    def _start(self, columns, outputs):
        return None

    def _advance(self, state, rows, outputs, weights):
        used = weights > 0
        root = np.sqrt(weights[used])[:, None]
        rows, outputs = rows[used] / root, outputs[used] / root
        forgetting = require_number("forgetting", self.forgetting, above=0.0, at_most=1.0)
        weights = (weights * forgetting ** np.arange(len(weights) - 1, -1, -1))[used]
        units = np.abs(rows).max(axis=0)
        units[units == 0] = 1.0
        return None, np.array([huber_estimate(rows / units, each, weights) for each in outputs.T]) / units


@dataclass(eq=False, repr=False)
class HinfinityRegressor(UnweightedRegressor):
    """The H-infinity filter of constant coefficients: a bound on the energy of their errors over that of all disturbances.

    Attributes
    ----------
    noise : float, optional
        Standard deviation of the errors of y; without it that of the residuals of least squares on the first call.
    size : float, optional
        Norm of the coefficients before the first sample; without it that of least squares on the first call.
    level : float, optional
        Bound on (energy of the coefficients' errors over that of errors of y and start, each over its deviation)^(1/2);
        without it 1.1 times the smallest that the samples of the first call allow.
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    level_ : float
        The level that is kept.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When no filter keeps the level, a setting is out of its range, or a table does not fit; raised by `fit` and
        `partial_fit`.

    References
    ----------
    Hassibi, Sayed and Kailath, Indefinite-quadratic estimation and control (1999), chapter 4.

    Examples
    --------
    >>> X = np.random.default_rng(1).standard_normal((200, 2))
    >>> found = estimation.HinfinityRegressor(noise=0.1, fit_intercept=False).fit(X, X @ [3.0, -5.0])
    >>> found.coef_.round(1)
    array([ 3., -5.])
    """

    noise: Any = None
    size: Any = None
    level: Any = None
    forgetting: Any = 1.0
    fit_intercept: Any = True

    def _start(self, columns, outputs):
        # the estimate and its covariance, the variance of the noise, the level; none of them known yet
        return None

    def _advance(self, state, rows, outputs, weights):
        forgetting = require_number("forgetting", self.forgetting, above=0.0, at_most=1.0)
        columns = rows.shape[1]
        if state is None:
            state = (np.zeros((outputs.shape[1], columns)), *self._believed(rows, outputs), self.level)
        coef, covariance, variance, level = state
        model = hinfinity_model(rows, variance, covariance, forgetting)
        if level is None:
            level, gains = _least_level(model, rows, forgetting)
        else:
            level = float(require_number("level", level, above=0.0))
            try:
                gains = hinfinity_gains(model, np.eye(columns), level)
            except InputError:
                if self.level is not None:
                    raise
                raise InputError(
                    f"no filter keeps the level {level:.3g} of the first call for the samples of this one; give level, or "
                    "more samples in the first call, from which it follows"
                ) from None
        self.level_ = level
        coef = np.array(
            [
                last_estimate(gains, each, forgetting, start)
                for each, start in zip(outputs.T, coef, strict=True)
            ]
        )
        return (coef, np.array(gains.covariance[-1]), variance, level), coef

    def _believed(self, rows, outputs) -> tuple[np.ndarray, float]:
        # of the coefficients before, and of the errors of the outputs
        count, columns = outputs.shape[1], rows.shape[1]
        least = np.linalg.lstsq(rows, outputs)[0]
        size, noise = self.size, self.noise
        if size is None:
            size = float(np.linalg.norm(least) / np.sqrt(count)) or 1.0
        if noise is None:
            left = np.linalg.norm(outputs - rows @ least) / np.sqrt(count * max(1, len(rows) - columns))
            least_noise = 1e-6 * np.linalg.norm(outputs) / np.sqrt(outputs.size)
            noise = float(max(left, least_noise)) or 1.0
        size = require_number("size", size, above=0.0, at_most=LARGEST)
        noise = require_number("noise", noise, above=0.0, at_most=LARGEST)
        return size**2 / columns * np.eye(columns), float(noise) ** 2


def _least_level(model, rows, forgetting) -> tuple[float, FilterGains]:
    # where rows are nearly dependent rounding decides whether a level is kept, and may refuse one above the smallest
    level, identity = _smallest_level(model, rows, forgetting), np.eye(rows.shape[1])
    for _ in range(100):
        level *= MARGIN
        try:
            return level, hinfinity_gains(model, identity, level)
        except InputError as error:
            refused = error
    raise refused


def _smallest_level(model, rows, forgetting) -> float:
    """What `smallest_level` finds by bisection, for all of the constant parameters of a `hinfinity_model`.

    After m rows their information is M_m, less 1 / level^2 times c_m = 1 + forgetting + ... + forgetting^m, and has to
    stay positive: level^2 is the largest c_m / min eig M_m. Along the rows c_m grows, and min eig M_m falls by forgetting
    at most: of stretches the one that may hold the largest is halved, until none may hold more than was seen.
    """
    count, forgetting = len(rows), np.float64(forgetting)
    start, growth = np.linalg.inv(model.initial_covariance), np.cumsum(forgetting ** np.arange(count + 1.0))
    fading = forgetting ** (np.arange(count, -1.0, -1.0) / 2)
    surely = np.linalg.eigvalsh(start)[0]

    def least(m):
        weighted = fading[count - m + 1 :, None] * rows[:m]
        information = forgetting**m * start + weighted.T @ weighted / model.sensor[0, 0]
        return max(np.linalg.eigvalsh(information)[0], forgetting**m * surely, 1e-300)

    def stretch(first, last, smallest):
        with np.errstate(over="ignore"):
            return -growth[last] * forgetting ** (first - last) / smallest, first, last, smallest

    found = growth[count] / least(count)
    open_stretches = [stretch(0, count, surely)]
    while open_stretches and -open_stretches[0][0] > found * (1 + 1e-9):
        _, first, last, smallest = heapq.heappop(open_stretches)
        found = max(found, growth[first] / smallest)
        if last - first > 1:
            middle = (first + last) // 2
            heapq.heappush(open_stretches, stretch(first, middle - 1, smallest))
            heapq.heappush(open_stretches, stretch(middle, last, least(middle)))
        elif last > first:
            heapq.heappush(open_stretches, stretch(last, last, least(last)))
    return float(np.sqrt(found))
