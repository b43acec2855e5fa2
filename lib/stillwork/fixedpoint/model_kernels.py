"""Both Kalman filters over a record, for models given as C callbacks."""

import numpy as np

from stillwork.fixedpoint.extended import JACOBIAN, OBSERVATION, _correct_extended, _predict_extended
from stillwork.fixedpoint.gaussian import (
    COVARIANCE,
    ESTIMATE,
    EXPECTED,
    MEANS,
    MEASURED,
    OBSERVED,
    POINTS,
)
from stillwork.fixedpoint.unscented import _correct_unscented, _draw_points, _predict_unscented
from stillwork.kernels import kernel


@kernel
def _unscented_record(
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
    states, outputs = means.shape[1], measurements.shape[1]
    points, observed = work[POINTS], work[OBSERVED]
    here, there, expected = np.empty(states), np.empty(states), np.empty(outputs)
    for k in range(len(measurements)):
        if not _draw_points(work, states, weights[0]):
            return k
        for i in range(2 * states + 1):
            for j in range(states):
                here[j] = points[i, j]
            transition(here, inputs[k], parameters, there)
            for j in range(states):
                points[i, j] = there[j]
        _predict_unscented(work, weights, process, states)
        if not _draw_points(work, states, weights[0]):
            return k
        for i in range(2 * states + 1):
            for j in range(states):
                here[j] = points[i, j]
            measurement(here, inputs[k], parameters, expected)
            for j in range(outputs):
                observed[i, j] = expected[j]
        for j in range(outputs):
            work[MEANS, MEASURED, j] = measurements[k, j]
        if not _correct_unscented(work, weights, noise, states, outputs):
            return k
        _keep(work, k, means, covariances)
    return len(measurements)


@kernel
def _extended_record(
    transition,
    measurement,
    parameters,
    measurements,
    inputs,
    process,
    noise,
    work,
    _weights,
    means,
    covariances,
):
    states, outputs = means.shape[1], measurements.shape[1]
    here, high, low = np.empty(states), np.empty(states), np.empty(states)
    expected, above, below = np.empty(outputs), np.empty(outputs), np.empty(outputs)
    for k in range(len(measurements)):
        for j in range(states):
            here[j] = work[MEANS, ESTIMATE, j]
        _differences(transition, here, inputs[k], parameters, high, low, work[JACOBIAN])
        transition(here, inputs[k], parameters, high)
        for j in range(states):
            here[j] = high[j]
            work[MEANS, ESTIMATE, j] = high[j]
        _predict_extended(work, process, states)
        _differences(measurement, here, inputs[k], parameters, above, below, work[OBSERVATION])
        measurement(here, inputs[k], parameters, expected)
        for j in range(outputs):
            work[MEANS, EXPECTED, j] = expected[j]
            work[MEANS, MEASURED, j] = measurements[k, j]
        if not _correct_extended(work, noise, states, outputs):
            return k
        _keep(work, k, means, covariances)
    return len(measurements)


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


@kernel
def _keep(work, k, means, covariances):
    states = means.shape[1]
    for i in range(states):
        means[k, i] = work[MEANS, ESTIMATE, i]
        for j in range(states):
            covariances[k, i, j] = work[COVARIANCE, i, j]
