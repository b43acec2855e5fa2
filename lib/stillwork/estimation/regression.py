"""Recursive estimators with scikit-learn's interface: `fit` for a record, `partial_fit` for a stream.

They follow its protocol without its base classes, whose import takes longer than all else of a first call: it is imported
for tables that are no arrays of numbers, for scores, and where it asks by itself. A sample with NaN in a feature or an
output is lost: forgetting acts, but nothing is learned.
A call that is refused changes nothing.
"""

import math
import warnings
from dataclasses import fields
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from stillwork.base.checks import (
    InputError,
    nearest,
    pluralise,
    require_array,
    require_count,
    require_kind,
    require_number,
)
from stillwork.base.extras import MissingPackage, require_package
from stillwork.estimation.recursive import LARGEST, require_finite_squares, require_squares
from stillwork.estimation.triangle_kernels import NO_BOUNDS, empty_record, learn_rows, start_record

NUMBERS = {"dtype": np.float64, "ensure_all_finite": "allow-nan"}  # what scikit-learn's checks are to return
ONE = np.ones(1)  # the weight of a sample that needs none


class UnlikeScalesWarning(UserWarning):
    """Features differ so much in size that the small ones are not learned: use units in which they are similar."""


class _InputTypeError(InputError, TypeError):
    """What scikit-learn calls a TypeError and the toolbox an InputError."""


