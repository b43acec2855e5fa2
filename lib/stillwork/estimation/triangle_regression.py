"""Regressors that keep a triangular factor of all samples: min-max, ridge, and estimates for noisy features.

A triangle has the residuals of all weighted rows, so that a stream ends where its batch does, and loses no digits.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from stillwork.base.checks import InputError, pluralise, require_array, require_choice, require_number
from stillwork.base.kernels import kernel_for
from stillwork.estimation.linear_fits import (
    compensated_ridge,
    cross_validated_penalty,
    evidence_penalty,
    instrumental_variables,
    total_least_squares,
)
from stillwork.estimation.min_max import ZeroEstimateWarning, solve_plain
from stillwork.estimation.regression import UNLIKE, WeightedRegressor
from stillwork.estimation.secular import ROUNDING
from stillwork.estimation.triangle_kernels import advance_min_max

PENALTIES = {"evidence": evidence_penalty, "cross-validation": cross_validated_penalty}


class TriangleRegressor(WeightedRegressor):
    """Solves for the estimate from the triangle of [instruments, X, y] in `_solve`; an intercept is the last of X."""

    forgetting: Any
    _instruments: Any = None

    def _start(self, columns, outputs):
        # the triangle, the sum of the weights
        size = columns + outputs + (0 if self._instruments is None else self._instruments.shape[1])
        return np.zeros((size, size)), 0.0

    def _advance(self, state, rows, outputs, weights):
        corner, mass = state[:2]
        forgetting = require_number("forgetting", self.forgetting, above=0.0, at_most=1.0)
        table = np.hstack([rows, outputs])
        if self._instruments is not None:
            table = np.hstack([np.sqrt(weights)[:, None] * self._instruments, table])
        if len(weights) == 1:
            mass = forgetting * mass + float(weights[0])
        else:
            fading = forgetting ** np.arange(len(weights) - 1, -1, -1)
            mass = forgetting ** len(weights) * mass + weights @ fading
            table = np.sqrt(fading)[:, None] * table
        corner = np.linalg.qr(np.concatenate([forgetting ** (len(weights) / 2) * corner, table]), mode="r")
        return (corner, mass), self._solve(corner, rows.shape[1], outputs.shape[1], mass)

    def _solve(self, corner, columns, outputs, mass) -> np.ndarray:
        known = self._known(columns)

        def estimate(matrix, target):
            return self._estimate(matrix, target, max(mass - known.sum(), 0.0))

        matrix, targets = corner[:, :columns], corner.T[columns:]
        return np.array([_solve_around_known(matrix, target, known, estimate) for target in targets])

    def _known(self, columns) -> np.ndarray:
        # which columns are known exactly, or are not to be shrunk
        return np.arange(columns) >= columns - bool(self.fit_intercept)

    def _estimate(self, matrix, target, mass) -> np.ndarray:
        raise NotImplementedError

    def _per_column(self, name, columns) -> np.ndarray:
        # a setting that is one number or one for each feature; an intercept's is zero
        features = columns - bool(self.fit_intercept)
        values = require_array(name, getattr(self, name))
        if values.shape not in ((), (features,)):
            raise InputError(
                f"{name} has shape {values.shape}; give a number, or one for each of {pluralise(features, 'feature')}"
            )
        if np.any(values < 0):
            raise InputError(f"{name} holds a negative number; give zero or above")
        return np.append(np.resize(values, features), np.zeros(columns - features))


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
    >>> X, y = np.array([[1.0], [1.0], [-1.0]]), [12.0, 11.0, 9.0]
    >>> least, robust = (estimation.MinMaxRegressor(bound).fit(X, y) for bound in (0.0, 0.5))
    >>> least.coef_.round(2), robust.coef_.round(2)
    (array([1.25]), array([1.11]))
    """

    _bounds: ClassVar[Any] = None  # those of the last call

    bound: Any
    bound_on: Any = "record"
    forgetting: Any = 1.0
    initial_coef: Any = None
    initial_covariance: Any = np.inf
    fit_intercept: Any = True

    def _warn(self):
        if self._zero:
            warnings.warn(
                "the estimate is zero: a perturbation within the bound explains all of the data; give a smaller bound or "
                "more samples",
                ZeroEstimateWarning,
                stacklevel=4,
            )

    def _start(self, columns, outputs):
        corner, _ = super()._start(columns, outputs)
        self._bounds = None
        if not (isinstance(self.initial_covariance, float) and self.initial_covariance == np.inf):
            root = np.full(
                columns, 1 / np.sqrt(require_number("initial_covariance", self.initial_covariance, above=0.0))
            )
            if self.fit_intercept:
                root[-1] = 0.0  # nothing is known of it
            corner[:columns, :columns] = np.diag(root)
            corner[:columns, columns:] = root[:, None] * self._initial(self.initial_coef, columns, outputs).T
        elif self.initial_coef is not None:
            raise InputError(
                "initial_covariance is inf, so that initial_coef does not count; give a finite one"
            )
        return corner, 0.0

    def _advance(self, state, rows, outputs, weights):
        # a row of a stream takes one kernel, which begins where the one before it ended
        columns, bounds = rows.shape[1], self._bounds
        same = bounds is not None and bounds.bound is self.bound and bounds.columns == columns
        if not (same and isinstance(self.bound, float | int)):
            bounds = self._bounds = _Bounds(self.bound, self._per_column("bound", columns))
        alphas = state[2] if len(state) > 2 else np.zeros(outputs.shape[1])
        if len(rows) == 1 and bounds.largest > 0:
            corner, mass, alphas = state[0].copy(), state[1], alphas.copy()
            forgetting = self.forgetting
            if not (isinstance(forgetting, float) and 0.0 < forgetting <= 1.0):
                forgetting = require_number("forgetting", forgetting, above=0.0, at_most=1.0)
            mass, coef = forgetting * mass + float(weights[0]), np.empty((outputs.shape[1], columns))
            row, bound = np.concatenate([rows[0], outputs[0]]), bounds.largest * self._growth(mass)
            run = kernel_for(advance_min_max, 1, 60 * columns**3)
            if run(
                corner,
                row,
                math.sqrt(forgetting),
                bounds.order,
                bounds.known,
                bounds.shares,
                bound,
                coef,
                alphas,
            ):
                self._zero = math.isinf(max(alphas.tolist()))
                return (corner, mass, alphas), coef
            return (corner, mass, alphas), self._solve(corner, columns, outputs.shape[1], mass)
        state, coef = super()._advance(state, rows, outputs, weights)
        return (*state, alphas), coef

    def _growth(self, mass) -> float:
        # of the bound over that of one sample, or of all
        if require_choice("bound_on", self.bound_on, ("record", "sample")) == "sample":
            return math.sqrt(mass)
        return 1.0

    def _solve(self, corner, columns, outputs, mass):
        largest, shares = self._bounds.largest * self._growth(mass), self._bounds.shares
        self._zero = False  # whether the bound explains all of the data away
        known, targets = self._bounds.values == 0, corner.T[columns:]

        def estimate(matrix, target):
            estimate, zero = solve_plain(matrix / shares, target, largest)
            self._zero |= zero
            return estimate / shares

        return np.array([_solve_around_known(corner[:, :columns], each, known, estimate) for each in targets])


