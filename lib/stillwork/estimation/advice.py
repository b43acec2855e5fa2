"""Which estimator of a linear relation to use, by the held-out errors of all estimators on the given data."""

import warnings
from copy import copy
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import stats
from sklearn.base import clone
from sklearn.dummy import DummyRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from stillwork.base.bounds import at_least
from stillwork.base.checks import InputError, pluralise, require_array
from stillwork.base.validation import by_value, checked
from stillwork.estimation.linear_fits import admitted_noise
from stillwork.estimation.min_max import ZeroEstimateWarning
from stillwork.estimation.regression import RecursiveLeastSquares, UnlikeScalesWarning
from stillwork.estimation.robust_regression import HinfinityRegressor, HuberRegressor
from stillwork.estimation.triangle_regression import (
    BiasCompensatedRegressor,
    InstrumentalRegressor,
    MinMaxRegressor,
    RidgeRegressor,
    TotalLeastSquares,
)

IGNORE = "ignoring the features"
SAFE, SAFE_OF_NOISE = "ridge by evidence", "bias compensation"
# The noise of features is not given to these.
UNAWARE = (IGNORE, SAFE, "ridge by cross-validation", "least squares", "Huber", "H-infinity")
# Standard errors by which another one must be better than the safe one, and that one than nothing; chosen on 500 problems
# that are not among those of benchmarks/advice.py.
SURE, SOME = 0.5, 1.0
STRONG = 10.0  # F of each feature's regression on the instruments, from which these are used (Staiger and Stock, 1997)
REPAIR = "leave such samples out: ok = np.isfinite(np.column_stack([X, y])).all(axis=1), then X[ok], y[ok]; instruments alike"
OUTLIER = 4.0  # robust deviations beyond which an output is not scored
# On what records the advice may be relied upon; chosen on 1400 problems of the first four generators of benchmarks/advice.py
SAMPLES_EACH = 15  # per coefficient
TENTH = 0.4  # share of the square of a combination of the features in a tenth of the record
EQUAL_PARTS = 0.6  # of the parts: as many equal ones would make up the errors
RELIABLE = 2.0  # mean square of any direction of the features over that of its noise
SHARES = (0.0, 0.1, 0.3, 0.5)  # noise over what a feature holds, tried for where the advice turns


@by_value
@dataclass(frozen=True)
class RankedEstimator:
    """One estimator of an `Advice`."""

    name: str
    estimator: Any  # fitted to all samples, a pipeline that scales the features first
    coef: Float64[np.ndarray, " features"]  # of y per unit of each feature
    error: float  # held-out root mean square over that of ignoring the features
    over_first: tuple[float, float]  # 95 % interval of its error over that of the first, paired by folds


@by_value
@dataclass(frozen=True)
class Advice:
    """Estimators in the order of their held-out errors, with assumptions and reasons not to rely on the order."""

    ranking: tuple[RankedEstimator, ...]
    assumed: tuple[str, ...]
    turns: dict[float, str]  # noise of the features, over what they hold: who would be first if this were so
    warnings: tuple[str, ...]  # why this record is not one on which the advice was found to hold; none: it is

    @property
    def best(self) -> Any:
        """The first one, fitted to all samples."""
        return self.ranking[0].estimator

    def __str__(self) -> str:
        rows = [
            f"{each.name:36s} {each.error:8.3f}   {each.over_first[0]:.3f} to {each.over_first[1]:.3f}"
            for each in self.ranking
        ]
        turns = [f"With noise of {share:g} of each feature: {name}." for share, name in self.turns.items()]
        warned = [f"Do not rely on this ranking: {warning}" for warning in self.warnings]
        return "\n".join([f"{'':36s}    error   over the first", *rows, *self.assumed, *turns, *warned])


