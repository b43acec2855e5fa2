"""The Kalman filter of any discrete model over a record, with missing samples, and its smoother."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.algebra import (
    cholesky_root,
    cholesky_solve,
    congruence,
    minus_left,
    minus_row,
    multiply,
    plus_row,
    set_product,
)
from stillwork.base.checks import InputError, require_array, require_finite_run
from stillwork.base.kernels import kernel, kernel_for
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.estimation.gaussian import ASYMMETRY, in_deviations, require_covariance
from stillwork.estimation.riccati import KalmanGain, continuous_gain, covariance_root, discrete_gain
from stillwork.lti.state_space import StateModel


@by_value
@dataclass(frozen=True)
class NoiseCovariances:
    """Covariances per sample of the process and the measurement noise; in continuous time, intensities.

    Parameters
    ----------
    process : array_like, shape (states, states)
        Q; it may be singular.
    sensor : array_like, shape (outputs, outputs)
        R, positive definite.
    cross : array_like, shape (states, outputs), optional
        S, covariance of the process noise with the sensor noise of the same sample; zero without.

    Raises
    ------
    InputError
        When together they do not form a covariance.

    References
    ----------
    Anderson and Moore, Optimal Filtering (1979), chapters 3 to 5.

    Examples
    --------
    >>> estimation.NoiseCovariances(process=[[0.0, 0.0], [0.0, 1e-6]], sensor=[[1e-4]]).cross.shape
    (2, 1)
    """

    process: Float64[np.ndarray, "states states"]  # Q
    sensor: Float64[np.ndarray, "outputs outputs"]  # R
    cross: Float64[np.ndarray, "states outputs"] | None = None  # S

    @checked
    def __post_init__(self):
        check_fields(self)
        sizes = len(self.process), len(self.sensor)
        cross = np.zeros(sizes) if self.cross is None else self.cross
        object.__setattr__(self, "cross", require_array("cross", cross, shape=sizes))
        process = require_covariance("process", self.process, sizes[0], definite=False)
        sensor = require_covariance("sensor", self.sensor, sizes[1])
        whole = in_deviations(np.block([[process, self.cross], [self.cross.T, sensor]]))
        if np.linalg.eigvalsh(whole)[0] < -ASYMMETRY:
            raise InputError(
                "process, sensor and cross do not form a covariance: a combination of the noises has a "
                "variance below zero"
            )


@by_value
@dataclass(frozen=True)
class KalmanRecord:
    """Result of a Kalman filter on a record; `filtered` uses the sample itself, `predicted` only those before it.

    Examples
    --------
    >>> walk = lti.StateModel([[1.0]], [[0.0]], [[1.0]], [[0.0]], sample_time=1.0)
    >>> noise = estimation.NoiseCovariances(process=[[0.0]], sensor=[[1.0]])
    >>> record = estimation.kalman_filter(walk, noise, np.zeros((1, 4)), [[2.0, 4.0, np.nan, 6.0]], [[1e9]])
    >>> record.predicted[0, 1:].round(3), record.innovations[0, 1:].round(3)
    (array([2., 3., 3.]), array([ 2., nan,  3.]))
    """

    filtered: Float64[np.ndarray, "states samples"]  # x(k|k)
    filtered_covariance: Float64[np.ndarray, "samples states states"]
    predicted: Float64[np.ndarray, "states samples"]  # x(k|k-1)
    predicted_covariance: Float64[np.ndarray, "samples states states"]
    innovations: Float64[np.ndarray, "outputs samples"]  # NaN where the measurement is missing
    log_likelihood: float  # of the measurements, Gaussian
    model: StateModel
    noise: NoiseCovariances

    @checked
    def smooth(
        self,
    ) -> tuple[Float64[np.ndarray, "states samples"], Float64[np.ndarray, "samples states states"]]:
        """Estimates and covariances from the whole record, later samples included.

        They are those of the Rauch-Tung-Striebel smoother, by the recursion of Bryson and Frazier, which inverts no
        predicted covariance: it may be singular, as with a line of delays.

        Returns
        -------
        smoothed : ndarray, shape (states, samples)
        covariance : ndarray, shape (samples, states, states)

        Raises
        ------
        InputError
            When an estimate overflows.

        References
        ----------
        Bierman, Fixed interval smoothing with discrete measurements, Int. J. Control 18 (1973), 65-75.

        Examples
        --------
        >>> walk = lti.StateModel([[1.0]], [[0.0]], [[1.0]], [[0.0]], sample_time=1.0)
        >>> noise = estimation.NoiseCovariances(process=[[1.0]], sensor=[[1.0]])
        >>> record = estimation.kalman_filter(walk, noise, np.zeros((1, 3)), [[0.0, np.nan, 3.0]], [[1e6]])
        >>> record.smooth()[0].round(2)  # a straight line through the gap, drawn in by the noise
        array([[0.75, 1.5 , 2.25]])
        """
        samples = self.filtered.shape[1]
        smoothed, covariance = np.empty_like(self.filtered), np.empty_like(self.filtered_covariance)
        run = kernel_for(_smooth, samples, _operations(self.model))
        run(
            self.model.a,
            self.model.c,
            self.noise.sensor,
            self.noise.cross,
            self.innovations,
            self.predicted,
            self.predicted_covariance,
            smoothed,
            covariance,
        )
        if samples:
            require_finite_run("the smoothed state", smoothed, "rescale the model or its noises", axis=1)
        return smoothed, covariance


@checked
def kalman_gain(model: StateModel, noise: NoiseCovariances) -> KalmanGain:
    r"""Stationary Kalman gain of any model, in discrete or continuous time.

    The cross covariance is taken out first: with :math:`\bar A = A - SR^{-1}C` and :math:`\bar Q = Q - SR^{-1}S^T`
    the noises are independent, and the gain is that of these plus :math:`SR^{-1}`.

    Parameters
    ----------
    model : StateModel
        D and B do not matter.
    noise : NoiseCovariances

    Returns
    -------
    KalmanGain
        `gain` of the predictor x(k+1|k) (in continuous time of the observer), `filter_gain` of the update with the
        sample itself (discrete time only), the `covariance` of the predicted state and the equation's `residual`.

    Raises
    ------
    InputError
        When the covariances do not fit the model, or the Riccati equation has no accurate solution.

    References
    ----------
    Anderson and Moore, Optimal Filtering (1979), section 5.4.

    Examples
    --------
    >>> walk = lti.StateModel([[1.0]], [[0.0]], [[1.0]], [[0.0]], sample_time=1.0)
    >>> estimation.kalman_gain(walk, estimation.NoiseCovariances([[1.0]], [[1.0]])).gain.round(3)  # golden ratio
    array([[0.618]])
    """
    _require_fit(model, noise)
    cross = np.asarray(noise.cross)
    known = np.linalg.solve(noise.sensor, cross.T).T  # S R^-1
    a = model.a - known @ model.c
    free = noise.process - known @ cross.T
    root = covariance_root((free + free.T) / 2)
    if not np.any(root):
        raise InputError("noise.process drives no state by itself; a stationary gain needs a disturbance")
    if model.sample_time:
        found = discrete_gain(a, root, model.c, 1.0, noise.sensor)
        return KalmanGain(found.gain + known, found.covariance, found.residual, found.filter_gain)
    found = continuous_gain(a, root, model.c, 1.0, noise.sensor)
    return KalmanGain(found.gain + known, found.covariance, found.residual)


@checked(missing=True)
def kalman_filter(
    model: StateModel,
    noise: NoiseCovariances,
    u: ArrayLike,
    y: ArrayLike,
    initial_covariance: ArrayLike,
    initial: ArrayLike | None = None,
) -> KalmanRecord:
    r"""Kalman filter over a record of :math:`x_{k+1} = Ax_k + Bu_k + w_k,\; y_k = Cx_k + Du_k + v_k`.

    Every sample is used, including the first one. A measurement that is NaN is missing: of several outputs the others are
    used.

    Parameters
    ----------
    model : StateModel
        In discrete time; it may be unstable.
    noise : NoiseCovariances
        Of w and v.
    u : array_like, shape (inputs, samples)
    y : array_like, shape (outputs, samples)
        NaN where a measurement is missing.
    initial_covariance : array_like, shape (states, states) or (states,)
        Covariance (or its diagonal) of the state at the first sample before its measurement; large if it is unknown.
    initial : array_like, shape (states,), optional
        Its mean; zero without.

    Returns
    -------
    KalmanRecord
        Estimates and covariances before and after each sample, innovations, log-likelihood; `smooth` uses later
        samples as well.

    Raises
    ------
    InputError
        When the model is in continuous time, sizes do not fit, or an estimate overflows.

    References
    ----------
    Anderson and Moore, Optimal Filtering (1979), chapters 3 to 5.

    Examples
    --------
    >>> walk = lti.StateModel([[1.0]], [[0.0]], [[1.0]], [[0.0]], sample_time=1.0)
    >>> noise = estimation.NoiseCovariances(process=[[0.0]], sensor=[[1.0]])  # a constant: the running mean
    >>> estimation.kalman_filter(walk, noise, np.zeros((1, 3)), [[2.0, 4.0, 6.0]], [[1e9]]).filtered.round(3)
    array([[2., 3., 4.]])
    """
    if not model.sample_time:
        raise InputError("model is in continuous time; discretise it with zoh first")
    _require_fit(model, noise)
    n, (outputs, inputs) = len(model.a), model.d.shape
    y = require_array("y", y, shape=(outputs, None), missing=True)
    if not y.shape[1]:
        raise InputError(f"y has shape {y.shape}; give {outputs} x samples")
    u = require_array("u", u, shape=(inputs, y.shape[1]))
    start = require_covariance("initial_covariance", initial_covariance, n, definite=False)
    initial = require_array("initial", np.zeros(n) if initial is None else initial, shape=(n,))
    samples = y.shape[1]
    filtered, predicted = np.empty((n, samples)), np.empty((n, samples))
    after, before = np.empty((samples, n, n)), np.empty((samples, n, n))
    innovations = np.empty_like(y)
    run = kernel_for(_filter, samples, _operations(model))
    likelihood = run(
        model.a,
        model.b,
        model.c,
        model.d,
        noise.process,
        noise.sensor,
        noise.cross,
        u,
        y,
        initial,
        (start + start.T) / 2,
        filtered,
        predicted,
        after,
        before,
        innovations,
    )
    for name, values in (("the state", filtered), ("the predicted state", predicted)):
        require_finite_run(name, values, "rescale the model or its noises", axis=1)
    require_finite_run("the covariance", after, "the model is unstable and unmeasured for too long")
    return KalmanRecord(filtered, after, predicted, before, innovations, float(likelihood), model, noise)


def _require_fit(model: StateModel, noise: NoiseCovariances) -> None:
    n, outputs = len(model.a), len(model.c)
    if not n:
        raise InputError("model has no states; there is nothing to estimate")
    for name, size in (("process", n), ("sensor", outputs)):
        shape = getattr(noise, name).shape
        if shape != (size, size):
            raise InputError(f"noise.{name} has shape {shape}; give {size} x {size} for this model")


def _operations(model: StateModel) -> int:
    n, outputs = len(model.a), len(model.c)
    return 2 * (n + outputs) ** 3


@kernel
def _present(y, k, places):
    """How many outputs were measured at sample k, and which."""
    count = 0
    for i in range(y.shape[0]):
        if not np.isnan(y[i, k]):
            places[count] = i
            count += 1
    return count


@kernel
def _gains(a, c, sensor, cross, p, places, count, rows, s, known, root, gain, leak):
    """Of one sample, from the predicted covariance P, for the outputs that were measured.

    Fills `rows` (their C), `s` (covariance of the innovation, and its lower `root`), the filter's `gain`, `known`
    (S R^-1) and `leak`, A - S R^-1 C. False where the innovation's covariance is not positive definite.
    """
    n = len(a)
    for i in range(count):
        for j in range(n):
            rows[i, j] = c[places[i], j]
    for i in range(count):  # R of those measured, for S R^-1
        for j in range(count):
            s[i, j] = sensor[places[i], places[j]]
    if not cholesky_root(s, root, count):
        return False
    for i in range(n):
        for j in range(count):
            known[i, j] = cross[i, places[j]]
        cholesky_solve(root, known[i, :count], known[i, :count])
        for j in range(n):
            total = a[i, j]
            for m in range(count):
                total -= known[i, m] * rows[m, j]
            leak[i, j] = total
    for i in range(n):  # P C'
        for j in range(count):
            gain[i, j] = plus_row(0.0, rows, j, p[i])
    for i in range(count):
        for j in range(i + 1):
            total = 0.0
            for m in range(n):
                total += rows[i, m] * gain[m, j]
            s[i, j] = s[j, i] = s[i, j] + total
    if not cholesky_root(s, root, count):
        return False
    for i in range(n):
        cholesky_solve(root, gain[i, :count], gain[i, :count])
    return True


@kernel
def _filter(
    a, b, c, d, process, sensor, cross, u, y, initial, start, filtered, predicted, after, before, innovations
):
    n, (outputs, samples) = len(a), y.shape
    x, following, error = initial.copy(), np.empty(n), np.empty(outputs)
    p, half, kept = start.copy(), np.empty((n, n)), np.empty((n, n))
    places = np.empty(outputs, np.int64)
    rows, s, root = np.zeros((outputs, n)), np.empty((outputs, outputs)), np.empty((outputs, outputs))
    known, gain, leak = np.empty((n, outputs)), np.empty((n, outputs)), np.empty((n, n))
    likelihood = 0.0
    for k in range(samples):
        for i in range(n):
            predicted[i, k] = x[i]
            for j in range(n):
                before[k, i, j] = p[i, j]
        count = _present(y, k, places)
        if not _gains(a, c, sensor, cross, p, places, count, rows, s, known, root, gain, leak):
            filtered[:, k:] = np.nan
            predicted[:, k:] = np.nan
            return np.nan
        innovations[:, k] = np.nan
        for i in range(count):
            o = places[i]
            fed = y[o, k]
            for j in range(u.shape[0]):
                fed -= d[o, j] * u[j, k]
            error[i] = innovations[o, k] = minus_row(fed, c, o, x)
        likelihood -= _surprise(root, error, count)
        for i in range(n):
            for j in range(count):
                x[i] += gain[i, j] * error[j]
        # Joseph: (I - K C) P (I - K C)' + K R K' stays a covariance.
        for i in range(n):
            for j in range(n):
                total = 1.0 if i == j else 0.0
                for m in range(count):
                    total -= gain[i, m] * rows[m, j]
                kept[i, j] = total
        congruence(kept, p, half, p)
        for i in range(n):
            for j in range(i + 1):
                total = p[i, j]
                for m in range(count):
                    weighted = 0.0
                    for q in range(count):
                        weighted += sensor[places[m], places[q]] * gain[j, q]
                    total += gain[i, m] * weighted
                p[i, j] = p[j, i] = total
        for i in range(n):
            filtered[i, k] = x[i]
            for j in range(n):
                after[k, i, j] = p[i, j]
        set_product(leak, x, following)
        for i in range(n):
            for j in range(u.shape[0]):
                following[i] += b[i, j] * u[j, k]
            for j in range(count):
                o = places[j]
                fed = y[o, k]
                for m in range(u.shape[0]):
                    fed -= d[o, m] * u[m, k]
                following[i] += known[i, j] * fed
        x[:] = following
        congruence(leak, p, half, p)
        for i in range(n):
            for j in range(i + 1):
                total = p[i, j] + process[i, j]
                for m in range(count):
                    total -= known[i, m] * cross[j, places[m]]
                p[i, j] = p[j, i] = total
    return likelihood


@kernel
def _surprise(root, error, count):
    """Minus the logarithm of a Gaussian density of covariance root root'."""
    total = 0.5 * count * np.log(2 * np.pi)
    white = np.empty(count)
    for i in range(count):
        white[i] = minus_left(error[i], root, i, white) / root[i, i]
        total += 0.5 * white[i] ** 2 + np.log(root[i, i])
    return total


