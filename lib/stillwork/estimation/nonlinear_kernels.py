"""Both Kalman filters over a record, for models given as C callbacks."""

import numpy as np

from stillwork.base.kernels import kernel
from stillwork.estimation.extended import JACOBIAN, OBSERVATION, correct_extended, predict_extended
from stillwork.estimation.gaussian import COVARIANCE, ESTIMATE, EXPECTED, MEANS, MEASURED, OBSERVED, POINTS
from stillwork.estimation.unscented import correct_unscented, predict_unscented, spread_points


@kernel
def model_record(
    unscented,
    transition,
    measurement,
    parameters,
    measurements,
    inputs,
    process,
    noise,
    work,
    weights,
    means,
    covariances,
):
    """Filter a record, unscented or extended; returns the samples done. Without its measurement a sample is predicted."""
    states, outputs = means.shape[1], measurements.shape[1]
    state, seen = np.empty((3, states)), np.empty((3, outputs))  # one row an argument of the model functions
    for k in range(len(measurements)):
        missing = False
        for j in range(outputs):
            work[MEANS, MEASURED, j] = measurements[k, j]
            missing |= np.isnan(measurements[k, j])
        if unscented:
            definite = _predict_points(transition, parameters, inputs[k], process, work, weights, state) and (
                missing
                or _correct_points(measurement, parameters, inputs[k], noise, work, weights, state, seen)
            )
        else:
            _predict_mean(transition, parameters, inputs[k], process, work, state)
            definite = missing or _correct_mean(measurement, parameters, inputs[k], noise, work, state, seen)
        if not definite:
            return k
        for i in range(states):
            means[k, i] = work[MEANS, ESTIMATE, i]
            for j in range(states):
                covariances[k, i, j] = work[COVARIANCE, i, j]
    return len(measurements)


@kernel
def _predict_points(transition, parameters, inputs, process, work, weights, state):
    states = state.shape[1]
    if not spread_points(work, states, weights[0]):
        return False
    _move_points(transition, inputs, parameters, work[POINTS], work[POINTS], state[0], state[1])
    predict_unscented(work, weights, process, states)
    return True


@kernel
def _correct_points(measurement, parameters, inputs, noise, work, weights, state, seen):
    states, outputs = state.shape[1], seen.shape[1]
    if not spread_points(work, states, weights[0]):
        return False
    _move_points(measurement, inputs, parameters, work[POINTS], work[OBSERVED], state[0], seen[0])
    return correct_unscented(work, weights, noise, states, outputs)


@kernel
def _move_points(function, inputs, parameters, points, results, here, there):
    """Send every sigma point through a model function; `here` and `there` are its arguments."""
    for i in range(2 * len(here) + 1):
        for j in range(len(here)):
            here[j] = points[i, j]
        function(here, inputs, parameters, there)
        for j in range(len(there)):
            results[i, j] = there[j]


@kernel
def _predict_mean(transition, parameters, inputs, process, work, state):
    states = state.shape[1]
    here, mean = state[0], work[MEANS, ESTIMATE]
    for j in range(states):
        here[j] = mean[j]
    _differences(transition, here, inputs, parameters, state[1], state[2], work[JACOBIAN])
    transition(here, inputs, parameters, state[1])
    for j in range(states):
        mean[j] = state[1, j]
    predict_extended(work, process, states)


@kernel
def _correct_mean(measurement, parameters, inputs, noise, work, state, seen):
    states, outputs = state.shape[1], seen.shape[1]
    here = state[0]
    for j in range(states):
        here[j] = work[MEANS, ESTIMATE, j]
    _differences(measurement, here, inputs, parameters, seen[1], seen[2], work[OBSERVATION])
    measurement(here, inputs, parameters, seen[0])
    for j in range(outputs):
        work[MEANS, EXPECTED, j] = seen[0, j]
    return correct_extended(work, noise, states, outputs)


@kernel
def _differences(function, at, inputs, parameters, high, low, jacobian):
    """Central differences of the fourth order of a model function at `at`, which is restored."""
    for j in range(len(at)):
        centre = at[j]
        step = 7e-4 * max(1.0, abs(centre))  # fifth root of the rounding error
        for i in range(len(high)):
            jacobian[i, j] = 0.0
        for reach, weight in ((1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0)):
            at[j] = centre + reach * step
            function(at, inputs, parameters, high)
            at[j] = centre - reach * step
            function(at, inputs, parameters, low)
            for i in range(len(high)):
                jacobian[i, j] += weight * (high[i] - low[i]) / step
        at[j] = centre