class _PenalisedRegressor(TriangleRegressor):
    # One penalty on all coefficients, which unlike features feel unlike.
    def _warn(self):
        if self.scale_ratio_ > UNLIKE and self._shrunk > 0.01:
            self._warn_unlike(f"is shrunk by {self._shrunk:.0%}")

    def _solve(self, corner, columns, outputs, mass):
        self.scale_ratio_ = 1.0
        self._shrunk = 0.0  # share that the penalty takes of the coefficient of the smallest feature
        return super()._solve(corner, columns, outputs, mass)

    def _note_penalty(self, matrix, penalty) -> None:
        squares = np.einsum("ij,ij->j", matrix, matrix)
        self._note_scales(squares)
        smallest = np.min(squares[squares > 0], initial=np.inf)
        self._shrunk = max(self._shrunk, float(penalty / (smallest + penalty)))


@dataclass(eq=False, repr=False)
class RidgeRegressor(_PenalisedRegressor):
    """Ridge regression whose penalty follows from the data: the smallest |y - X coef|^2 + penalty |coef|^2.

    Scale the features similarly: one penalty shrinks all coefficients, but not the intercept.

    Attributes
    ----------
    penalty : str or float
        ``evidence``: the most probable one, for coefficients and noise of unknown variances; ``cross-validation``: the
        smallest generalised cross-validation; or a number of zero or above, in squared units of the features.
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    scale_ratio_ : float
        Largest over smallest root mean square of the features, with an intercept of their deviations from the mean.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; raised by `fit` and `partial_fit`.

    Warns
    -----
    UnlikeScalesWarning
        From `fit`, when features are more than 100 times unlike in size and the penalty takes more than 1 % of the
        coefficient of the smallest.

    Notes
    -----
    That of scikit-learn by evidence, `BayesianRidge`, gives 0 for features of 1e-6: its priors have units.

    References
    ----------
    MacKay, Bayesian interpolation (1992); Golub, Heath and Wahba, Generalized cross-validation (1979).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> X = rng.standard_normal((30, 5))
    >>> y = 0.1 * X[:, 0] + rng.standard_normal(30)  # hardly more than noise
    >>> least, ridge = (estimation.RidgeRegressor(each).fit(X, y) for each in (0.0, "evidence"))
    >>> bool(np.linalg.norm(ridge.coef_) < np.linalg.norm(least.coef_))
    True
    """

    penalty: Any = "evidence"
    forgetting: Any = 1.0
    fit_intercept: Any = True

    def _estimate(self, matrix, target, mass):
        if isinstance(self.penalty, str):
            choose = PENALTIES[require_choice("penalty", self.penalty, PENALTIES)]
            penalty = choose(matrix, target, float(max(mass, matrix.shape[1] + 1.0)))
        else:
            penalty = require_number("penalty", self.penalty, at_least=0.0)
        self._note_penalty(matrix, penalty)
        # without a penalty each feature may have a unit of its own
        units = np.ones(matrix.shape[1]) if penalty else _column_sizes(matrix)
        left, sizes, right = np.linalg.svd(matrix / units, full_matrices=False)
        used = sizes > len(matrix) * ROUNDING * np.max(sizes, initial=0.0)
        shrunk = np.divide(sizes, sizes**2 + penalty, out=np.zeros_like(sizes), where=used)
        return right.T @ (shrunk * (left.T @ target)) / units


