"""Recursive estimators with scikit-learn's interface: `fit` for a record, `partial_fit` for a stream.

A sample with NaN in a feature or an output is lost: forgetting acts, but nothing is learned.
A call that is refused changes nothing.
"""

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_array, check_is_fitted, validate_data

from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
    require_kind,
    require_number,
)
from stillwork.estimation.adaptive import INFLATION, FeLms, FeRls
from stillwork.estimation.covariance_forms import FORMS, factor_of
from stillwork.estimation.online import run_felms, run_ferls
from stillwork.estimation.recursive import LARGEST, require_finite_squares, require_squares, warn_held
from stillwork.estimation.recursive_kernels import admit_start, believe_start
from stillwork.estimation.recursive_settings import START

NUMBERS = {"dtype": np.float64, "ensure_all_finite": "allow-nan"}  # what scikit-learn's checks are to return
ONE = np.ones(1)  # the weight of a sample that needs none
SHARE = 1e-5  # regularisation of least mean squares over the largest |x|^2, where it follows from the data


UNLIKE = 100.0  # largest over smallest root mean square of features, from which one may be learned by itself


class UnlikeScalesWarning(UserWarning):
    """Features differ so much in size that the small ones are not learned: use units in which they are similar."""


class _InputTypeError(InputError, TypeError):
    """What scikit-learn calls a TypeError and the toolbox an InputError."""


class RecursiveRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):
    # y = coef x + intercept. A subclass starts a state and advances it by rows, the last column of which is constant
    # where there is an intercept.
    fit_intercept: Any

    def predict(self, X):
        """Outputs for new samples.

        Parameters
        ----------
        X : array_like, shape (samples, features)

        Returns
        -------
        ndarray
            Shaped as `y` was; NaN for a sample with NaN.

        Raises
        ------
        InputError
            When X does not match the fitted features.
        NotFittedError
            Before the first `fit` or `partial_fit`.

        Examples
        --------
        >>> lms = estimation.LeastMeanSquares(step_size=1.0, fit_intercept=False).fit([[1.0]], [3.0])
        >>> lms.predict([[2.0], [np.nan]]).round(3)
        array([ 6., nan])
        """
        check_is_fitted(self)
        return self._features(X, anew=False) @ self.coef_.T + self.intercept_

    def score(self, X, y, sample_weight=None):
        """Coefficient of determination R^2 over the samples without NaN, its mean over the outputs.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            Weight of each squared error.

        Returns
        -------
        float
            1 for a perfect prediction, 0 for that of the mean.

        Raises
        ------
        InputError
            When a table does not fit, or no sample is without NaN.
        NotFittedError
            Before the first `fit` or `partial_fit`.

        Examples
        --------
        >>> lms = estimation.LeastMeanSquares(step_size=1.0, fit_intercept=False).fit([[1.0]], [3.0])
        >>> round(lms.score([[1.0], [2.0]], [3.0, 6.0]), 6)
        1.0
        """
        check_is_fitted(self)
        X, y, weights = self._samples(X, y, sample_weight, anew=False)
        used = ~_lost(X, y)
        if not weights[used].any():
            raise _nothing()
        return super().score(X[used], y[used], weights[used])

    def __sklearn_tags__(self):
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        return tags

    def _start(self, columns, outputs) -> Any:
        raise NotImplementedError

    def _advance(self, state, rows, outputs, weights) -> tuple[Any, np.ndarray]:
        raise NotImplementedError

    def _constant(self, X) -> float:
        # what the intercept is multiplied with
        return 1.0

    def _warn(self) -> None:
        """Warn after `fit` of what the settings did to the estimate."""

    def _note_scales(self, squares: np.ndarray) -> None:
        # largest over smallest size of the features, from sums of their squares; those that are zero left out
        sizes = np.sqrt(squares[squares > 0])
        self.scale_ratio_ = float(sizes.max() / sizes.min()) if len(sizes) else 1.0

    def _warn_unlike(self, what: str) -> None:
        warnings.warn(
            f"the largest feature is {self.scale_ratio_:.3g} times as large as the smallest, whose coefficient {what}; "
            "give the features in units in which they are alike, as sklearn.preprocessing.StandardScaler does",
            UnlikeScalesWarning,
            stacklevel=5,
        )

    def _learn(self, X, y, sample_weight, anew, whole=True):
        before = vars(self).copy()
        try:
            X, y, weights = self._samples(X, y, sample_weight, anew)
            if weights is not ONE and (lost := _lost(X, y)).any():
                if anew and lost.all():
                    raise _nothing()
                X, y, weights = np.nan_to_num(X), np.nan_to_num(y), np.where(lost, 0.0, weights)
            if whole:  # a part of a stream may be as quiet as it likes
                require_squares("X", X)
                require_squares("y", y)
            self._take(X, y, weights, anew)
        except BaseException:
            vars(self).clear()
            vars(self).update(before)
            raise
        if whole:
            self._warn()
        return self

    def _take(self, X, y, weights, anew):
        features, single, outputs = X.shape[1], y.ndim == 1, y.reshape(len(y), -1)
        root = weights[:, None]
        if weights is not ONE:
            root = np.sqrt(root)
            outputs = root * outputs
        columns = features + bool(require_kind("fit_intercept", self.fit_intercept, (bool, np.bool_)))
        if anew:
            state = self._start(columns, outputs.shape[1])
        else:
            state = self._state
            if y.shape[1:] != self.coef_.shape[:-1]:
                raise InputError(
                    f"y has {pluralise(outputs.shape[1], 'output')}; give as many outputs as in the calls before"
                )
            if columns != self._columns:
                raise InputError("fit_intercept has changed since the calls before; call fit")
        rows = X
        if columns > features:
            if anew:
                self._size = self._constant(root * X)
            rows = np.empty((len(X), columns))
            rows[:, :features], rows[:, features] = X, self._size
        rows = rows if weights is ONE else root * rows
        self._state, found = self._advance(state, rows, outputs, weights)
        if not np.isfinite(found).all():
            raise InputError("X and y lead to an overflow; give them in other units")
        self._columns = columns
        coef = found[:, :features].copy()  # a reader may change it
        offset = self._size * found[:, -1] if columns > features else np.zeros(len(found))
        self.coef_, self.intercept_ = (coef[0], float(offset[0])) if single else (coef, offset)

    def _samples(self, X, y, sample_weight, anew):
        # X, y, and a weight for each sample
        if not anew and sample_weight is None and self._is_next(X, y):
            return X, y, ONE
        X = self._features(X, anew)
        if y is None:
            raise InputError(
                f"{type(self).__name__} requires y to be passed, but the target y is None; give it"
            )
        if np.isscalar(y) or getattr(y, "ndim", None) == 0:
            raise InputError(
                "y is a single value; give one output for each sample, such as [y] for one sample"
            )
        if not _is_plain(y):
            y = _as_input_error("y", check_array, y, ensure_2d=False, input_name="y", **NUMBERS)
        require_finite_squares("y", y)
        if y.shape[:1] != X.shape[:1]:
            raise InputError(
                f"y has {pluralise(len(y), 'sample')} but X has {len(X)}; give one output for each"
            )
        if sample_weight is None:
            return X, y, np.ones(len(X))
        weights = require_array("sample_weight", sample_weight, shape=(len(X),))
        if np.any(weights < 0):
            raise InputError("sample_weight holds a negative number; give weights of zero or above")
        return X, y, weights

    def _is_next(self, X, y) -> bool:
        # one more sample of a stream, whole and as it is calculated with: the checks would take longer than the update
        return (
            type(X) is np.ndarray
            and type(y) is np.ndarray
            and X.shape == (1, self.n_features_in_)
            and y.shape == (1, *self.coef_.shape[:-1])
            and X.dtype == y.dtype == np.float64
            and math.hypot(*X.ravel().tolist(), *y.ravel().tolist()) <= LARGEST
            and not hasattr(self, "feature_names_in_")
        )

    def _features(self, X, anew):
        # an array of the shape that was learned from needs none of the checks that take ten times as long as a step
        known = not anew and not hasattr(self, "feature_names_in_") and _is_plain(X)
        if not (known and X.shape[1:] == (self.n_features_in_,)):
            X = _as_input_error("X", validate_data, self, X, reset=anew, **NUMBERS)
        require_finite_squares("X", X)
        return X

    def _initial(self, coef, columns, outputs):
        # an initial estimate as the kernels take it: one row per output; an intercept starts at zero
        start = np.zeros((outputs, columns))
        if coef is not None:
            given = np.atleast_2d(require_array("initial_coef", coef))
            wanted = (outputs, columns - bool(self.fit_intercept))
            if given.shape != wanted:
                raise InputError(
                    f"initial_coef has shape {np.shape(coef)}; give {wanted}, or {wanted[1:]} for one output"
                )
            start[:, : wanted[1]] = given
        return start


