"""The unscented Kalman filter (12)-(17), corrected, in kernels independent of the model.

A model enters between them: draw points, let the caller move them, take their mean and covariance; draw
again, let the caller compute their measurements, correct.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64

from stillwork.base.algebra import cholesky_root, copy_matrix
from stillwork.base.bounds import Positive, within
from stillwork.base.kernels import borrowing_kernel, pasted_kernel
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.estimation.gaussian import (
    COVARIANCE,
    CROSS,
    ESTIMATE,
    EXPECTED,
    INNOVATION,
    MEANS,
    MEASURED,
    OBSERVED,
    PAST,
    POINTS,
    ROOT,
    correct_gaussian,
)


@by_value
@dataclass(frozen=True)
class SigmaPoints:
    """Scaling of the sigma points, Table II (which prints 1 - alpha where 1 - alpha^2 belongs).

    With the published alpha the first weight is -9999: the weighted sums lose four digits.
    """

    alpha: Positive = 1e-2
    beta: float = 1e-3
    kappa: Annotated[float, within(above=-1)] = 0.0

    def __post_init__(self):
        check_fields(self)

    @checked
    def weights(self, size: int) -> Float64[np.ndarray, "4"]:
        """L + lambda, W0 of the mean, W0 of the covariance, and every other weight."""
        spread = self.alpha**2 * (size + self.kappa)
        first = 1 - size / spread  # lambda / (L + lambda)
        return np.array([spread, first, first + 1 - self.alpha**2 + self.beta, 1 / (2 * spread)])


@pasted_kernel
def spread_points(work, size, spread):
    """(12): the mean, and the mean plus and minus the columns of sqrt(spread P), spread = L + lambda."""
    points, means, root = work[POINTS], work[MEANS], work[ROOT]
    if not cholesky_root(work[COVARIANCE], root, size):
        return False
    scale = spread**0.5
    for j in range(size):
        points[0, j] = means[ESTIMATE, j]
        for i in range(size):
            column = scale * root[j, i] if j >= i else 0.0
            points[1 + i, j] = means[ESTIMATE, j] + column
            points[1 + size + i, j] = means[ESTIMATE, j] - column
    return True


@pasted_kernel
def _weighted_mean(points, mean, count, size, first, other):
    for j in range(size):
        total = first * points[0, j]
        for i in range(1, count):
            total += other * points[i, j]
        mean[j] = total


@pasted_kernel
def _weighted_product(points, mean, others, other_mean, result, count, rows, columns, first, other):
    for i in range(rows):
        for j in range(columns):
            total = first * (points[0, i] - mean[i]) * (others[0, j] - other_mean[j])
            for k in range(1, count):
                total += other * (points[k, i] - mean[i]) * (others[k, j] - other_mean[j])
            result[i, j] = total


@pasted_kernel
def _weighted_square(points, mean, noise, missing, result, count, size, first, other):
    """As `_weighted_product` of points with themselves, plus their noise; symmetric, and half the work."""
    for i in range(size):
        for j in range(i + 1):
            total = first * (points[0, i] - mean[i]) * (points[0, j] - mean[j])
            for k in range(1, count):
                total += other * (points[k, i] - mean[i]) * (points[k, j] - mean[j])
            result[i, j] = result[j, i] = total + noise[missing + i, missing + j]


@pasted_kernel
def predict_unscented(work, weights, process, size):
    """(13): mean and covariance of the moved points, about the predicted mean, plus Q."""
    points, covariance, mean, count = work[POINTS], work[COVARIANCE], work[MEANS, ESTIMATE], 2 * size + 1
    _weighted_mean(points, mean, count, size, weights[1], weights[3])
    _weighted_square(points, mean, process, 0, covariance, count, size, weights[2], weights[3])


@pasted_kernel
def correct_unscented(work, weights, noise, size, outputs):
    """(15)-(17): the points, their measurements and the actual measurement are in place."""
    points, observed, innovation, count = work[POINTS], work[OBSERVED], work[INNOVATION], 2 * size + 1
    mean, expected = work[MEANS, ESTIMATE], work[MEANS, EXPECTED]
    first, other = weights[2], weights[3]
    _weighted_mean(observed, expected, count, outputs, weights[1], other)
    missing = len(noise) - outputs  # the first ones, where a measurement lacks them
    _weighted_square(observed, expected, noise, missing, innovation, count, outputs, first, other)
    _weighted_product(points, mean, observed, expected, work[CROSS], count, size, outputs, first, other)
    return correct_gaussian(work, size, outputs)


@borrowing_kernel
def plant_unscented_step(
    options, process, noise, work, acceleration, plant, sample_time, measured, force, estimate
):
    """One sample for a second-order plant: x = [velocity, position], z = [difference quotient, position].

    options: four weights, 1 for the literal (14), initial variance, 1 for the model's acceleration.
    work[MEANS, PAST]: the last measurement, and 1 once there was one, 2 while it is missing. NaN is a missing measurement: the filter predicts. The one after
    has no difference quotient, so that the position alone corrects.
    """
    points, observed, means = work[POINTS], work[OBSERVED], work[MEANS]
    if means[PAST, 1] == 0.0:
        means[PAST, 0] = measured - sample_time * estimate[1]
        means[PAST, 1] = 1.0
        means[ESTIMATE, 0] = estimate[1]
        means[ESTIMATE, 1] = measured - sample_time * estimate[1]
        work[COVARIANCE, 0, 0] = options[5]
        work[COVARIANCE, 1, 1] = options[5]
    last_velocity = means[ESTIMATE, 0]
    literal = options[4] != 0.0
    if not spread_points(work, 2, options[0]):
        return False
    if literal:  # (14) as printed: the correction uses the points around the *previous* estimate
        copy_matrix(points, observed)
    for i in range(5):  # (10), with all terms of (11)
        points[i, 0] += sample_time * acceleration(points[i, 1], points[i, 0], force, plant)
        points[i, 1] += sample_time * points[i, 0]
    predict_unscented(work, options, process, 2)
    if literal:
        copy_matrix(observed, points)
    else:
        if not spread_points(work, 2, options[0]):
            return False
        copy_matrix(points, observed)
    if np.isnan(measured):
        means[PAST, 1] = 2.0
    elif means[PAST, 1] == 2.0:
        for i in range(5):
            observed[i, 0] = observed[i, 1]
        means[MEASURED, 0] = measured
        if not correct_unscented(work, options, noise, 2, 1):
            return False
        means[PAST, 0], means[PAST, 1] = measured, 1.0
    else:
        means[MEASURED, 0] = (measured - means[PAST, 0]) / sample_time
        means[MEASURED, 1] = measured
        means[PAST, 0] = measured
        if not correct_unscented(work, options, noise, 2, 2):
            return False
    estimate[0] = means[ESTIMATE, 1]
    estimate[1] = means[ESTIMATE, 0]
    if options[6] != 0.0:
        estimate[2] = acceleration(estimate[0], estimate[1], force, plant)
    else:
        estimate[2] = (means[ESTIMATE, 0] - last_velocity) / sample_time
    return True