@kernel
def _smooth(a, c, sensor, cross, innovations, predicted, before, smoothed, covariance):
    n, samples = predicted.shape
    outputs = len(c)
    places = np.empty(outputs, np.int64)
    rows, s, root = np.zeros((outputs, n)), np.empty((outputs, outputs)), np.empty((outputs, outputs))
    known, gain, leak = np.empty((n, outputs)), np.empty((n, outputs)), np.empty((n, n))
    pull, turned = np.zeros(n), np.empty(n)  # r, and L' r
    spread, half = np.zeros((n, n)), np.empty((n, n))  # N
    closed, white = np.empty((n, n)), np.empty(outputs)
    for k in range(samples - 1, -1, -1):
        p = before[k]
        count = _present(innovations, k, places)
        _gains(a, c, sensor, cross, p, places, count, rows, s, known, root, gain, leak)
        # L = A - K_p C with the predictor's gain K_p = (A - S R^-1 C) K + S R^-1
        for i in range(n):
            for j in range(n):
                closed[j, i] = leak[i, j]  # transposed
            for m in range(count):
                total = plus_row(0.0, leak, i, gain[:, m])
                for j in range(n):
                    closed[j, i] -= total * rows[m, j]
        set_product(closed, pull, turned)
        congruence(closed, spread, half, spread)
        for i in range(count):
            white[i] = innovations[places[i], k]
        if count:
            cholesky_solve(root, white[:count], white[:count])
        for i in range(n):
            pull[i] = turned[i]
            for m in range(count):
                pull[i] += rows[m, i] * white[m]
        for j in range(n):  # C' S^-1 C
            column = np.empty(count)
            for m in range(count):
                column[m] = rows[m, j]
            if count:
                cholesky_solve(root, column, column)
            for i in range(j + 1):
                total = spread[i, j]
                for m in range(count):
                    total += rows[m, i] * column[m]
                spread[i, j] = spread[j, i] = total
        set_product(p, pull, turned)
        multiply(p, spread, half)
        for i in range(n):
            smoothed[i, k] = predicted[i, k] + turned[i]
            for j in range(i + 1):
                total = p[i, j]
                for m in range(n):
                    total -= half[i, m] * p[m, j]
                covariance[k, i, j] = covariance[k, j, i] = total