class WeightedRegressor(RecursiveRegressor):
    def fit(self, X, y, sample_weight=None):
        """Learn from samples in their order, from the start.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            Weight of each squared error, beside that of forgetting; 0 for a lost sample.

        Returns
        -------
        estimator
            The estimator itself, with `coef_` and `intercept_`.

        Raises
        ------
        InputError
            When a setting is out of its range, a table does not fit, or no sample is without NaN.

        Examples
        --------
        >>> X, y = [[1.0], [2.0], [3.0]], [2.0, 4.0, 99.0]
        >>> rls = estimation.RecursiveLeastSquares(fit_intercept=False)
        >>> rls.fit(X, y, sample_weight=[1, 1, 0]).coef_.round(3)  # the last is lost
        array([2.])
        """
        return self._learn(X, y, sample_weight, anew=True)

    def partial_fit(self, X, y, sample_weight=None):
        """Learn from the samples that follow those of the calls before, as `fit` does of all at once.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            Weight of each squared error, beside that of forgetting; 0 for a lost sample.

        Returns
        -------
        estimator
            The estimator itself, with `coef_` and `intercept_`.

        Raises
        ------
        InputError
            As for `fit`, and when the numbers of features or outputs differ from those before.

        Examples
        --------
        >>> rls = estimation.RecursiveLeastSquares(forgetting=0.5, fit_intercept=False)
        >>> rls.partial_fit(np.ones((20, 1)), 2 * np.ones(20)).coef_.round(3)
        array([2.])
        >>> rls.partial_fit(np.ones((20, 1)), 3 * np.ones(20)).coef_.round(3)  # it has changed meanwhile
        array([3.])
        """
        return self._learn(X, y, sample_weight, anew=not hasattr(self, "coef_"), whole=False)


class UnweightedRegressor(RecursiveRegressor):
    def fit(self, X, y):
        """Learn from samples in their order, from the start.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)

        Returns
        -------
        estimator
            The estimator itself, with `coef_` and `intercept_`.

        Raises
        ------
        InputError
            When a setting is out of its range, a table does not fit, or no sample is without NaN.

        Examples
        --------
        >>> lms = estimation.LeastMeanSquares(step_size=1.0, fit_intercept=False)
        >>> lms.fit([[1.0], [2.0]], [3.0, 6.0]).coef_.round(3)
        array([3.])
        """
        return self._learn(X, y, None, anew=True)

    def partial_fit(self, X, y):
        """Learn from the samples that follow those of the calls before, as `fit` does of all at once.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)

        Returns
        -------
        estimator
            The estimator itself, with `coef_` and `intercept_`.

        Raises
        ------
        InputError
            As for `fit`, and when the numbers of features or outputs differ from those before.

        Examples
        --------
        >>> lms = estimation.LeastMeanSquares(step_size=1.0, fit_intercept=False).partial_fit([[1.0]], [2.0])
        >>> lms.partial_fit([[2.0]], [6.0]).coef_.round(3)  # the second sample meets 3
        array([3.])
        """
        return self._learn(X, y, None, anew=not hasattr(self, "coef_"), whole=False)

    def _constant(self, X):
        sizes = np.sqrt(np.mean(X**2, axis=1))
        return float(sizes[np.argmax(sizes > 0)]) or 1.0


