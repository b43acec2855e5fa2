"""Filters on a window of the latest samples: cascaded affine fits, and the Savitzky-Golay end point."""

import math

import numpy as np
from jaxtyping import Float64

from stillwork.base.algebra import inner_product
from stillwork.base.bounds import Count, Natural
from stillwork.base.checks import InputError, require_memory
from stillwork.base.kernels import borrowing_kernel
from stillwork.base.validation import checked


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


# state[0]: the buffers, one a row, oldest sample first; state[1, 0, 0] = 1 once they are filled.


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
