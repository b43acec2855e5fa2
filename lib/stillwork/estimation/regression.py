"""Recursive estimators with scikit-learn's interface: a record at once with `fit`, a stream with `partial_fit`.

They need no scikit-learn, and stand in its pipelines and searches where there is one.

A sample with NaN in it (a feature or an output) is lost: time passes, so that forgetting forgets, and nothing is learned.
Of a data frame the names of the columns are kept in `feature_names_in_`; a later frame with other names, or the same in
another order, is refused.
Complex data are turned into twice as many real rows and coefficients, [Re x, -Im x] and [Im x, Re x] for a sample x;
this keeps every norm, so that each of the three criteria is the complex one.
"""

import warnings
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from stillwork.base.checks import (
    InputError,
    counted,
    nearest,
    require_array,
    require_choice,
    require_kind,
    require_number,
)
from stillwork.estimation.adaptive import INFLATION, FeLms, FeRls
from stillwork.estimation.covariance_forms import FORMS, factor_of
from stillwork.estimation.min_max import ZeroEstimateWarning, solve_silently, triangle
from stillwork.estimation.online import run_felms, run_ferls
from stillwork.estimation.recursive import require_finite_squares, require_squares, warn_held
from stillwork.estimation.recursive_kernels import admit_start, believe_start
from stillwork.estimation.recursive_settings import START
from stillwork.estimation.secular import ROUNDING

SHARE = 1e-5  # regularisation of least mean squares over the largest |x|^2, where it follows from the data


class _NotNumbers(InputError, TypeError):
    """What scikit-learn calls a TypeError and the toolbox an InputError."""