@checked(infinite=True, missing=True)
def advise(
    X: ArrayLike,
    y: ArrayLike,
    noise: ArrayLike | None = None,
    instruments: ArrayLike | None = None,
    *,
    fit_intercept: bool = True,
    folds: Annotated[int, at_least(3)] = 10,
) -> Advice:
    """Rank the estimators of y = coef x + intercept by their errors in cross-validation.

    Ridge by evidence, and where the noise is known bias compensation with a penalty, is what to take without a reason:
    another one must be better by half a standard error to stand before it, and the first one better than ignoring the
    features by one; with `noise` also if the true noise were half of it, since it is seldom known well. Where the data
    hold less noise than is given (their smallest mean square along a relation, chi-square at 1 %), what they hold is
    taken, and `assumed` reports it.

    The criterion depends on what is known. With nothing but X and y it is the prediction of y from features as noisy as
    these. With `noise` it is that from the features without noise, as far as its mean square allows; with `instruments`
    that from what they explain of the features. Instruments that hardly explain a feature (F below 10) are left aside.

    Parameters
    ----------
    X : array_like, shape (samples, features)
        In order of time.
    y : array_like, shape (samples,)
    noise : array_like, shape () or (features,), optional
        Standard deviation of the white noise of each feature, or one for all, in its unit. If unsure, use the smaller value.
    instruments : array_like, shape (samples, instruments), optional
        Signals correlated with the features but not with their noise: a second sensor, older inputs.
    fit_intercept : bool
        Whether y has an offset.
    folds : int
        Consecutive parts, at least 3; fewer if there are fewer than twice as many samples.

    Returns
    -------
    Advice

    Raises
    ------
    InputError
        When the tables do not fit together, hold NaN, or fewer than six samples.

    Notes
    -----
    `Advice.warnings` lists what makes any choice on this record unreliable: fewer than 15 samples a coefficient, 40 % of a
    combination of the features in a tenth of the record, held-out errors of fewer than six equal parts of ten, noise as
    large as what a combination of the features holds, instruments that miss one, a noise that the data contradict.
    `benchmarks/advice.py` on new seeds: of 513 records of five generators without a warning the advised estimator is within
    10 % of the best in 98 %, and one is more than 5 % worse than ignoring the features (1.35 times). Of 987 with a
    warning it is so in 81 %, at worst 41 times; an oracle that knew the truth and the law of the noise, but not the noise
    itself, would be within 10 % in 89 and 92 % of two kinds of records.

    References
    ----------
    Nadeau and Bengio, Inference for the generalization error (2003), of the intervals; Stefanski and Carroll, Conditional
    scores and optimal scores for generalized linear measurement-error models (1987), of the score with noise; Staiger and
    Stock, Instrumental variables regression with weak instruments (1997), of the limit on F; Cragg and Donald, Testing
    identifiability and specification in instrumental variable models (1993), of the F that is warned of; Anderson and Rubin, Estimation
    of the parameters of a single equation (1949), of the test of the noise.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> X = rng.standard_normal((200, 3))
    >>> y = X @ [1.0, -2.0, 3.0] + rng.standard_normal(200)
    >>> y[::10] += 100.0  # a sensor that drops out
    >>> advice = estimation.advise(X, y)
    >>> advice.ranking[0].name, advice.ranking[0].coef.round(0)
    ('Huber', array([ 1., -2.,  3.]))
    """
    X = require_array("X", X, shape=(None, None), advice=REPAIR)
    samples, features = X.shape
    y = require_array("y", y, shape=(samples,), advice=REPAIR)
    if samples < 6 or not features:
        raise InputError(f"X has shape {X.shape}; give at least six samples and one feature")
    folds = min(folds, samples // 2)
    given = None
    if noise is not None:
        given = require_array("noise", noise)
        if given.shape not in ((), (features,)) or np.any(given < 0):
            raise InputError(
                f"noise is {given}; give a number, or one for each of {features} features, zero or above"
            )
        given = np.resize(given, features)
    if instruments is not None:
        instruments = require_array("instruments", instruments, shape=(samples, None), advice=REPAIR)
        if instruments.shape[1] < features:
            raise InputError(
                f"instruments has {pluralise(instruments.shape[1], 'column')}; give at least one a feature"
            )
    admitted = 1.0
    if given is not None:
        constant = np.ones((samples, int(fit_intercept)))
        admitted = admitted_noise(np.hstack([X, constant]), y, np.append(given, np.zeros(int(fit_intercept))))
        given = admitted * given
    study = _Study(X, y, given, instruments, fit_intercept, folds)
    ranking, left_out = study.ranking()
    assumed = [
        study.purpose(),
        f"Samples follow one another in time; each of {pluralise(len(study.parts), 'part')} held out once.",
    ]
    if study.outliers:
        assumed.append(
            f"{pluralise(study.outliers, 'output')} beyond {OUTLIER:g} robust deviations not scored."
        )
    if study.strength < STRONG:
        assumed.append(
            f"Instruments left aside: of one feature they explain no more than chance may (F = {study.strength:.1f})."
        )
    if admitted < 1:
        assumed.append(f"The data hold less noise than was given: {admitted:.2g} of it is taken.")
    assumed += left_out
    turns: dict[float, str] = {}
    if instruments is None:
        size = X.std(axis=0)
        for share in SHARES:
            name = study.with_noise(share * size).order(least=-np.inf)[0][0]
            if name != ranking[0].name and name not in turns.values():
                turns[share] = name
    warned = study.warnings(ranking[0].name)
    if study.strength < STRONG:
        warned.append("the given instruments are too weak to be used; give other instruments.")
    if admitted < 1:
        warned.append("the data hold less noise than was given; measure the noise again.")
    return Advice(tuple(ranking), tuple(assumed), turns, tuple(warned))


class _Study:
    def __init__(self, X, y, noise, instruments, fit_intercept, folds):
        # features in units of their own
        self.raw, self.units = X, np.where(np.ptp(X, axis=0) > 0, X.std(axis=0), 1.0)
        self.X, self.y, self.instruments = X / self.units, y, instruments
        self._state_noise(noise)
        self.strength = np.inf if instruments is None else _strength(self.X, instruments)
        if self.strength < STRONG:
            self.instruments = None
        self.fit_intercept = fit_intercept
        left = y - HuberRegressor(fit_intercept=fit_intercept).fit(self.X, y).predict(self.X)
        scale = np.median(np.abs(left)) / 0.6745
        self.scored = np.abs(left) <= OUTLIER * scale if scale else np.ones(len(y), bool)
        self.outliers = int(np.sum(~self.scored))
        self.parts = np.array_split(np.arange(len(y)), folds)
        # of each part's mean square, so that the mean over the parts is that over the samples
        counts = np.array([self.scored[part].sum() for part in self.parts])
        self.weights = counts / counts.mean()
        self.held_out: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def with_noise(self, noise, keep: bool = False) -> "_Study":
        """The same record with another noise; what does not depend on it, or all to `keep`, is not fitted again."""
        other = copy(self)
        other._state_noise(noise)
        other.held_out = {name: found for name, found in self.held_out.items() if keep or name in UNAWARE}
        return other

    def _state_noise(self, noise) -> None:
        self.noise = None if noise is None else noise / self.units
        self.safe = SAFE_OF_NOISE if self.noise is not None and self.noise.any() else SAFE

    def purpose(self) -> str:
        if self.instruments is not None:
            return "Judged by the prediction of y from what the instruments explain of the features."
        if self.noise is not None:
            return "Judged by the prediction of y from features without their noise, which is white and of the given size."
        return "Judged by the prediction of y from features as they are measured: the same noise on new ones."

    def candidates(self) -> dict[str, Any]:
        how = {"fit_intercept": self.fit_intercept}

        found = {
            IGNORE: DummyRegressor()
            if self.fit_intercept
            else DummyRegressor(strategy="constant", constant=0.0),
            SAFE: RidgeRegressor("evidence", **how),
            "ridge by cross-validation": RidgeRegressor("cross-validation", **how),
            "least squares": RecursiveLeastSquares(**how),
            "Huber": HuberRegressor(**how),
            "H-infinity": HinfinityRegressor(**how),
        }
        if self.noise is not None and self.noise.any():
            found |= {
                "min-max": MinMaxRegressor(self.noise, "sample", **how),
                SAFE_OF_NOISE: BiasCompensatedRegressor(self.noise, penalty="cross-validation", **how),
                "total least squares": TotalLeastSquares(self.noise, self.output_noise(), **how),
            }
        if self.instruments is not None:
            found["instruments"] = InstrumentalRegressor(**how)
        return found

    def output_noise(self) -> float:
        # of the residuals of least squares what is not the features' noise
        least = RidgeRegressor(0.0, fit_intercept=self.fit_intercept).fit(self.X, self.y)
        left = np.mean((self.y - least.predict(self.X))[self.scored] ** 2)
        share = np.sum((self.noise * least.coef_) ** 2)
        return float(np.sqrt(max(left - share, 0.01 * left))) or 1.0

    def losses(self, name) -> np.ndarray:
        if name not in self.held_out:
            estimator = self.candidates()[name]
            parts = [self.hold_out(clone(estimator), part) for part in self.parts]
            squares, coefs = zip(*parts, strict=True)
            self.held_out[name] = np.array(squares), np.array(coefs)
        squares, coefs = self.held_out[name]
        if self.noise is not None and self.instruments is None:
            squares = squares - np.sum((self.noise * coefs) ** 2, axis=1)
        return self.weights * squares

    def hold_out(self, estimator, part) -> tuple[float, np.ndarray]:
        """Mean square of the errors on a part that is not learned from, and the coefficients."""
        kept = np.ones(len(self.y), bool)
        kept[part] = False
        self.fit(estimator, kept)
        X = self.X[part]
        if self.instruments is not None:
            constant = np.ones((len(self.y), 1))
            given = np.hstack([self.instruments, constant])
            X = given[part] @ np.linalg.lstsq(given[kept], self.X[kept])[0]
        scored = self.scored[part]
        left = np.mean((self.y[part] - estimator.predict(X))[scored] ** 2) if scored.any() else 0.0
        return float(left), _coefficients(estimator, X.shape[1])

    def fit(self, estimator, kept):
        given = {}
        if isinstance(estimator, InstrumentalRegressor):
            given["instruments"] = self.instruments[kept]
        with warnings.catch_warnings():  # an estimate of zero is a result
            warnings.simplefilter("ignore", ZeroEstimateWarning)
            # Scales may differ in a part at rest; over the whole record they are alike.
            warnings.simplefilter("ignore", UnlikeScalesWarning)
            return estimator.fit(self.X[kept], self.y[kept], **given)

    def fitted(self, estimator) -> tuple[Any, np.ndarray]:
        whole, given = make_pipeline(StandardScaler(with_mean=False), estimator), {}
        if isinstance(estimator, InstrumentalRegressor):
            given["instrumentalregressor__instruments"] = self.instruments
        whole.fit(self.raw, self.y, **given)
        return whole, _coefficients(estimator, len(self.units)) / whole[0].scale_

    def judged(self) -> tuple[dict[str, np.ndarray], list[str]]:
        losses, left_out = {}, []
        for name in self.candidates():
            try:
                losses[name] = self.losses(name)
            except InputError as error:
                left_out.append(f"Left out: {name} ({error}).")
        return losses, left_out

    def order(self, least: float = 0.0) -> tuple[list[str], dict[str, np.ndarray], list[str]]:
        # What is advised is better than nothing also if the noise is half of what was given: it is seldom known well.
        # Noise that is only tried may be more than there is, so that any mean square may come out
        losses, left_out = self.judged()
        scores = {name: _excess(own, losses[self.safe], SURE, least) for name, own in losses.items()}
        order = sorted(scores, key=scores.__getitem__)
        studies = [self]
        if self.noise is not None and self.noise.any() and np.isfinite(least):
            studies.append(self.with_noise(0.5 * self.noise * self.units, keep=True))

        def is_sure(name) -> bool:
            return all(
                _excess(study.losses(name), study.losses(IGNORE), SOME, least) < 0 for study in studies
            )

        first = next((name for name in order if is_sure(name)), IGNORE)
        order.sort(key=lambda name: name != first)
        return order, losses, left_out

    def ranking(self) -> tuple[list[RankedEstimator], list[str]]:
        order, losses, left_out = self.order()
        candidates = self.candidates()
        unit = np.nanmean(losses[IGNORE])
        best = losses[order[0]]
        return [
            RankedEstimator(
                name,
                *self.fitted(candidates[name]),
                float(np.sqrt(max(np.nanmean(losses[name]), 0.0) / unit)) if unit > 0 else 1.0,
                _interval(losses[name] - best, np.nanmean(best)),
            )
            for name in order
        ], left_out

    def warnings(self, first) -> list[str]:
        """Why held-out parts of this record predict little about other records."""
        features = self.X
        if self.instruments is not None:
            given = np.column_stack([self.instruments, np.ones(len(self.y))])
            features = given @ np.linalg.lstsq(given, features)[0]
        directions = _directions(features - self.fit_intercept * features.mean(axis=0))
        coefficients = directions.shape[1] + int(self.fit_intercept)
        warned = []
        if len(self.y) < SAMPLES_EACH * coefficients:
            warned.append(
                f"there are {pluralise(len(self.y), 'sample')} for {pluralise(coefficients, 'coefficient')}; record at least {SAMPLES_EACH} for each."
            )
        share = (
            max(np.linalg.norm(tenth, 2) ** 2 for tenth in np.array_split(directions, 10))
            if directions.size
            else 0.0
        )
        if share > TENTH:
            warned.append(
                f"a tenth of the record holds {share:.0%} of the energy of one combination of the features; record more moves or turns."
            )
        equal = min(_equal_parts(self.losses(name)) for name in (first, IGNORE))
        if equal < EQUAL_PARTS * len(self.parts):
            warned.append(
                f"the held-out error comes mainly from a few of the {len(self.parts)} parts (as if from {equal:.0f} equal ones); give a longer record."
            )
        if self.instruments is not None and (strength := _joint_strength(self.X, self.instruments)) < STRONG:
            warned.append(
                f"the instruments hardly explain one combination of the features (F = {strength:.2g}, below {STRONG:g}); give other instruments."
            )
        if (reliable := self.reliability()) < RELIABLE:
            warned.append(
                f"one combination of the features has a signal-to-noise ratio of only {max(reliable - 1, 0):.2g} in power; measure the features with a second sensor and give it as instruments, then no noise need be given."
            )
        return warned

    def reliability(self) -> float:
        """Smallest mean square of a combination of the features over that of its noise."""
        if self.noise is None or not self.noise.any() or self.instruments is not None:
            return np.inf
        noisy = self.noise > 0
        known = np.column_stack([self.X[:, ~noisy], np.ones((len(self.y), int(self.fit_intercept)))])
        whitened = self.X[:, noisy] / self.noise[noisy]
        left = whitened - known @ np.linalg.lstsq(known, whitened)[0]
        freedom = max(len(self.y) - len(self.noise) - self.fit_intercept, 1)
        return float(np.linalg.svd(left, compute_uv=False)[-1] ** 2 / freedom)


def _equal_parts(losses) -> float:
    """How many equal losses have this ratio of their squared sum to the sum of their squares (Kish, 1965)."""
    if not losses.any():
        return float(len(losses))
    return float(max(losses.sum(), 0.0) ** 2 / np.sum(losses**2))


def _coefficients(estimator, features: int) -> np.ndarray:
    """Of a fitted linear estimator of one output; zeros of one that ignores the features."""
    return np.array(getattr(estimator, "coef_", np.zeros(features)))


def _strength(X, instruments) -> float:
    """The smallest F statistic of the regressions of each feature that moves on the instruments and a constant."""
    samples, count = instruments.shape
    if samples <= count + 1:
        return 0.0
    table = X - X.mean(axis=0)
    table = table[:, np.ptp(X, axis=0) > 0]
    given = instruments - instruments.mean(axis=0)
    units = np.abs(given).max(axis=0)
    basis = given / np.where(units > 0, units, 1.0)
    left = np.sum((table - basis @ np.linalg.lstsq(basis, table)[0]) ** 2, axis=0)
    explained = np.maximum(np.sum(table**2, axis=0) - left, 0.0)
    least = np.finfo(float).eps * np.sum(table**2, axis=0)
    return float(
        np.min(explained / count / (np.maximum(left, least) / (samples - count - 1)), initial=np.inf)
    )


def _joint_strength(X, instruments) -> float:
    """The smallest F of any combination of the features, by their smallest canonical correlation with the instruments.

    Near-collinear features may each be explained well, but not their difference (Cragg and Donald, 1993).
    """
    samples, count = instruments.shape
    table, given = _directions(X - X.mean(axis=0)), instruments - instruments.mean(axis=0)
    units = np.abs(given).max(axis=0)
    given = _directions(given / np.where(units > 0, units, 1.0))
    if not table.size or given.shape[1] < table.shape[1] or samples <= count + 1:
        return 0.0
    share = np.linalg.svd(given.T @ table, compute_uv=False)[-1] ** 2
    return float(share / count / (max(1 - share, np.finfo(float).eps) / (samples - count - 1)))


def _directions(table) -> np.ndarray:
    """Orthonormal columns that span those of a table, but for what is near rounding."""
    directions, sizes, _ = np.linalg.svd(table, full_matrices=False)
    return directions[:, sizes > 1e-6 * sizes[0]]


def _upper(differences, errors: float) -> float:
    """Mean over the folds, which overlap in what they learn from, and so many standard errors more."""
    differences = differences[np.isfinite(differences)]
    count = len(differences)
    return float(differences.mean() + errors * differences.std(ddof=1) * np.sqrt(1 / count + 1 / (count - 1)))


def _excess(own, other, errors: float, least: float) -> float:
    """Upper end of a mean square over another one; one below the `least` is no merit: noise taken out may leave it."""
    return _upper(own - other, errors) + max(least - float(np.nanmean(own)), 0.0)


def _interval(differences, mean) -> tuple[float, float]:
    # of the root mean square over the first one's
    if not mean > 0:
        return 1.0, 1.0
    width = stats.t.ppf(0.975, np.isfinite(differences).sum() - 1)
    low, high = (np.sqrt(max(1 + _upper(differences, end) / mean, 0.0)) for end in (-width, width))
    return float(low), float(high)