class _NoisyFeatures(TriangleRegressor):
    noise: Any

    def _known(self, columns):
        self._noises = self._per_column("noise", columns)
        return self._noises == 0


@dataclass(eq=False, repr=False)
class BiasCompensatedRegressor(_PenalisedRegressor, _NoisyFeatures):
    """Least squares for features that hold white noise of known size, whose share of X'X is taken out.

    Attributes
    ----------
    noise : float or array_like, shape (features,)
        Standard deviation of the noise of each feature, in its unit, or one for all; 0 for one that is known exactly.
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    penalty : str or float
        On |coef|^2, as of `RidgeRegressor`: few samples make the estimate without one large. ``cross-validation``: that
        with the smallest estimated error of predictions from features without noise; or a number of zero or above.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate: of the relation between y and the features without noise.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    scale_ratio_ : float
        Of the features that a penalty shrinks, as of `RidgeRegressor`; 1 without a penalty.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; raised by `fit` and `partial_fit`.

    Warns
    -----
    UnlikeScalesWarning
        As of `RidgeRegressor`.

    References
    ----------
    Söderström, Errors-in-variables methods in system identification (2007); Mallows, Some comments on Cp (1973), of the
    penalty.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> X = rng.standard_normal((10000, 1))
    >>> measured = X + 0.5 * rng.standard_normal(X.shape)
    >>> estimation.BiasCompensatedRegressor(0.5).fit(measured, 2 * X[:, 0]).coef_.round(1)  # 1.6 by least squares
    array([2.])
    """

    noise: Any = 0.0
    forgetting: Any = 1.0
    fit_intercept: Any = True
    penalty: Any = 0.0

    def _known(self, columns):
        known = super()._known(columns)
        if isinstance(self.penalty, str):
            require_choice("penalty", self.penalty, ("cross-validation",))
            self._penalty = None
        else:
            self._penalty = float(require_number("penalty", self.penalty, at_least=0.0))
        # a penalty shrinks what is known exactly, too
        return known if self._penalty == 0 else TriangleRegressor._known(self, columns)

    def _estimate(self, matrix, target, mass):
        if self._penalty != 0:
            variances = self._noises[: matrix.shape[1]] ** 2
            coef, penalty = compensated_ridge(
                matrix, target, variances, float(max(mass, matrix.shape[1] + 1.0)), self._penalty
            )
            self._note_penalty(matrix, penalty)
            return coef
        noises = self._noises[self._noises > 0]
        whitened = matrix / noises
        products, correlation = whitened.T @ whitened, whitened.T @ target
        # where noise is all that a direction holds, a standard error of what it holds is left
        least = max(np.linalg.eigvalsh(products)[0], 0.0) * (1 - 1 / np.sqrt(max(mass, 1.0)))
        products -= min(mass, least) * np.eye(len(noises))
        return np.linalg.lstsq(products, correlation)[0] / noises


