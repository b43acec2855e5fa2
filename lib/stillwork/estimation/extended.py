"""The extended Kalman filter in kernels independent of the model, and its form with a disturbance state."""

import numpy as np

from stillwork.base.algebra import plus_row
from stillwork.base.kernels import borrowing_kernel
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
    correct_gaussian,
)

JACOBIAN, OBSERVATION = POINTS, OBSERVED  # the two blocks that the unscented filter fills with points


@borrowing_kernel
def predict_extended(work, process, size):
    """P = F P F' + Q."""
    covariance, jacobian, product = work[COVARIANCE], work[JACOBIAN], work[CROSS]
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += jacobian[i, k] * covariance[k, j]
            product[i, j] = total
    for i in range(size):
        for j in range(i + 1):
            covariance[i, j] = covariance[j, i] = plus_row(process[i, j], product, i, jacobian[j])


@borrowing_kernel
def correct_extended(work, noise, size, outputs):
    """Cross covariance P H', innovation H P H' + R, and the correction."""
    covariance, observation, cross = work[COVARIANCE], work[OBSERVATION], work[CROSS]
    for i in range(size):
        for j in range(outputs):
            cross[i, j] = plus_row(0.0, covariance, i, observation[j])
    for i in range(outputs):
        for j in range(outputs):
            total = noise[i, j]
            for k in range(size):
                total += observation[i, k] * cross[k, j]
            work[INNOVATION, i, j] = total
    return correct_gaussian(work, size, outputs)


@borrowing_kernel
def plant_extended_step(
    options, process, noise, work, acceleration, plant, sample_time, measured, force, estimate
):
    """One sample for a second-order plant: x = [velocity, position, disturbance], z = position.

    The disturbance is the acceleration that the model does not explain, a random walk. options: initial
    variances of position, velocity and disturbance. work[MEANS, PAST, 0]: 1 once there was a measurement. NaN is a
    missing one: the filter predicts.
    """
    means, jacobian = work[MEANS], work[JACOBIAN]
    if means[PAST, 0] == 0.0:
        means[PAST, 0] = 1.0
        means[ESTIMATE, 0] = estimate[1]
        means[ESTIMATE, 1] = measured - sample_time * estimate[1]
        work[COVARIANCE, 0, 0] = options[1]
        work[COVARIANCE, 1, 1] = options[0]
        work[COVARIANCE, 2, 2] = options[2]
        work[OBSERVATION, 0, 1] = 1.0
    velocity, position, disturbance = means[ESTIMATE, 0], means[ESTIMATE, 1], means[ESTIMATE, 2]
    # Central differences over a millionth of the estimate or of its deviation; without deviation no slope counts.
    step_q = 1e-6 * max(abs(position), max(0.0, work[COVARIANCE, 1, 1]) ** 0.5)
    step_v = 1e-6 * max(abs(velocity), max(0.0, work[COVARIANCE, 0, 0]) ** 0.5)
    slope_q = slope_v = 0.0
    if step_q > 0.0:
        slope_q = (
            acceleration(position + step_q, velocity, force, plant)
            - acceleration(position - step_q, velocity, force, plant)
        ) / (2.0 * step_q)
    if step_v > 0.0:
        slope_v = (
            acceleration(position, velocity + step_v, force, plant)
            - acceleration(position, velocity - step_v, force, plant)
        ) / (2.0 * step_v)
    jacobian[0, 0] = 1.0 + sample_time * slope_v
    jacobian[0, 1] = sample_time * slope_q
    jacobian[0, 2] = sample_time
    for j in range(3):
        jacobian[1, j] = sample_time * jacobian[0, j]
        jacobian[2, j] = 0.0
    jacobian[1, 1] += 1.0
    jacobian[2, 2] = 1.0
    change = acceleration(position, velocity, force, plant) + disturbance
    means[ESTIMATE, 0] = velocity + sample_time * change
    means[ESTIMATE, 1] = position + sample_time * means[ESTIMATE, 0]
    predict_extended(work, process, 3)
    if not np.isnan(measured):
        means[MEASURED, 0] = measured
        means[EXPECTED, 0] = means[ESTIMATE, 1]
        if not correct_extended(work, noise, 3, 1):
            return False
    estimate[0] = means[ESTIMATE, 1]
    estimate[1] = means[ESTIMATE, 0]
    estimate[2] = acceleration(estimate[0], estimate[1], force, plant) + means[ESTIMATE, 2]
    return True
