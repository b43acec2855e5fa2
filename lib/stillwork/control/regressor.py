"""The regressor of a mechanism that is linear in its parameters: its forces, a column for each parameter."""

import numpy as np

from stillwork.base.kernels import borrowing_kernel

ROOM = 6  # vectors that `fill_regressor` uses, beside the inertia


@borrowing_kernel
def fill_regressor(inertia, bias, units, position, velocity, reference, acceleration, room, out):
    """out[:, j]: M_j acceleration + C_j(velocity) reference + g_j + friction_j(velocity) of a mechanism's j-th parameter.

    units: a row for each parameter, 1 at it. What is even in the velocity is weight and C(v) v, and C(v) w of Christoffel's
    symbols, symmetric in v and w, follows from it: ((v + w)^2 - (v - w)^2) / 4. What is odd is friction. `room`: workspace, (n + ROOM, n).
    """
    n = len(position)
    matrix, speed, there, back, part = room[:n], room[n], room[n + 1], room[n + 2], room[n + 3]
    for j in range(len(units)):
        inertia(position, units[j], matrix)
        for i in range(n):
            part[i], speed[i] = 0.0, 0.0
            for k in range(n):
                part[i] += matrix[i, k] * acceleration[k]
        bias(position, speed, units[j], there)  # weight
        for i in range(n):
            part[i] += there[i]
        for sign in (1.0, -1.0, 0.0):  # v + w, v - w, v
            for i in range(n):
                speed[i] = velocity[i] + sign * reference[i]
            bias(position, speed, units[j], there)
            for i in range(n):
                speed[i] = -speed[i]
            bias(position, speed, units[j], back)
            for i in range(n):
                if sign == 0.0:
                    part[i] += (there[i] - back[i]) / 2.0
                else:
                    part[i] += sign * (there[i] + back[i]) / 8.0
        for i in range(n):
            out[i, j] = part[i]


def regressor_at(mechanism, *motion):
    n, count = mechanism.coordinates, len(mechanism.parameters)
    out = np.zeros((n, count))
    fill_regressor(*mechanism.compiled[:2], np.eye(count), *motion, np.zeros((n + ROOM, n)), out)
    return out