@dataclass(eq=False, repr=False)
class TotalLeastSquares(_NoisyFeatures):
    """Scaled total least squares: features and outputs hold noise, and the smallest correction makes them fit.

    Attributes
    ----------
    noise : float or array_like, shape (features,)
        Standard deviation of the noise of each feature, in its unit, or one for all; 0 for one that is known exactly.
    output_noise : float
        Standard deviation of the noise of y. Only the ratio to `noise` matters.
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
        When there is no solution, a setting is out of its range, or a table does not fit; raised by `fit` and `partial_fit`.

    References
    ----------
    Golub and Van Loan, Matrix Computations, section 6.3.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> X = rng.standard_normal((10000, 1))
    >>> measured, y = X + 0.5 * rng.standard_normal(X.shape), 2 * X[:, 0] + 0.5 * rng.standard_normal(10000)
    >>> estimation.TotalLeastSquares().fit(measured, y).coef_.round(1)  # 1.6 by least squares
    array([2.])
    """

    noise: Any = 1.0
    output_noise: Any = 1.0
    forgetting: Any = 1.0
    fit_intercept: Any = True

    def _estimate(self, matrix, target, mass):
        noises = self._noises[self._noises > 0] / require_number("output_noise", self.output_noise, above=0.0)
        whitened = matrix / noises
        least = np.linalg.lstsq(whitened, target)[0]
        if np.linalg.norm(target - whitened @ least) <= len(whitened) * ROUNDING * np.linalg.norm(target):
            return least / noises  # nothing to correct
        return total_least_squares(whitened, target) / noises