class _LinearRegressor:
    # y = coef x. A subclass starts a state and advances it by rows; of a call that is refused nothing is kept.
    complex_data: Any

    def get_params(self, deep=True):
        """Parameters by name.

        Parameters
        ----------
        deep : bool
            For scikit-learn, which asks for parameters of parts; there are none.

        Returns
        -------
        dict
            For another estimator of this kind, or for `set_params`.

        Examples
        --------
        >>> estimation.LeastMeanSquares(step_size=0.5).get_params()["step_size"]
        0.5
        """
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def set_params(self, **parameters):
        """Change parameters by name.

        Parameters
        ----------
        parameters : object
            New values.

        Returns
        -------
        estimator
            Itself.

        Raises
        ------
        InputError
            When there is no such parameter; a value is judged by the next `fit` or `partial_fit`.

        Examples
        --------
        >>> estimation.LeastMeanSquares().set_params(step_size=0.5).step_size
        0.5
        """
        known = self.get_params()
        for name, value in parameters.items():
            if name not in known:
                raise InputError(
                    f"{name} is no parameter of {type(self).__name__}; use {', '.join(known)}{nearest(name, known)}"
                )
            setattr(self, name, value)
        return self

    def fit(self, X, y):
        """Learn from samples in their order, from the start.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)

        Returns
        -------
        estimator
            Itself, with `coef_`.

        Raises
        ------
        InputError
            When a setting is out of its range, a table does not fit, or no sample is without NaN.

        Examples
        --------
        >>> estimation.LeastMeanSquares(step_size=1.0).fit([[1.0], [2.0]], [3.0, 6.0]).coef_.round(3)
        array([3.])
        """
        return self._learn(X, y, None, anew=True, whole=True)

    def partial_fit(self, X, y):
        """Learn from the samples that follow those of the calls before, as `fit` does of all at once.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)

        Returns
        -------
        estimator
            Itself, with `coef_`.

        Raises
        ------
        InputError
            As `fit` does, and when the numbers of features or outputs differ from those before; nothing is then kept.

        Examples
        --------
        >>> lms = estimation.LeastMeanSquares(step_size=1.0).partial_fit([[1.0]], [2.0])
        >>> lms.partial_fit([[2.0]], [6.0]).coef_.round(3)  # the second sample meets 3
        array([3.])
        """
        return self._learn(X, y, None, anew=not hasattr(self, "coef_"))

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
            When X does not fit what was learned.
        NotFittedError
            Before the first `fit` or `partial_fit`; `InputError` without scikit-learn.

        Examples
        --------
        >>> estimation.LeastMeanSquares(step_size=1.0).fit([[1.0]], [3.0]).predict([[2.0], [np.nan]]).round(3)
        array([ 6., nan])
        """
        return self._features(X, anew=False) @ self.coef_.T

    def score(self, X, y, sample_weight=None):
        """Coefficient of determination 1 - |y - prediction|^2 / |y - mean|^2, its mean over the outputs.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            How many samples each one stands for.

        Returns
        -------
        float
            1 for a perfect prediction, 0 for that of the mean.

        Raises
        ------
        InputError
            When a table does not fit, or no sample is without NaN.
        NotFittedError
            Before the first `fit` or `partial_fit`; `InputError` without scikit-learn.

        Examples
        --------
        >>> lms = estimation.LeastMeanSquares(step_size=1.0).fit([[1.0]], [3.0])
        >>> round(lms.score([[1.0], [2.0]], [3.0, 6.0]), 6)
        1.0
        """
        X, y, weights = self._samples(X, y, sample_weight, anew=False)
        used = ~_lost(X, y)
        if not weights[used].any():
            raise _nothing()
        X, y, weights = X[used], y[used], weights[used]
        left = weights @ np.abs(y - X @ np.atleast_2d(self.coef_).T) ** 2
        spread = weights @ np.abs(y - np.average(y, axis=0, weights=weights)) ** 2
        constant = spread == 0
        return float(np.mean(np.where(constant, left == 0, 1 - left / np.where(constant, 1.0, spread))))

    def __sklearn_tags__(self):
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=True, multi_output=True),
            regressor_tags=RegressorTags(),
            input_tags=InputTags(allow_nan=True),
        )

    def _start(self, features, outputs) -> Any:
        raise NotImplementedError

    def _advance(self, state, rows, outputs, weights) -> tuple[Any, np.ndarray]:
        raise NotImplementedError

    def _learn(self, X, y, sample_weight, anew, whole=False):
        names = _column_names(X)
        X, targets, weights = self._samples(X, y, sample_weight, anew=anew)
        single, lost = np.asanyarray(y).ndim == 1, _lost(X, targets)
        if anew and lost.all():
            raise _nothing()
        if whole:  # a part of a stream may be as quiet as it likes
            require_squares("X", X)
            require_squares("y", targets)
        weights[lost] = 0
        rows, outputs = (np.sqrt(weights)[:, None] * np.nan_to_num(part) for part in (X, targets))
        if self.complex_data:
            rows = _interleaved(np.hstack([rows.real, -rows.imag]), np.hstack([rows.imag, rows.real]))
            outputs = _interleaved(outputs.real, outputs.imag)
        if anew:
            state = self._start(rows.shape[1], outputs.shape[1])
        elif single == (self.coef_.ndim == 1) and targets.shape[1] == len(np.atleast_2d(self.coef_)):
            state = self._state
        else:
            raise InputError(
                f"y has {counted(targets.shape[1], 'output')}; give as many outputs as in the calls before"
            )
        state, found = self._advance(state, rows, outputs, weights)
        if not np.isfinite(found).all():
            raise InputError("X and y lead out of the finite numbers; give them in other units")
        if self.complex_data:
            found = found[:, : X.shape[1]] + 1j * found[:, X.shape[1] :]
        self._state, self.n_features_in_ = state, X.shape[1]
        if anew:
            vars(self).pop("feature_names_in_", None)
            if names is not None:
                self.feature_names_in_ = names
        self.coef_ = found[0].copy() if single else found.copy()  # a reader may change it
        return self

    def _fitted(self):
        if hasattr(self, "coef_"):
            return self
        try:
            from sklearn.exceptions import NotFittedError
        except ModuleNotFoundError:
            NotFittedError = InputError
        raise NotFittedError(f"{type(self).__name__} has learned nothing yet; call fit or partial_fit first")

    def _samples(self, X, y, sample_weight, anew):
        # X, outputs as columns, and a weight for each sample
        X = self._features(X, anew)
        if y is None:
            raise InputError(
                f"{type(self).__name__} requires y to be passed, but the target y is None; give it"
            )
        y = self._table("y", y)
        if len(y) != len(X):
            raise InputError(
                f"y has {counted(len(y), 'sample')} but X has {len(X)}; give one output for each"
            )
        if sample_weight is None:
            return X, y, np.ones(len(X))
        weights = require_array("sample_weight", sample_weight, shape=(len(X),)).copy()
        if np.any(weights < 0):
            raise InputError("sample_weight holds a negative number; give weights of zero or above")
        return X, y, weights

    def _features(self, X, anew):
        if anew:
            return self._table("X", X)
        known, names = getattr(self._fitted(), "feature_names_in_", None), _column_names(X)
        if known is not None and names is not None and not np.array_equal(known, names):
            raise InputError(
                f"X has the columns {', '.join(names)}: The feature names should match those that were passed during fit; "
                f"give {', '.join(known)}, in this order"
            )
        return self._table("X", X, self.n_features_in_)

    def _table(self, name, value, features=None):
        # numbers of any form as a matrix, in which NaN may stand
        if hasattr(value, "toarray"):
            raise InputError(f"{name} is sparse, which is not supported; give {name}.toarray()")
        dtype = np.dtype(
            complex if require_kind("complex_data", self.complex_data, (bool, np.bool_)) else float
        )
        try:
            given = np.asanyarray(value)
            if given.dtype.kind == "O" and any(isinstance(each, str | bytes) for each in given.flat):
                raise TypeError("it holds texts")
            if given.dtype.kind == "O":  # a frame's own conversion knows its missing values
                given = (
                    value.to_numpy(dtype, na_value=np.nan) if hasattr(value, "iloc") else given.astype(dtype)
                )
        except (TypeError, ValueError, OverflowError) as error:
            raise _NotNumbers(f"{name} is no table of numbers ({error}); give a rectangular array") from None
        if given.dtype.kind == "c" and dtype.kind != "c":
            raise InputError(
                f"{name}: Complex data not supported without complex_data=True; set it, or give real ones"
            )
        if name == "y" and given.ndim == 1:
            given = given[:, None]
        if given.ndim != 2:
            raise InputError(
                f"{name} has shape {given.shape}; give (samples, columns). Reshape your data with "
                f"{name}.reshape(-1, 1) for one column, or {name}.reshape(1, -1) for one sample"
            )
        if features is not None and given.shape[1] != features:
            raise InputError(
                f"{name} has {given.shape[1]} features, but {type(self).__name__} is expecting {features} features as "
                "input; give those it has learned from"
            )
        if not given.size:
            raise InputError(
                f"{name} has {len(given)} sample(s) of {given.shape[1]} feature(s) (shape={given.shape}) while a minimum of "
                "1 is required; give more"
            )
        table = require_array(name, given, dtype=dtype, missing=True)
        require_finite_squares(name, table)
        return table

    def _initial(self, coef, features, outputs):
        # an initial estimate as the kernels take it: real, one row an output
        if coef is None:
            return np.zeros((outputs, features))
        given = np.atleast_2d(
            require_array("initial_coef", coef, dtype=complex if self.complex_data else float)
        )
        wanted = (outputs, features // 2 if self.complex_data else features)
        if given.shape != wanted:
            raise InputError(
                f"initial_coef has shape {np.shape(coef)}; give {wanted}, or {wanted[1:]} for one output"
            )
        return np.hstack([given.real, given.imag]) if self.complex_data else given.copy()


class _WeightedRegressor(_LinearRegressor):
    def fit(self, X, y, sample_weight=None):
        """Learn from samples in their order, from the start.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            How many samples each one stands for; a weight of zero is a lost sample.

        Returns
        -------
        estimator
            Itself, with `coef_`.

        Raises
        ------
        InputError
            When a setting is out of its range, a table does not fit, or no sample is without NaN.

        Examples
        --------
        >>> X, y = [[1.0], [2.0], [3.0]], [2.0, 4.0, 99.0]
        >>> estimation.RecursiveLeastSquares().fit(X, y, sample_weight=[1, 1, 0]).coef_.round(3)  # the last is lost
        array([2.])
        """
        return self._learn(X, y, sample_weight, anew=True, whole=True)

    def partial_fit(self, X, y, sample_weight=None):
        """Learn from the samples that follow those of the calls before, as `fit` does of all at once.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            How many samples each one stands for; a weight of zero is a lost sample.

        Returns
        -------
        estimator
            Itself, with `coef_`.

        Raises
        ------
        InputError
            As `fit` does, and when the numbers of features or outputs differ from those before; nothing is then kept.

        Examples
        --------
        >>> rls = estimation.RecursiveLeastSquares(forgetting=0.5).partial_fit(np.ones((20, 1)), 2 * np.ones(20))
        >>> rls.partial_fit(np.ones((20, 1)), 3 * np.ones(20)).coef_.round(3)  # it has changed meanwhile
        array([3.])
        """
        return self._learn(X, y, sample_weight, anew=not hasattr(self, "coef_"))


@dataclass(eq=False)
class LeastMeanSquares(_LinearRegressor):
    """Normalised least mean squares: coef += step_size (y - coef x) x' / (regularisation + |x|^2).

    `fit` is one pass over the samples in their order.

    Attributes
    ----------
    step_size : float
        Above 0 and below 2; 1 meets every sample exactly, less averages over more of them.
    regularisation : float, optional
        Above 0, in squared units of the features; without it 1e-5 of the largest |x|^2 so far.
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Where to start; zero without.
    complex_data : bool
        Whether X and y may be complex.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; `fit` and `partial_fit` say so.

    Notes
    -----
    The same kernel as of `FeLms`. A sample without excitation changes nothing.

    References
    ----------
    Haykin, Adaptive Filter Theory (2002), chapter 6.

    Examples
    --------
    >>> X = np.random.default_rng(1).standard_normal((500, 2))
    >>> estimation.LeastMeanSquares(step_size=0.5).fit(X, X @ [3.0, -5.0]).coef_.round(3)
    array([ 3., -5.])
    """

    step_size: Any = 0.1
    regularisation: Any = None
    initial_coef: Any = None
    complex_data: Any = False

    def _start(self, features, outputs):
        # the estimate, and the largest |x|^2 so far
        return self._initial(self.initial_coef, features, outputs), 0.0

    def _advance(self, state, rows, outputs, weights):
        coef = state[0].copy()
        settings = FeLms(self.step_size, SHARE if self.regularisation is None else self.regularisation)
        require_number("step_size", self.step_size, below=2.0)
        squares = np.einsum("ij,ij->i", rows, rows)
        largest = np.maximum.accumulate(np.append(state[1], squares))
        if self.regularisation is None:
            # a share of the largest so far is a constant beside rows in units of that one
            unit = np.sqrt(np.where(largest[1:] > 0, largest[1:], 1.0))[:, None]
            rows, outputs = rows / unit, outputs / unit
        steps = settings.step_size, settings.regularisation, settings.trace_copies(1)
        run_felms(coef, *steps, *_record(rows, outputs), False)
        return (coef, largest[-1]), coef


@dataclass(eq=False)
class RecursiveLeastSquares(_WeightedRegressor):
    """Recursive least squares with exponential forgetting, all outputs with one covariance.

    It minimises sum_j forgetting^(t - j) w_j |y_j - coef x_j|^2 plus forgetting^t times the distance from the initial
    estimate, weighted by the inverse of the initial covariance.

    Attributes
    ----------
    forgetting : float
        lambda in (0, 1]; 1 weighs all samples alike.
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Estimate before the first sample; zero without.
    initial_covariance : float or array_like, optional
        P before the first sample, its diagonal, or one number for all of it, in units of 1 / feature^2: large where the
        initial estimate is not believed. Of complex data that of the real parts, then of the imaginary ones, or one
        number. Without it P follows from the data, as in `LeastSquares`, so that no unit of a feature matters.
    growth_limit : float
        Guard against wind-up, as `growth_limit` of `FeRls`: how far the variance of a coefficient may grow while
        nothing excites it; ``inf`` for none. Without forgetting there is no wind-up, and it is not used.
    form : str
        How the covariance is kept, as `form` of `FeRls`.
    complex_data : bool
        Whether X and y may be complex.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    held_ : ndarray, shape (features,)
        Share of the last time constant, 0 to 1, in which `growth_limit` held the variance of a coefficient down.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; `fit` and `partial_fit` say so.

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
    >>> estimation.RecursiveLeastSquares(forgetting=0.95).fit(X, y).coef_.round(3)
    array([ 3., -5.])
    """

    forgetting: Any = 1.0
    initial_coef: Any = None
    initial_covariance: Any = None
    growth_limit: Any = 1e6
    form: Any = "safe"
    complex_data: Any = False

    def fit(self, X, y, sample_weight=None):
        """As of every regressor here, with a warning where a guard acts at the end.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            Weight of each squared error; a weight of zero is a lost sample.

        Returns
        -------
        estimator
            Itself, with `coef_`.

        Raises
        ------
        InputError
            When a setting is out of its range, a table does not fit, or no sample is without NaN.

        Warns
        -----
        GrowthLimitWarning
            When `growth_limit` held a variance down through the last time constant.

        Examples
        --------
        >>> X, y = [[1.0], [2.0], [3.0]], [2.0, 4.0, 99.0]
        >>> estimation.RecursiveLeastSquares().fit(X, y, sample_weight=[1, 1, 0]).coef_.round(3)  # the last is lost
        array([2.])
        """
        super().fit(X, y, sample_weight)
        if (self.held_ > 0.5).any():
            warn_held(np.flatnonzero(self.held_ > 0.5), stacklevel=4)
        return self

    @property
    def covariance_(self):
        """P after the last sample, shape (features, features); times the variance of the noise that of `coef_`."""
        covariance, n = self._fitted()._state[1].covariance, self.n_features_in_
        return covariance[:n, :n] + 1j * covariance[n:, :n] if self.complex_data else covariance

    @property
    def held_(self):
        """Share of the last time constant in which `growth_limit` held a variance down, shape (features,)."""
        return self._fitted()._state[1].held[: self.n_features_in_]

    def _start(self, features, outputs):
        # the estimate, P, and the largest square of each feature so far; infinite where P was given
        coef, recursion = (
            self._initial(self.initial_coef, features, outputs),
            self._settings().start(features),
        )
        if self.initial_covariance is not None:
            return coef, recursion, np.full(features, np.inf)
        recursion.levels[0] = np.inf
        return coef, recursion, np.zeros(features)

    def _settings(self) -> FeRls:
        forgetting = require_number("forgetting", self.forgetting, above=0.0, at_most=1.0)
        limit = self.growth_limit if forgetting < 1 else np.inf
        if self.complex_data:
            forgetting = np.sqrt(forgetting)  # two rows a sample
        initial = START if self.initial_covariance is None else self.initial_covariance
        return FeRls(initial, float(forgetting), limit, self.form)

    def _advance(self, state, rows, outputs, weights):
        coef, largest, first = state[0].copy(), state[2].copy(), 0
        recursion = state[1].copy()._replace(forgetting=self._settings().forgetting)
        together = 2 if self.complex_data else 1  # rows of one sample
        squares = np.square(rows).reshape(len(weights), together, -1).sum(axis=1)
        squares /= np.where(weights > 0, weights, 1.0)[:, None]
        if self.complex_data:
            # the first of two rows is forgotten once more than the second: give it that back
            rows[::2] /= np.sqrt(recursion.forgetting)
            outputs[::2] /= np.sqrt(recursion.forgetting)
        while first < len(squares):
            if (squares[first] > largest).any():
                recursion = self._believe_start(coef, recursion, largest, squares[first])
                largest = np.fmax(largest, squares[first])
            # up to the next sample with a feature that is larger than ever before
            ahead = np.flatnonzero((squares[first:] > largest).any(axis=1))
            last = first + int(ahead[0]) if len(ahead) else len(squares)
            part = slice(together * first, together * last)
            record = _record(rows[part], outputs[part])
            stopped, _ = run_ferls(coef, recursion, *recursion[-2:], *record, False, 0)
            if stopped < len(record[0]):
                raise InputError(
                    "initial_covariance, growth_limit and X together make the covariance indefinite; give a smaller "
                    "initial_covariance, a finite growth_limit, features of similar size, or form 'UD'"
                )
            first = last
        return (coef, recursion, largest), coef

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


@dataclass(eq=False)
class MinMaxRegressor(_WeightedRegressor):
    """Least squares for features that are off by a bounded error: the smallest of the largest residuals.

    Over all perturbations dX with |dX diag(bound)^-1| <= 1 of the features seen so far it minimises the largest
    |y - (X + dX) coef|. Of sample j, row and output carry the weight (w_j forgetting^(t - j))^(1/2).

    Attributes
    ----------
    bound : float or array_like, shape (features,)
        eta, the bound on the 2-norm of the perturbation, in the unit of the features, or one for each column. A column
        of bound 0 is known exactly, such as one of ones for an intercept. `set_params` may change it at any time.
    bound_on : str
        ``record``: of what the bound holds is the perturbation of all weighted samples together, however many.
        ``sample``: of that of each sample, so that of all it grows as (sum of the weights)^(1/2).
    forgetting : float
        lambda in (0, 1]; 1 weighs all samples alike.
    initial_coef : array_like, shape (features,) or (outputs, features), optional
        Estimate before the first sample.
    initial_covariance : float
        Of the initial estimate, which counts as so many samples more; ``inf`` for no initial estimate.
    complex_data : bool
        Whether X and y may be complex.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; `fit` and `partial_fit` say so.

    Notes
    -----
    What is kept of the samples is a triangle that has their residuals, so that the estimate is exact at every time and
    loses no digits; it is that of `min_max_solve`. There is nothing to wind up: an estimate without excitation fades to
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
    >>> X, y = [[1.0, 1.0], [1.0, 1.0], [-1.0, 1.0]], [12.0, 11.0, 9.0]
    >>> estimation.MinMaxRegressor(bound=0.0).fit(X, y).coef_.round(2)  # least squares
    array([ 1.25, 10.25])
    >>> estimation.MinMaxRegressor(bound=[0.5, 0.0]).fit(X, y).coef_.round(2)  # the intercept is free of doubt
    array([ 1.11, 10.3 ])
    """

    bound: Any
    bound_on: Any = "record"
    forgetting: Any = 1.0
    initial_coef: Any = None
    initial_covariance: Any = np.inf
    complex_data: Any = False

    def fit(self, X, y, sample_weight=None):
        """As of every regressor here, with a warning where the bound explains all of the data away.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, targets)
        sample_weight : array_like, shape (samples,), optional
            Weight of each squared residual.

        Returns
        -------
        estimator
            Itself, with `coef_`.

        Raises
        ------
        InputError
            When a setting is out of its range, a table does not fit, or no sample is without NaN.

        Warns
        -----
        ZeroEstimateWarning
            When the bound is so large that the estimate is zero.

        Examples
        --------
        >>> X, y = [[1.0], [2.0], [4.0]], [2.1, 3.9, 8.0]
        >>> loose, tight = (estimation.MinMaxRegressor(bound=b).fit(X, y).coef_[0] for b in (1.0, 0.0))
        >>> bool(loose <= tight)  # doubt only shrinks
        True
        """
        super().fit(X, y, sample_weight)
        if self._state[2]:
            warnings.warn(
                "the estimate is zero: a perturbation within the bound explains all of the data; give a smaller bound or "
                "more samples",
                ZeroEstimateWarning,
                stacklevel=2,
            )
        return self

    def _start(self, features, outputs):
        # the triangle of [X y], the sum of the weights, whether the bound explains all of the data away
        corner = np.zeros((features + outputs, features + outputs))
        if not (isinstance(self.initial_covariance, float) and self.initial_covariance == np.inf):
            root = 1 / np.sqrt(require_number("initial_covariance", self.initial_covariance, above=0.0))
            corner[:features, :features] = root * np.eye(features)
            corner[:features, features:] = root * self._initial(self.initial_coef, features, outputs).T
        elif self.initial_coef is not None:
            raise InputError(
                "initial_covariance is inf, so that initial_coef does not count; give a finite one"
            )
        return corner, 0.0, False

    def _advance(self, state, rows, outputs, weights):
        corner, mass, _ = state
        forgetting = require_number("forgetting", self.forgetting, above=0.0, at_most=1.0)
        fading = forgetting ** np.arange(len(weights) - 1, -1, -1)
        mass = forgetting ** len(weights) * mass + weights @ fading
        root = np.repeat(np.sqrt(fading), len(rows) // len(weights))[:, None]
        past = forgetting ** (len(weights) / 2) * corner
        corner = triangle(np.vstack([past, root * np.hstack([rows, outputs])]))
        features = rows.shape[1]
        bounds = self._bounds(features)
        if require_choice("bound_on", self.bound_on, ("record", "sample")) == "sample":
            bounds = bounds * np.sqrt(mass)
        solved = [_mixed_solution(corner[:, :features], target, bounds) for target in corner.T[features:]]
        return (corner, mass, any(zero for _, zero in solved)), np.array([coef for coef, _ in solved])

    def _bounds(self, features):
        bounds = require_array("bound", self.bound)
        wanted = features // 2 if self.complex_data else features
        if bounds.shape not in ((), (wanted,)):
            raise InputError(
                f"bound has shape {bounds.shape}; give a number, or one for each of {counted(wanted, 'feature')}"
            )
        if np.any(bounds < 0):
            raise InputError("bound holds a negative number; give bounds on a norm, zero or above")
        return np.resize(bounds, features)


def _mixed_solution(matrix, target, bounds) -> tuple[np.ndarray, bool]:
    """Min-max solution with a bound a column, and whether a bound made it zero; those of bound 0 are known exactly.

    min over x of |A x - b| + |diag(bounds) x|: what the known columns explain is taken out of the others first.
    """
    known = bounds == 0
    left, sizes, _ = np.linalg.svd(matrix[:, known], full_matrices=False)
    basis = left[:, sizes > len(matrix) * ROUNDING * np.max(sizes, initial=0.0)]
    doubtful, aimed = ((part - basis @ (basis.T @ part)) for part in (matrix[:, ~known], target))
    coef, zero = np.zeros(len(bounds)), False
    if not known.all():
        largest = bounds.max()
        shares = bounds[~known] / largest
        if shares.min() < 1e-12:
            raise InputError(
                "bound holds numbers that differ by more than 1e12; give 0 for a column known so well"
            )
        solution = solve_silently(doubtful / shares, aimed, largest)
        coef[~known] = solution.estimate / shares
        zero = solution.case == "zero" and solution.threshold > 0
    if known.any():
        coef[known] = np.linalg.lstsq(matrix[:, known], target - matrix @ coef)[0]
    return coef, zero


def _record(rows, outputs) -> tuple:
    """What a kernel takes to fit a record: e = coef x - y, no ceiling on it, and no history."""
    nothing = np.empty((0, outputs.shape[1], rows.shape[1]))
    return np.ascontiguousarray(rows), np.ascontiguousarray(-outputs), True, np.inf, nothing, len(rows) + 1


def _interleaved(first, second) -> np.ndarray:
    return np.stack([first, second], axis=1).reshape(-1, first.shape[1])


def _column_names(X) -> np.ndarray | None:
    # of a data frame whose columns all have names, as scikit-learn keeps them
    names = getattr(X, "columns", None)
    if names is None or not all(isinstance(name, str) for name in names):
        return None
    return np.asarray(names, dtype=object)


def _lost(X, y) -> np.ndarray:
    return np.isnan(X).any(axis=1) | np.isnan(y).any(axis=1)


def _nothing() -> InputError:
    return InputError("X and y hold no sample without NaN; give at least one")
