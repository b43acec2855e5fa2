"""Adaptation on your own data: over a recorded run, as identification, or one sample at a time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, Int64
from numpy.typing import ArrayLike

from stillwork.base.algebra import copy_matrix, copy_vector, plus_row
from stillwork.base.bounds import Count, Matrix
from stillwork.base.checks import InputError, pluralise, require_array
from stillwork.base.kernels import kernel
from stillwork.base.validation import by_value, checked
from stillwork.estimation.adaptive import FeLms, FeRls, felms_update, ferls_step

# An error this many times the largest one without adaptation is no transient any more.
RUNAWAY = 1e6


class UnstableAdaptation(ArithmeticError):
    """The adaptation, or the loop around it, diverged: the `sample` whose update cannot be used, the `cause`, what to do."""

    def __init__(self, sample: int, cause: str, advice: str, what: str = "the adaptation"):
        super().__init__(f"{what} became unstable at sample {sample}: {cause}; {advice}")
        self.sample = sample
        self.cause = cause


@by_value
@dataclass(frozen=True)
class Adaptation:
    """What an adaptation over a record gave.

    Where `held` is not zero, some combination with this regressor is excited too weakly to be followed in the last time
    constant.
    """

    weights: Float64[np.ndarray, "actuators n"]  # W after the last sample
    covariance: Float64[np.ndarray, "n n"] | None  # P after the last sample; None for FeLMS
    held: Float64[np.ndarray, " n"] | None  # share of the last time constant in which `growth_limit` acted
    samples: Int64[np.ndarray, " kept"]  # seen when each entry of `history` was kept
    history: Float64[np.ndarray, "kept actuators n"]  # W along the way


@checked
def adapt(
    settings: FeLms | FeRls,
    regressors: Matrix,
    errors: Matrix,
    weights: ArrayLike | None = None,
    every: Count = 1000,
    commands: Matrix | None = None,
) -> Adaptation:
    """Run the updates over recorded regressors and recorded filtered errors.

    The errors are those measured while the machine ran with its own weights: this replays a
    controller's adaptation, or makes one step from a stretch with frozen weights. To fit weights to a record, whose
    errors depend on them, use `identify`.

    Parameters
    ----------
    settings : FeLms or FeRls
        The algorithm.
    regressors : array_like, shape (n, samples)
        psi_N, any number of them.
    errors : array_like, shape (actuators, samples)
        e, one row per actuator.
    weights : array_like, shape (actuators, n), optional
        Initial value; zero by default.
    every : int
        Store the weights every this many samples.
    commands : array_like, shape (actuators, samples), optional
        N[u], the feedforward commands of the run through the filter of the regressors: with a `path_delay`.

    Returns
    -------
    Adaptation
        Weights after the last sample and those stored before, FeRLS's covariance, and where its limit acted.

    Raises
    ------
    InputError
        Arrays that do not fit together, or that hold NaN.
    UnstableAdaptation
        With the sample and the cause.

    References
    ----------
    The work that extends Beijen, Heertjes, van Dijk, Hakvoort, Control Engineering Practice 72 (2018), by FeRLS,
    section 4.

    Examples
    --------
    >>> floor = np.ones((1, 10))
    >>> errors = np.array([[1.0] + 9 * [0.0]])  # gone after the first sample
    >>> estimation.adapt(estimation.FeLms(0.5), floor, errors).weights.round(3)
    array([[-0.5]])
    """
    if settings.path_delay is None:
        if commands is not None:
            raise InputError(
                "commands belong to the modified error; give settings a path_delay, or leave them out"
            )
        return _run(settings, regressors, "errors", errors, weights, every)
    if commands is None:
        raise InputError("commands is missing, which a path_delay needs; give N[u] of every sample")
    if commands.shape != errors.shape:
        raise InputError(f"commands has shape {commands.shape} but errors {errors.shape}; give as many")
    regressors, commands = (_late(each, settings.path_delay) for each in (regressors, commands))
    return _run(settings, regressors, "errors", errors - commands, weights, every)


@checked
def identify(
    settings: FeLms | FeRls,
    regressors: Matrix,
    disturbance: Matrix,
    weights: ArrayLike | None = None,
    every: Count = 1000,
) -> Adaptation:
    """Fit weights to a record: the error of each sample is e = d + W psi with the weights at that sample.

    With FeRLS and an infinite `growth_limit` this is exponentially weighted least squares, sample by sample.

    Parameters
    ----------
    settings : FeLms or FeRls
        The algorithm.
    regressors : array_like, shape (n, samples)
        psi_N.
    disturbance : array_like, shape (actuators, samples)
        d: the filtered error that the machine shows with zero weights.
    weights, every
        As in `adapt`.

    Returns
    -------
    Adaptation
        As of `adapt`.

    Raises
    ------
    InputError, UnstableAdaptation
        As in `adapt`.

    References
    ----------
    The work that extends Beijen, Heertjes, van Dijk, Hakvoort, Control Engineering Practice 72 (2018), by FeRLS,
    section 4.

    Examples
    --------
    >>> floor = np.random.default_rng(1).standard_normal((2, 5000))  # m/s^2
    >>> settings = estimation.FeRls(1e3, forgetting=0.999)
    >>> estimation.identify(settings, floor, [[-3.0, 5.0]] @ floor).weights.round(3)  # N per (m/s^2)
    array([[ 3., -5.]])
    """
    if settings.path_delay is not None:
        raise InputError("settings.path_delay: a disturbance goes through no path; leave it out")
    return _run(settings, regressors, "disturbance", disturbance, weights, every)


def _late(rows: np.ndarray, delay: int) -> np.ndarray:
    """Rows of so many samples ago, zero before the first."""
    return np.hstack([np.zeros((len(rows), delay)), rows])[:, : rows.shape[1]]


class AdaptationStepper:
    """The adaptation for use with hardware: one call per sample, compiled when it is made.

    Parameters
    ----------
    settings : FeLms or FeRls
        The algorithm.
    weights : array_like, shape (actuators, n)
        W at the start, e.g. ``np.zeros((6, 9))``; its shape is (actuators, regressors).

    Attributes
    ----------
    weights : ndarray, shape (actuators, n)
        W after the last valid sample.
    recursion : Recursion or None
        State of FeRLS after the same sample: `recursion.covariance`, `recursion.held` as in `Adaptation`.
    samples : int
        Number of samples so far.

    Raises
    ------
    InputError
        When a sample is not finite or not of the size of the first.

    References
    ----------
    The work that extends Beijen, Heertjes, van Dijk, Hakvoort, Control Engineering Practice 72 (2018), by FeRLS,
    section 4.

    Examples
    --------
    >>> stepper = estimation.AdaptationStepper(estimation.FeRls(1e3), np.zeros((1, 1)))
    >>> for floor in (1.0, -2.0, 1.5):
    ...     weights = stepper.update([floor], [(stepper.weights[0, 0] - 0.5) * floor])
    >>> weights.round(2)
    array([[0.5]])
    """

    @checked
    def __init__(self, settings: FeLms | FeRls, weights: Matrix):
        self.settings = settings
        self.weights = weights.copy()
        self.recursion = None
        if isinstance(settings, FeRls):
            self.recursion = settings.start(self.weights.shape[1])
            self.weights = self.weights.astype(settings.dtype)
        self.samples = 0
        actuators, n = self.weights.shape
        self._late = [(np.zeros(n), np.zeros(actuators))] * (
            settings.path_delay or 0
        )  # psi_N and N[u], the oldest first
        self._step(np.zeros(n), np.zeros(actuators))  # compiles what steps

    @property
    def covariance(self) -> Float64[np.ndarray, "n n"] | None:
        """P after the last valid sample; None for FeLMS."""
        return None if self.recursion is None else self.recursion.covariance

    def update(
        self, regressor: ArrayLike, error: ArrayLike, command: ArrayLike | None = None
    ) -> Float[np.ndarray, "actuators n"]:
        """Update with psi_N, shape (n,), and e, shape (actuators,), of one sample; returns a copy of the new weights.

        After an exception weights and covariance are those of the previous sample, which may be kept or faded out.

        Parameters
        ----------
        regressor : array_like, shape (n,)
            psi_N.
        error : array_like, shape (actuators,)
            e.
        command : array_like, shape (actuators,), optional
            N[u], with a `path_delay`.

        Returns
        -------
        ndarray, shape (actuators, n)
            The new weights, a copy.

        Raises
        ------
        InputError
            Wrong shape or NaN.
        UnstableAdaptation
            The update could not be used.

        Examples
        --------
        >>> stepper = estimation.AdaptationStepper(estimation.FeLms(1.0), [[0.0]])  # e = 0.5 psi: W should be -0.5
        >>> stepper.update([2.0], [1.0]).round(3)
        array([[-0.5]])
        """
        error = require_array("error", error, shape=self.weights.shape[:1])
        (regressor, sent), *late = self._queue(regressor, command)
        error = error - sent
        stopped, definite, weights, recursion = self._step(regressor, error)
        if not definite:
            raise _not_definite(self.samples)
        if stopped == 0:
            raise _runaway(self.samples, self.settings)
        self.weights, self.recursion, self._late = weights, recursion, late
        self.samples += 1
        return weights.copy()

    def _queue(self, regressor, command):
        """psi_N and N[u] of the samples kept and of now, the oldest first."""
        actuators, n = self.weights.shape
        regressor = require_array("regressor", regressor, shape=(n,))
        if (command is None) != (self.settings.path_delay is None):
            raise InputError(
                "command is N[u] of the modified error; give it with a path_delay, and only then"
            )
        sent = (
            np.zeros(actuators) if command is None else require_array("command", command, shape=(actuators,))
        )
        return [*self._late, (regressor, sent)]

    def _step(self, regressor, error):
        # whether the sample was taken in, whether P is definite, weights and recursion after it
        weights = self.weights.copy()
        recursion = None if self.recursion is None else self.recursion.copy()
        one = (each[None].astype(weights.dtype) for each in (regressor, error))
        history = np.empty((0, *weights.shape))
        rest = *one, self.settings.path_delay is not None, np.inf, history, 2, True
        done = _advance(self.settings, weights, recursion, *rest, first=self.samples)
        return *done, weights, recursion


def _run(settings, regressors, name, signals, weights, every) -> Adaptation:
    n, samples = regressors.shape
    actuators = len(signals)
    for each, rows in (("regressors", n), (name, actuators)):
        if not rows:
            raise InputError(f"{each} has no rows; give at least one, with time along the last axis")
    if signals.shape[1] != samples:
        raise InputError(
            f"{name} has {pluralise(signals.shape[1], 'sample')} but regressors has {samples}; "
            "give both with time along the last axis"
        )
    if not samples:
        raise InputError(f"regressors and {name} hold no samples; give at least one")
    start = np.zeros((actuators, n)) if weights is None else weights
    start = require_array("weights", start, shape=(actuators, n))
    history = np.empty((samples // every, actuators, n))
    fits = name == "disturbance" or settings.path_delay is not None
    ceiling = RUNAWAY * (np.abs(signals).max() + np.abs(signals + start @ regressors).max())
    dtype = settings.dtype if isinstance(settings, FeRls) else "float64"
    inputs = (
        np.ascontiguousarray(regressors.T, dtype),
        np.ascontiguousarray(signals.T, dtype),
        fits,
        ceiling,
        history,
        every,
    )
    # Overflow persists, so a look at the end suffices; only a run that overflowed is repeated to find the sample.
    covariance, held = None, None
    for watch in (False, True):
        weights = start.astype(dtype)
        recursion = settings.start(n) if isinstance(settings, FeRls) else None
        stopped, definite = _advance(settings, weights, recursion, *inputs, watch)
        if not definite:
            raise _not_definite(stopped)
        if recursion is not None:
            covariance, held = recursion.covariance, recursion.held
        if stopped < samples:
            raise _runaway(stopped, settings)
        if np.all(np.isfinite(weights)) and (covariance is None or np.all(np.isfinite(covariance))):
            break
    return Adaptation(
        weights.astype(float), covariance, held, every * np.arange(1, len(history) + 1), history
    )


def _advance(settings, weights, recursion, *inputs, first: int = 0) -> tuple[int, bool]:
    """Run an algorithm over some samples, `weights` and `recursion` in place; see `run_ferls`."""
    if recursion is not None:
        return run_ferls(weights, recursion, *recursion[-2:], *inputs, first)
    rates = settings.step_size, settings.regularisation, settings.trace_copies(len(weights))
    return run_felms(weights, *rates, *inputs), True


def _not_definite(sample: int) -> UnstableAdaptation:
    return UnstableAdaptation(
        sample,
        "the covariance is no longer positive definite",
        "start with a smaller initial_covariance, a finite growth_limit or regressors of similar size",
    )


def _runaway(sample: int, settings) -> UnstableAdaptation:
    small = "step_size" if isinstance(settings, FeLms) else "initial_covariance"
    return UnstableAdaptation(
        sample, "the error and the weights grow without bound", f"give a smaller {small} or check the filters"
    )


@kernel
def _error_of(weights, regressor, disturbance, error):
    """Fill e = d + W psi; returns its largest magnitude, NaN if any is."""
    largest = 0.0
    for a in range(len(error)):
        error[a] = plus_row(disturbance[a], weights, a, regressor)
        if not abs(error[a]) <= largest:
            largest = abs(error[a])
    return largest


@kernel
def _all_finite(matrix):
    """Without leaving early, so that the compiler compares several elements at once."""
    bad = 0
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            bad += not abs(matrix[i, j]) < np.inf
    return bad == 0


@kernel
def run_ferls(
    weights, recursion, inner, other, regressors, signals, fits, ceiling, history, every, watch, first
):
    """FeRLS over samples of which the first has the number `first`, in place.

    Returns how many are done, and whether P was positive definite up to there. The `signals` are e, or, where it
    `fits`, d of e = d + W psi, which ends the run above the `ceiling`: of the modified error e less N[u]. To `watch` is to
    check at each sample whether all is finite.
    """
    matrix, form, forgetting, levels, allowance, gain, _, _ = recursion
    error = np.empty(signals.shape[1], signals.dtype)
    due = every - 1
    for k in range(len(regressors)):
        if not fits:
            copy_vector(signals[k], error)  # of one of two arrays numba would count the references
        elif not _error_of(weights, regressors[k], signals[k], error) <= ceiling:
            return k, True
        leverage = ferls_step(
            weights,
            matrix,
            form,
            forgetting,
            levels,
            allowance,
            gain,
            inner,
            other,
            regressors[k],
            error,
            first + k,
        )
        if not leverage >= forgetting:
            return k, False
        if not leverage < np.inf or (watch and not (_all_finite(matrix) and _all_finite(weights))):
            return k, True
        if k == due:
            copy_matrix(weights, history[k // every])
            due += every
    return len(regressors), True


@kernel
def run_felms(
    weights,
    step_size,
    regularisation,
    trace_copies,
    regressors,
    signals,
    fits,
    ceiling,
    history,
    every,
    watch,
):
    """FeLMS likewise; returns how many samples are done."""
    error = np.empty(signals.shape[1])
    due = every - 1
    for k in range(len(regressors)):
        if not fits:
            error = signals[k]
        elif not _error_of(weights, regressors[k], signals[k], error) <= ceiling:
            return k
        felms_update(weights, regressors[k], error, step_size, regularisation, trace_copies)
        if watch and not _all_finite(weights):
            return k
        if k == due:
            copy_matrix(weights, history[k // every])
            due += every
    return len(regressors)