@dataclass(eq=False, repr=False)
class InstrumentalRegressor(TriangleRegressor):
    """Two-stage least squares: the features are replaced by their projection on the instruments.

    Instruments are correlated with the features but not with their noise: a second sensor of the same, older samples, or the input
    that drives what is measured. There are at least as many as features.

    Attributes
    ----------
    forgetting : float
        lambda in (0, 1]; 1 weights all samples equally.
    fit_intercept : bool
        Whether to fit a constant, too; if not, y is 0 where X is 0.
    coef_ : ndarray, shape (features,) or (outputs, features)
        The estimate: of the relation between y and the features without noise.
    intercept_ : float or ndarray, shape (outputs,)
        Output where the features are 0; 0 without `fit_intercept`.
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When there are fewer instruments than features, a setting is out of its range, or a table does not fit; raised by `fit`
        and `partial_fit`.

    References
    ----------
    Söderström and Stoica, Instrumental variable methods for system identification (1983).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> X = rng.standard_normal((10000, 1))
    >>> one, other = (X + 0.5 * rng.standard_normal(X.shape) for _ in range(2))
    >>> found = estimation.InstrumentalRegressor().fit(one, 2 * X[:, 0], instruments=other)
    >>> found.coef_.round(1)  # 1.6 by least squares
    array([2.])
    """

    forgetting: Any = 1.0
    fit_intercept: Any = True

    def fit(self, X, y, sample_weight=None, instruments=None):
        """Learn from samples in their order, from the start.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            Weight of each squared error, beside that of forgetting; 0 for a lost sample.
        instruments : array_like, shape (samples, instruments), optional
            By default the features themselves: then it is least squares.

        Returns
        -------
        InstrumentalRegressor
            The estimator itself, with `coef_` and `intercept_`.

        Raises
        ------
        InputError
            When a setting is out of its range, a table does not fit, or no sample is without NaN.

        Examples
        --------
        >>> found = estimation.InstrumentalRegressor(fit_intercept=False)
        >>> found = found.fit([[1.0], [2.0]], [2.0, 4.0], instruments=[[1.0], [1.0]])
        >>> found.coef_.round(3)
        array([2.])
        """
        self._given = instruments
        return self._learn(X, y, sample_weight, anew=True)

    def partial_fit(self, X, y, sample_weight=None, instruments=None):
        """Learn from the samples that follow those of the calls before, as `fit` does of all at once.

        Parameters
        ----------
        X : array_like, shape (samples, features)
        y : array_like, shape (samples,) or (samples, outputs)
        sample_weight : array_like, shape (samples,), optional
            Weight of each squared error, beside that of forgetting; 0 for a lost sample.
        instruments : array_like, shape (samples, instruments), optional
            As many as in the calls before.

        Returns
        -------
        InstrumentalRegressor
            The estimator itself, with `coef_` and `intercept_`.

        Raises
        ------
        InputError
            As for `fit`, and when the numbers of features, instruments or outputs differ from those before.

        Examples
        --------
        >>> found = estimation.InstrumentalRegressor(fit_intercept=False)
        >>> for _ in range(2):
        ...     found = found.partial_fit([[1.0], [2.0]], [2.0, 4.0], instruments=[[1.0], [1.0]])
        >>> found.coef_.round(3)
        array([2.])
        """
        self._given = instruments
        return self._learn(X, y, sample_weight, anew=not hasattr(self, "coef_"), whole=False)

    def _take(self, X, y, weights, anew):
        given = X if self._given is None else self._given
        given = require_array("instruments", given, shape=(len(X), None), missing=True)
        lost = np.isnan(given).any(axis=1)
        if lost.all():
            raise InputError("instruments hold no sample without NaN; give at least one")
        weights, given = np.where(lost, 0.0, weights), np.where(lost[:, None], 0.0, given)
        if given.shape[1] < X.shape[1]:
            raise InputError(
                f"instruments has {pluralise(given.shape[1], 'column')}; give at least one for each of "
                f"{pluralise(X.shape[1], 'feature')}"
            )
        if not anew and given.shape[1] != self._instruments.shape[1]:
            raise InputError(
                "instruments has another number of columns than in the calls before; give as many"
            )
        self._instruments = given
        super()._take(X, y, weights, anew)
        self._given = None

    def _solve(self, corner, columns, outputs, mass):
        given = self._instruments.shape[1]
        known = np.append(np.zeros(given, bool), self._known(columns))

        def estimate(matrix, target):
            units = _column_sizes(matrix)
            scaled = matrix / units
            own = instrumental_variables(scaled[:, given:], target, scaled[:, :given])
            return np.append(np.zeros(given), own / units[given:])

        matrix, targets = corner[:, : given + columns], corner.T[given + columns :]
        return np.array([_solve_around_known(matrix, each, known, estimate)[given:] for each in targets])
