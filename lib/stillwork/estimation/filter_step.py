"""One sample through any filter: filters independent of the model, and one kernel for all of them.

Without a model: cascaded affine fits on a window of the latest samples, the Savitzky-Golay end point, and the low pass (7).
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from stillwork.base.algebra import inner_product
from stillwork.base.bounds import Count, Natural
from stillwork.base.checks import InputError, require_memory
from stillwork.base.kernels import borrowing_kernel
from stillwork.base.validation import checked
from stillwork.estimation.extended import plant_extended_step
from stillwork.estimation.unscented import plant_unscented_step

WINDOW, LOW_PASS, UNSCENTED, EXTENDED, SAVITZKY_GOLAY = range(5)


class Packed(NamedTuple):
    """A filter as the kernels take it: which one, its numbers, and a workspace that starts at zero."""

    kind: int
    options: np.ndarray  # float64, one axis
    process: np.ndarray  # Q, two axes; empty where there is none
    noise: np.ndarray  # R
    work: np.ndarray  # three axes


@checked
def end_point_weights(
    samples: Count, degree: Natural, derivative: Natural = 0
) -> Float64[np.ndarray, " samples"]:
    """Weights of a least-squares polynomial's value or derivative (a sample, not a second) at the last sample.

    The first weight belongs to the oldest sample.
    """
    if not derivative <= degree < samples:
        raise InputError(
            f"derivative, degree and samples are {derivative}, {degree} and {samples}; "
            "give a degree below the samples and a derivative of at most the degree"
        )
    require_memory("samples", samples, degree + 1)
    place = np.arange(1 - samples, 1) / max(samples - 1, 1)  # scaled to [-1, 0]: well conditioned
    powers = np.vander(place, degree + 1, increasing=True)
    fit = np.linalg.pinv(powers)[derivative]
    return fit * math.factorial(derivative) / max(samples - 1, 1) ** derivative


# state[0]: the buffers, one per row, oldest sample first; state[1, 0, 0] = 1 once they are filled.


@borrowing_kernel
def _slide(weights, buffer, value):
    """Push a value into a buffer; the weighted sum of what it then holds."""
    total, last = 0.0, buffer.shape[0] - 1
    for i in range(last):
        buffer[i] = buffer[i + 1]
        total += weights[i] * buffer[i]
    buffer[last] = value
    return total + weights[last] * value


@borrowing_kernel
def moving_window_step(weights, state, sample_time, measured, estimate):
    """Section II.A: fit, difference, fit, difference, fit.

    `estimate` holds the last one on entry: at the first sample the motion that is presumed before it.
    """
    buffers = state[0]
    if state[1, 0, 0] == 0.0:
        state[1, 0, 0] = 1.0
        for i in range(buffers.shape[1]):
            buffers[0, i] = measured + (i - buffers.shape[1]) * sample_time * estimate[1]
        buffers[1, :] = estimate[1]
        buffers[2, :] = estimate[2]
        estimate[0] = measured - sample_time * estimate[1]
    value = measured
    for level in range(3):
        fitted = _slide(weights, buffers[level], value)
        value = (fitted - estimate[level]) / sample_time
        estimate[level] = fitted


@borrowing_kernel
def savitzky_golay_step(weights, state, sample_time, measured, estimate):
    """Three rows of weights on one buffer: position, velocity, acceleration; starts as the moving window."""
    samples = state.shape[2]
    if state[1, 0, 0] == 0.0:
        state[1, 0, 0] = 1.0
        for i in range(samples):
            state[0, 0, i] = measured + (i - samples) * sample_time * estimate[1]
    estimate[0] = _slide(weights[:samples], state[0, 0], measured)
    for row in range(1, 3):
        estimate[row] = inner_product(weights[row * samples : (row + 1) * samples], state[0, 0])


@borrowing_kernel
def low_pass_step(options, state, sample_time, measured, estimate):
    """(bandwidth + d/dt)^3 filtered = bandwidth^3 measured; state[0, 0, :3]: filtered and two derivatives.

    The estimate is the state that Euler's step with this measurement reaches. options: bandwidth, whether it starts from
    zero; else it starts with the velocity and acceleration that are presumed, and without a jerk, behind the measurement by
    its own lag. state[0, 0, 3]: 1 once it has started.
    """
    bandwidth = options[0]
    if state[0, 0, 3] == 0.0 and options[1] == 0.0:
        state[0, 0, 1] = estimate[1] - sample_time * estimate[2]
        state[0, 0, 0] = measured - 3.0 * (state[0, 0, 1] + estimate[2] / bandwidth) / bandwidth
        state[0, 0, 2] = estimate[2]
    state[0, 0, 3] = 1.0
    filtered, rate, curvature = state[0, 0, 0], state[0, 0, 1], state[0, 0, 2]
    jerk = bandwidth**3 * (measured - filtered) - 3.0 * bandwidth**2 * rate - 3.0 * bandwidth * curvature
    state[0, 0, 0] = filtered + sample_time * rate
    state[0, 0, 1] = rate + sample_time * curvature
    state[0, 0, 2] = curvature + sample_time * jerk
    estimate[0] = state[0, 0, 0]
    estimate[1] = state[0, 0, 1]
    estimate[2] = state[0, 0, 2]


@borrowing_kernel
def filter_step(device, acceleration, plant, sample_time, measured, force, estimate):
    """Advance one filter by one sample; `estimate` (position, velocity, acceleration) is read and written."""
    kind, options, process, noise, work = device
    if kind == WINDOW:
        moving_window_step(options, work, sample_time, measured, estimate)
        return True
    if kind == LOW_PASS:
        low_pass_step(options, work, sample_time, measured, estimate)
        return True
    if kind == SAVITZKY_GOLAY:
        savitzky_golay_step(options, work, sample_time, measured, estimate)
        return True
    if kind == UNSCENTED:
        return plant_unscented_step(
            options, process, noise, work, acceleration, plant, sample_time, measured, force, estimate
        )
    return plant_extended_step(
        options, process, noise, work, acceleration, plant, sample_time, measured, force, estimate
    )