class RecursiveRegressor:
    # y = coef x + intercept. A subclass is a dataclass of its settings, and keeps what it needs of the rows in `_state`.
    fit_intercept: Any
    n_features_in_: int
    _has_intercept: bool

    def get_params(self, deep=True):
        """Settings by name, as scikit-learn asks for them.

        Parameters
        ----------
        deep : bool
            Without effect: no setting is an estimator.

        Returns
        -------
        dict

        Examples
        --------
        >>> estimation.LeastMeanSquares(step_size=0.5).get_params()["step_size"]
        0.5
        """
        return {each.name: getattr(self, each.name) for each in fields(self)}  # type: ignore[arg-type]

    def set_params(self, **params):
        """Change settings.

        Parameters
        ----------
        **params
            New values by name; `fit` and `partial_fit` check them.

        Returns
        -------
        estimator
            The estimator itself.

        Raises
        ------
        InputError
            When a setting has another name.

        Examples
        --------
        >>> estimation.LeastMeanSquares().set_params(step_size=0.5).step_size
        0.5
        """
        known = list(self.get_params())
        for name in params:
            if name not in known:
                raise InputError(
                    f"{type(self).__name__} has no setting {name!r}; it has {', '.join(known)}{nearest(name, known)}"
                )
        vars(self).update(params)
        return self

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
        self._require_fitted()
        return self._outputs(self._features(X, anew=False))

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
        self._require_fitted()
        X, y, weights = self._samples(X, y, sample_weight, anew=False)
        used = ~_lost(X, y)
        if not weights[used].any():
            raise _nothing()
        r2_score = require_package("sklearn.metrics").r2_score
        return r2_score(y[used], self._outputs(X[used]), sample_weight=weights[used])

    def __sklearn_tags__(self):
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=True, multi_output=True),
            regressor_tags=RegressorTags(),
            input_tags=InputTags(allow_nan=True),
        )

    def _outputs(self, X):
        return X @ self.coef_.T + self.intercept_

    def _require_fitted(self) -> None:
        if not hasattr(self, "coef_"):
            error = getattr(_of_scikit_learn("exceptions"), "NotFittedError", InputError)
            raise error(f"this {type(self).__name__} is not fitted; call fit or partial_fit first")

    def _update(self, X, outputs, weights, anew) -> tuple[np.ndarray, np.ndarray]:
        # Rows more in `_state`; coefficients, a row for each output, and intercepts. Rows of weight 0 are zero.
        raise NotImplementedError

    def _warn(self) -> None:
        """Warn after `fit` of what the settings did to the estimate."""

    def _warn_unlike(self, ratio: float, what: str) -> None:
        warnings.warn(
            f"the largest feature is {ratio:.3g} times as large as the smallest, whose coefficient {what}; "
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
        single, outputs = y.ndim == 1, y.reshape(len(y), -1)
        intercept = bool(require_kind("fit_intercept", self.fit_intercept, (bool, np.bool_)))
        if not anew:
            if y.shape[1:] != self.coef_.shape[:-1]:
                raise InputError(
                    f"y has {pluralise(outputs.shape[1], 'output')}; give as many outputs as in the calls before"
                )
            if intercept != self._has_intercept:
                raise InputError("fit_intercept has changed since the calls before; call fit")
        self._has_intercept = intercept
        coef, offset = self._update(X, outputs, weights, anew)
        if not (np.isfinite(coef).all() and np.isfinite(offset).all()):
            raise InputError("X and y lead to an overflow; give them in other units")
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
        y = _as_doubles(y)
        if not _is_plain(y):
            y = _as_input_error("y", "check_array", y, ensure_2d=False, input_name="y", **NUMBERS)
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
        # an array of numbers needs none of the checks that take ten times as long as a step
        X = _as_doubles(X)
        plain = _is_plain(X) and X.ndim == 2 and (anew or not hasattr(self, "feature_names_in_"))
        if plain and anew:
            self.n_features_in_ = X.shape[1]
            vars(self).pop("feature_names_in_", None)
        elif not (plain and X.shape[1] == self.n_features_in_):
            X = _as_input_error("X", "validate_data", self, X, reset=anew, **NUMBERS)
        require_finite_squares("X", X)
        return X

    def _initial(self, coef, columns, outputs):
        # an initial estimate as the kernels take it: one row per output; an intercept starts at zero
        start = np.zeros((outputs, columns))
        if coef is not None:
            given = np.atleast_2d(require_array("initial_coef", coef))
            if given.shape != start.shape:
                raise InputError(
                    f"initial_coef has shape {np.shape(coef)}; give {start.shape}, or {start.shape[1:]} for one output"
                )
            start[:] = given
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


class Kept(NamedTuple):
    """What a triangle keeps of a stream."""

    record: np.ndarray  # see `triangle_kernels`
    recent: (
        np.ndarray
    )  # (window, 1 + features + outputs): weight and row of the last samples; empty without a window
    samples: np.ndarray  # how many, (1,)
    alphas: np.ndarray  # of a min-max estimate, an output each
    first: np.ndarray  # the initial estimate where it has no covariance: what is kept are deviations from it


class TriangleRegressor(WeightedRegressor):
    # A subclass has `forgetting`, `window`, `initial_coef`, `initial_covariance`.
    forgetting: Any
    window: Any
    initial_coef: Any
    initial_covariance: Any
    _state: Kept

    def __post_init__(self):
        compile_rows()

    def _start(self, features, outputs) -> Kept:
        first = self._initial(self.initial_coef, features, outputs)
        window = 0 if self.window is None else require_count("window", self.window, at_least=1)
        record = start_record(first, self.initial_covariance)
        known = record.any()
        if window and known:
            raise InputError("initial_covariance never leaves a window; give one of the two")
        recent = np.zeros((window, 1 + features + outputs))
        kept = np.zeros_like(first) if known else first
        return Kept(record, recent, np.zeros(1, np.int64), np.zeros(outputs), kept)

    def _advance(
        self, X, outputs, weights, anew, share, bounds, per_sample=False
    ) -> tuple[np.ndarray, np.ndarray, bool]:
        # coefficients, intercepts, and whether an estimate with bounds is decided
        forgetting = self.forgetting
        if not (type(forgetting) is float and 0.0 < forgetting <= 1.0):
            forgetting = float(require_number("forgetting", forgetting, above=0.0, at_most=1.0))
        if anew:
            self._state = self._start(X.shape[1], outputs.shape[1])
        record, recent, count, alphas, first = self._state
        record, alphas, count = record.copy(), alphas.copy(), count.copy()
        recent = recent.copy() if len(recent) else recent
        # the kernel is compiled for arrays as numpy makes them: not for those of a reader that are read-only or strided
        X = _as_made(X)
        outputs = _as_made(outputs) if self.initial_coef is None else outputs - X @ first.T
        weights = _as_made(weights)
        found = np.zeros((outputs.shape[1], X.shape[1] + 1))
        decided = learn_rows(
            record, recent, count, X, outputs, weights, forgetting, share, self._has_intercept, bounds, per_sample,
            alphas, found,
        )  # fmt: skip
        self._state = Kept(record, recent, count, alphas, first)
        return first + found[:, :-1], found[:, -1].copy(), decided


@cache
def compile_rows() -> None:
    """Compile the kernel of a row, so that no sample of a stream waits for it."""
    row, count, empty = np.zeros((1, 1)), np.zeros(1, np.int64), np.empty((0, 3))
    learn_rows(
        empty_record(1, 1),
        empty,
        count,
        row,
        row,
        ONE,
        1.0,
        1.0,
        True,
        NO_BOUNDS,
        False,
        ONE.copy(),
        np.zeros((1, 2)),
    )


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


def _as_doubles(value):
    """Lists and arrays of real numbers as an array that is calculated with; all else as it is."""
    if type(value) not in (np.ndarray, np.memmap, list):
        return value
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return value
    return np.asarray(array, np.float64) if array.dtype.kind in "fiub" else value


def _is_plain(value) -> bool:
    # numbers as they are calculated with, none of them infinite
    return (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.size > 0
        and value.ndim in (1, 2)
        and not np.isinf(value).any()
    )


def _of_scikit_learn(module: str):
    """A module of scikit-learn; None where it is not installed."""
    try:
        return require_package(f"sklearn.{module}")
    except MissingPackage:
        return None


def _as_input_error(name, check, *values, **how) -> np.ndarray:
    """What scikit-learn's check returns; what it refuses is refused as an `InputError` with the argument's name."""
    value = values[-1]
    if isinstance(value, np.ma.MaskedArray):
        raise InputError(f"{name} is a masked array; give {name}.filled(np.nan), a sample with NaN is lost")
    if type(value) is np.ndarray and value.dtype == np.float64 and not _of_scikit_learn("utils"):
        raise InputError(
            f"{name} is an array of shape {value.shape} with {np.isinf(value).sum()} infinite values; give finite "
            "numbers, or NaN for what is lost, as X (samples, features) with the features of before, and y (samples,) or "
            "(samples, outputs)"
        )
    check = getattr(require_package("sklearn.utils.validation"), check)
    try:
        with np.errstate(all="ignore"):
            return check(*values, **how)
    except TypeError as error:
        raise _InputTypeError(f"{name}: {' '.join(str(error).split())}") from None
    except (ValueError, OverflowError) as error:
        raise InputError(f"{name}: {' '.join(str(error).split())}") from None


def _as_made(values: np.ndarray) -> np.ndarray:
    return values if values.flags.c_contiguous and values.flags.writeable else np.array(values, order="C")


def _lost(X, y) -> np.ndarray:
    if not math.isnan(X.sum() + y.sum()):  # neither holds infinity; the rest takes ten times as long
        return np.zeros(len(X), bool)
    return np.isnan(X).any(axis=1) | np.isnan(y.reshape(len(y), -1)).any(axis=1)


def _nothing() -> InputError:
    return InputError("X and y hold no sample without NaN; give at least one")