@dataclass(eq=False, repr=False)
class LeastMeanSquares(UnweightedRegressor):
    """Normalised least mean squares: coef += step_size (y - coef x) x' / (regularisation + |x|^2).

    `fit` is one pass over the samples in their order.

    Attributes
    ----------
    step_size : float
        Above 0 and below 2; 1 fits every sample exactly, less averages over more samples.
    regularisation : float, optional
        Above 0, in squared units of the features; without it 1e-5 of the largest |x|^2 so far.
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Initial value; zero by default.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    scale_ratio_ : float
        Largest over smallest root mean square of the features: the smallest one takes this ratio squared times longer.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; raised by `fit` and `partial_fit`.

    Warns
    -----
    UnlikeScalesWarning
        From `fit`, when features differ so much in size that the samples were too few to learn that of the smallest.

    Notes
    -----
    The same kernel as of `FeLms`. Without an intercept, a sample without excitation changes nothing. The intercept is
    learned as the coefficient of a constant feature as large as the others in the first sample that is not zero.

    References
    ----------
    Haykin, Adaptive Filter Theory (2002), chapter 6.

    Examples
    --------
    >>> X = np.random.default_rng(1).standard_normal((500, 2))
    >>> lms = estimation.LeastMeanSquares(step_size=0.5).fit(X, X @ [3.0, -5.0] + 7.0)
    >>> lms.coef_.round(3), round(lms.intercept_, 3)
    (array([ 3., -5.]), 7.0)
    """

    step_size: Any = 0.1
    regularisation: Any = None
    initial_coef: Any = None
    fit_intercept: Any = True

    def _start(self, columns, outputs):
        # the estimate, the largest |x|^2 so far, sums of the features' squares, and how many samples
        return self._initial(self.initial_coef, columns, outputs), 0.0, np.zeros(self.n_features_in_), 0

    def _warn(self):
        _, _, sums, samples = self._state
        # of the smallest feature so much is learned in a sample
        share = float(self.step_size) * np.min(sums[sums > 0], initial=np.inf) / (sums.sum() or 1.0)
        if self.scale_ratio_ > UNLIKE and samples * share < 1:
            self._warn_unlike(f"is not learned in fewer than {1 / share:.2g} samples")

    def _advance(self, state, rows, outputs, weights):
        coef = state[0].copy()
        settings = FeLms(self.step_size, SHARE if self.regularisation is None else self.regularisation)
        require_number("step_size", self.step_size, below=2.0)
        squares = np.einsum("ij,ij->i", rows, rows)
        squares_of_features = np.einsum("ij,ij->j", rows, rows)[: self.n_features_in_]
        largest = np.maximum.accumulate(np.append(state[1], squares))
        if self.regularisation is None:
            # a share of the largest so far is a constant beside rows in units of that one
            unit = np.sqrt(np.where(largest[1:] > 0, largest[1:], 1.0))[:, None]
            rows, outputs = rows / unit, outputs / unit
        steps = settings.step_size, settings.regularisation, settings.trace_copies(1)
        run_felms(coef, *steps, *_record(rows, outputs), False)
        sums = state[2] + squares_of_features
        self._note_scales(sums)
        return (coef, largest[-1], sums, state[3] + len(rows)), coef


