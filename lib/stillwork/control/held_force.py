"""Motion of a plant under a force that is held for a sample, by Runge-Kutta steps that are halved until they agree.

A step of the classical method (fourth order) is compared with two of half its length; their difference is the error,
and corrects the result to fifth order.
"""

import numpy as np

from stillwork.base.kernels import borrowing_kernel
from stillwork.control.mechanism import forward_dynamics

ACCURACY = 1e-9  # of a step, in parts of position and velocity and of what the step changes in them
SHORTEST = (
    1 / 1024
)  # of a sample; a force that jumps with the motion (dry friction) is not followed more finely
# Rows of the work array of `move_mechanism_held`, beside those of `forward_dynamics`.
HELD_ROWS = 12


@borrowing_kernel
def _step(acceleration, plant, position, velocity, force, h):
    a1 = acceleration(position, velocity, force, plant)
    v2 = velocity + h / 2 * a1
    a2 = acceleration(position + h / 2 * velocity, v2, force, plant)
    v3 = velocity + h / 2 * a2
    a3 = acceleration(position + h / 2 * v2, v3, force, plant)
    v4 = velocity + h * a3
    a4 = acceleration(position + h * v3, v4, force, plant)
    return (
        position + h / 6 * (velocity + 2 * v2 + 2 * v3 + v4),
        velocity + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4),
    )


@borrowing_kernel
def _next_length(h, error):
    """Length of the next step: the error falls with its fifth power."""
    if not error < np.inf:
        return h / 10
    return h * min(4.0, max(0.1, 0.9 * max(error, 1e-6) ** -0.2))


@borrowing_kernel
def _error(one, two, before, speed, h):
    """Of one number, over what it may be: `before` it was, and at `speed` it moves."""
    allowed = ACCURACY * (abs(before) + h * abs(speed) + abs(two - before))
    difference = abs(two - one) / 15
    return difference / allowed if difference > 0.0 else difference


@borrowing_kernel
def move_held(acceleration, plant, position, velocity, force, sample_time, h):
    """Position and velocity a sample later, and the length of the last step, the first one of the next sample."""
    left = sample_time
    while left > 0.0:
        last = h >= left
        h = left if last else h
        one_q, one_v = _step(acceleration, plant, position, velocity, force, h)
        half_q, half_v = _step(acceleration, plant, position, velocity, force, h / 2)
        two_q, two_v = _step(acceleration, plant, half_q, half_v, force, h / 2)
        error = max(
            _error(one_q, two_q, position, velocity, h),
            _error(one_v, two_v, velocity, (two_v - velocity) / h, h),
        )
        longer = _next_length(h, error)
        if error <= 1.0 or h <= SHORTEST * sample_time:
            position = two_q + (two_q - one_q) / 15
            velocity = two_v + (two_v - one_v) / 15
            left = 0.0 if last else left - h
            if not (abs(position) < np.inf and abs(velocity) < np.inf):
                break
        h = min(sample_time, max(longer, SHORTEST * sample_time))
    return position, velocity, h


@borrowing_kernel
def _step_mechanism(inertia, bias, plant, position, velocity, force, h, work, rows, to_position, to_velocity):
    """As `_step`; rows: five vectors of workspace. False where the inertia is not positive definite."""
    n = len(position)
    place, speed, change, rate, slope = rows[0], rows[1], rows[2], rows[3], rows[4]
    for i in range(n):
        place[i], speed[i], change[i], rate[i] = position[i], velocity[i], 0.0, 0.0
    for stage in range(4):
        if not forward_dynamics(inertia, bias, plant, place, speed, force, work, slope):
            return False
        weight = 2.0 if stage == 1 or stage == 2 else 1.0
        forward = h if stage == 2 else h / 2
        for i in range(n):
            change[i] += weight * speed[i]
            rate[i] += weight * slope[i]
            place[i] = position[i] + forward * speed[i]
            speed[i] = velocity[i] + forward * slope[i]
    for i in range(n):
        to_position[i] = position[i] + h / 6 * change[i]
        to_velocity[i] = velocity[i] + h / 6 * rate[i]
    return True


@borrowing_kernel
def move_mechanism_held(inertia, bias, plant, position, velocity, force, sample_time, h, work, rows):
    """As `move_held` of several coordinates, in place; returns the length of the last step, 0 where there is no inertia.

    rows: `HELD_ROWS` vectors of workspace.
    """
    n, left = len(position), sample_time
    one_q, one_v, half_q, half_v, two_q, two_v = rows[5], rows[6], rows[7], rows[8], rows[9], rows[10]
    while left > 0.0:
        last = h >= left
        h = left if last else h
        whole = _step_mechanism(inertia, bias, plant, position, velocity, force, h, work, rows, one_q, one_v)
        whole = whole and _step_mechanism(
            inertia, bias, plant, position, velocity, force, h / 2, work, rows, half_q, half_v
        )
        whole = whole and _step_mechanism(
            inertia, bias, plant, half_q, half_v, force, h / 2, work, rows, two_q, two_v
        )
        error = 0.0
        for i in range(n):
            error = max(error, _error(one_q[i], two_q[i], position[i], velocity[i], h))
            error = max(error, _error(one_v[i], two_v[i], velocity[i], (two_v[i] - velocity[i]) / h, h))
        if not whole:
            if h <= SHORTEST * sample_time:
                return 0.0
            error = np.inf
        longer = _next_length(h, error)
        if error <= 1.0 or h <= SHORTEST * sample_time:
            finite = True
            for i in range(n):
                position[i] = two_q[i] + (two_q[i] - one_q[i]) / 15
                velocity[i] = two_v[i] + (two_v[i] - one_v[i]) / 15
                finite &= abs(position[i]) < np.inf and abs(velocity[i]) < np.inf
            left = 0.0 if last else left - h
            if not finite:
                break
        h = min(sample_time, max(longer, SHORTEST * sample_time))
    return h
