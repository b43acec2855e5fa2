"""Least mean squares with scikit-learn's interface: the least time a row, and no matrix."""

import warnings
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from stillwork.base.checks import require_number
from stillwork.base.kernels import kernel
from stillwork.estimation.regression import ONE, UnlikeScalesWarning, UnweightedRegressor

UNLIKE = 3.0  # ratio of sizes, from which a short record is said to be too short for the smallest feature
ALIKE = 0.05  # power of the weakest combination over the mean, below which features are said to be alike
SHARE = 1e-5  # regularisation over the largest |x|^2, where it follows from the data
LEAST_GAIN = 0.01  # of the mean: it follows a drift in a hundred samples
MEAN, SPREAD, SQUARES, _, BESIDE = range(5)  # rows below the coefficients, and how many


@dataclass(eq=False)
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
    n_features_in_ : int
        Number of features.

    Raises
    ------
    InputError
        When a setting is out of its range, or a table does not fit; raised by `fit` and `partial_fit`.

    Warns
    -----
    UnlikeScalesWarning
        From `fit`, when features differ so much in size, or had such jumps or drifts, or are so nearly alike, that the
        samples were too few to learn each coefficient.

    Notes
    -----
    The kernel of a row is compiled when the estimator is made. Without an intercept, a sample without excitation changes
    nothing. With one, features are counted from their mean, of all samples or of the last hundred, so that their offsets
    do not matter, and the output at this mean is learned as the coefficient of a constant feature as large as the others
    deviate.

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

    def __post_init__(self):
        _compile()

    def _warn(self):
        ratio, share = self._scales()
        share *= float(self.step_size)  # so much of the smallest feature is learned in a sample
        samples = float(self._state[-1, 1])
        if ratio > UNLIKE and samples * share < 1:
            self._warn_unlike(ratio, f"is not learned in fewer than {1 / share:.2g} samples")
        elif self._alike < ALIKE and samples * self._alike * float(self.step_size) < self.n_features_in_:
            warnings.warn(
                "features are alike but for little, which this many samples do not tell apart: together they have the "
                "right coefficient, each by itself may not; leave one out, or use RecursiveLeastSquares",
                UnlikeScalesWarning,
                stacklevel=4,
            )

    def _scales(self) -> tuple[float, float]:
        # the ratio of the sizes, and the smallest square over that of a row
        beside, features = self._state[-BESIDE:], self.n_features_in_
        mean_squares = beside[SQUARES, :features] / max(beside[-1, 1], 1.0)
        moving = beside[SPREAD, :features] if self._has_intercept else mean_squares
        least, constant = np.min(moving[moving > 0], initial=np.inf), beside[SPREAD, :features].mean()
        ratio = float(max(np.sqrt(mean_squares.max() / least), 1.0))
        return ratio, float(least / (mean_squares.sum() + constant or 1.0))

    def _update(self, X, outputs, weights, anew):
        step = float(require_number("step_size", self.step_size, above=0.0, below=2.0))
        relative, regularisation = self.regularisation is None, SHARE
        if not relative:
            regularisation = float(require_number("regularisation", self.regularisation, above=0.0))
        features, count = X.shape[1], outputs.shape[1]
        if anew:
            self._alike = _least_share(X)
            self._state = np.zeros((count + BESIDE, features + 1))
            self._state[:count, :features] = self._initial(self.initial_coef, features, count)
        state, table = self._state.copy(), np.hstack([X, outputs])
        weights = weights if weights is ONE else np.array(weights, float)
        _learn(state, table, weights, step, regularisation, relative, self._has_intercept)
        self._state, coef = state, state[:count, :features].copy()
        return coef, state[:count, features] - coef @ state[count + MEAN, :features]


def _least_share(X: np.ndarray) -> float:
    """Of the features that move, in units of their deviations: the power of the weakest combination over the mean."""
    moves = X - X.mean(axis=0)
    moves = moves[:, sizes > 0] / sizes[sizes > 0] if (sizes := moves.std(axis=0)).any() else np.ones((1, 1))
    return float(max(np.linalg.eigvalsh(moves.T @ moves / len(moves))[0], 0.0))


@kernel
def _learn(state, table, weights, step, regularisation, relative, centred):
    """Rows [x, y] more, in place. Those of `state` are the coefficients of each output with its value at the mean of the
    features, this mean, their variance, the sums of their squares, and the largest |x|^2 with the number of samples.

    A `relative` regularisation counts in the largest |x|^2.
    """
    outputs, features = len(state) - BESIDE, state.shape[1] - 1
    mean, spread, squares = state[outputs + MEAN], state[outputs + SPREAD], state[outputs + SQUARES]
    row, last = np.empty(features), state[outputs + BESIDE - 1]
    for t in range(len(table)):
        if weights[t] == 0.0:
            continue
        last[1] += 1.0
        gain, norm, constant = max(1.0 / last[1], LEAST_GAIN), 0.0, 0.0
        for j in range(features):
            row[j] = table[t, j]
            if centred:
                # the mean moves, and the value of each output at it
                shift = gain * (row[j] - mean[j])
                spread[j] = (1.0 - gain) * (spread[j] + shift * (row[j] - mean[j]))
                mean[j] += shift
                row[j] -= mean[j]
                constant += spread[j] / features
                for o in range(outputs):
                    state[o, features] += state[o, j] * shift
            squares[j] += row[j] * row[j]
            norm += row[j] * row[j]
        norm += constant
        last[0] = max(last[0], norm)
        rate = regularisation * (last[0] if relative else 1.0) + norm
        rate = step / rate if rate > 0.0 else 0.0
        for o in range(outputs):
            error = table[t, features + o] - state[o, features]
            for j in range(features):
                error -= state[o, j] * row[j]
            for j in range(features):
                state[o, j] += rate * error * row[j]
            if centred:
                # at rest the value is all there is to learn, and the first sample has it
                share = rate * constant if norm > 0.0 else step
                state[o, features] += error * (1.0 if last[1] == 1.0 else share)


@cache
def _compile() -> None:
    _learn(np.zeros((BESIDE + 1, 2)), np.zeros((1, 2)), ONE, 0.1, 1.0, True, True)