@dataclass(eq=False, repr=False)
class RecursiveLeastSquares(WeightedRegressor):
    """Recursive least squares with exponential forgetting, all outputs with one covariance.

    It minimises sum_j forgetting^(t - j) w_j |y_j - coef x_j|^2 plus forgetting^t times the distance from the initial
    estimate, weighted by the inverse of the initial covariance.

    Attributes
    ----------
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Estimate before the first sample; zero without.
    initial_covariance : float or array_like, optional
        P before the first sample, its diagonal, or one number for the diagonal, in units of 1 / feature^2: large if the
        initial estimate is uncertain; an intercept is the last of the unknowns. Without it P follows from the data, as in `LeastSquares`, so that no unit of a feature matters.
    growth_limit : float
        Guard against wind-up, as `growth_limit` of `FeRls`: how far the variance of a coefficient may grow while
        nothing excites it; ``inf`` for none. Without forgetting there is no wind-up, and it is not used.
    form : str
        How the covariance is kept, as `form` of `FeRls`.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    held_ : ndarray, shape (features,)
        Share of the last time constant, 0 to 1, in which `growth_limit` held the variance of a coefficient down.
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
    The same kernel as of `FeRls`. `set_params` between two calls of `partial_fit` changes `forgetting`; the start and
    the form remain as they were.

    References
    ----------
    Haykin, Adaptive Filter Theory (2002), chapter 9.

    Examples
    --------
    >>> X = np.random.default_rng(1).standard_normal((500, 2))
    >>> y = np.append(X[:250] @ [1.0, 2.0], X[250:] @ [3.0, -5.0])  # it changes half way
    >>> estimation.RecursiveLeastSquares(forgetting=0.95).fit(X, y + 7.0).coef_.round(3)
    array([ 3., -5.])
    """

    forgetting: Any = 1.0
    initial_coef: Any = None
    initial_covariance: Any = None
    growth_limit: Any = 1e6
    form: Any = "safe"
    fit_intercept: Any = True

    def _warn(self):
        if (self.held_ > 0.5).any():
            warn_held(np.flatnonzero(self.held_ > 0.5), stacklevel=5)

    @property
    def covariance_(self):
        """P after the last sample, an intercept last; times the variance of the noise that of the estimate."""
        check_is_fitted(self)
        return self._state[1].covariance

    @property
    def held_(self):
        """Share of the last time constant in which `growth_limit` held a variance down, shape (features,)."""
        check_is_fitted(self)
        return self._state[1].held[: self.n_features_in_]

    def _start(self, columns, outputs):
        # the estimate, P, the largest square of each column so far, infinite where P was given, and how many samples
        coef, recursion = self._initial(self.initial_coef, columns, outputs), self._settings().start(columns)
        if self.initial_covariance is not None:
            return coef, recursion, np.full(columns, np.inf), 0
        recursion.levels[0] = np.inf
        return coef, recursion, np.zeros(columns), 0

    def _settings(self) -> FeRls:
        forgetting = require_number("forgetting", self.forgetting, above=0.0, at_most=1.0)
        limit = self.growth_limit if forgetting < 1 else np.inf
        initial = START if self.initial_covariance is None else self.initial_covariance
        return FeRls(initial, float(forgetting), limit, self.form)

    def _advance(self, state, rows, outputs, weights):
        coef, largest, first = state[0].copy(), state[2].copy(), 0
        recursion = state[1].copy()
        if not (isinstance(self.forgetting, float) and self.forgetting == recursion.forgetting):
            recursion = recursion._replace(forgetting=self._settings().forgetting)
        squares = np.square(rows)
        if weights is not ONE:
            squares /= np.where(weights > 0, weights, 1.0)[:, None]
        while first < len(squares):
            larger = (squares[first:] > largest).any(axis=1)
            if larger[0]:
                recursion = self._believe_start(coef, recursion, largest, squares[first])
                largest = np.fmax(largest, squares[first])
                larger = (squares[first:] > largest).any(axis=1)
            # up to the next sample with a feature that is larger than ever before
            ahead = int(larger.argmax())
            last = first + ahead if larger[ahead] else len(squares)
            record = _record(rows[first:last], outputs[first:last])
            stopped, _ = run_ferls(coef, recursion, *recursion[-2:], *record, False, state[3] + first)
            if stopped < len(record[0]):
                raise InputError(
                    "initial_covariance, growth_limit and X together make the covariance indefinite; give a smaller "
                    "initial_covariance, a finite growth_limit, features of similar size, or form 'UD'"
                )
            first = last
        return (coef, recursion, largest, state[3] + len(rows)), coef

    def _believe_start(self, coef, recursion, largest, squares):
        # P with the start believed as `LeastSquares` does; `coef` moves in place
        start = self._initial(self.initial_coef, len(squares), len(coef))
        covariance, levels, gain = recursion.covariance, recursion.levels.copy(), np.zeros(len(squares))
        rise = (squares - largest) / START
        for i in np.flatnonzero(rise > 0):
            if largest[i] == 0:
                covariance[i, i], levels[0, i] = 0.0, np.inf
            admit_start(covariance, i, rise[i])
            levels[0, i] = min(levels[0, i], recursion.allowance / INFLATION * START / squares[i])
        for i in np.flatnonzero((rise > 0) & (largest > 0)):
            share = believe_start(covariance, i, rise[i], gain)
            coef += share * np.outer(start[:, i] - coef[:, i], gain)
        return recursion._replace(matrix=factor_of(FORMS[recursion.form], covariance), levels=levels)


def _record(rows, outputs) -> tuple:
    """What a kernel takes to fit a record: e = coef x - y, no ceiling on it, and no history."""
    nothing = np.empty((0, outputs.shape[1], rows.shape[1]))
    return np.ascontiguousarray(rows), np.ascontiguousarray(-outputs), True, np.inf, nothing, len(rows) + 1


def _is_plain(value) -> bool:
    # numbers as they are calculated with, none of them infinite
    return (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.size > 0
        and value.ndim in (1, 2)
        and not np.isinf(value).any()
    )


def _as_input_error(name, check, *values, **how) -> np.ndarray:
    """What scikit-learn's check returns; what it refuses is refused as an `InputError` with the argument's name."""
    if isinstance(values[-1], np.ma.MaskedArray):
        raise InputError(f"{name} is a masked array; give {name}.filled(np.nan), a sample with NaN is lost")
    try:
        with np.errstate(all="ignore"):
            return check(*values, **how)
    except TypeError as error:
        raise _InputTypeError(f"{name}: {' '.join(str(error).split())}") from None
    except (ValueError, OverflowError) as error:
        raise InputError(f"{name}: {' '.join(str(error).split())}") from None


def _lost(X, y) -> np.ndarray:
    return np.isnan(X).any(axis=1) | np.isnan(y.reshape(len(y), -1)).any(axis=1)


def _nothing() -> InputError:
    return InputError("X and y hold no sample without NaN; give at least one")
