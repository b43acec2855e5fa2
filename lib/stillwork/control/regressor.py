"""The regressor of a mechanism that is linear in its parameters: its forces, a column for each parameter."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import require_array
from stillwork.base.kernels import borrowing_kernel
from stillwork.base.validation import checked
from stillwork.control.mechanism import Mechanism

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


@checked
def regressor(
    mechanism: Mechanism,
    position: ArrayLike,
    velocity: ArrayLike,
    reference: ArrayLike,
    acceleration: ArrayLike,
) -> Float64[np.ndarray, "coordinates parameters"]:
    """Y of M(q) a + C(q, v) w + g(q) + friction(v) = Y p, a column for each parameter of a mechanism that is linear in them.

    Parameters
    ----------
    mechanism : Mechanism
        Linear in its parameters p; friction is the part odd in the velocity.
    position, velocity, reference, acceleration : array_like, shape (coordinates,)
        q, v, w and a; with w = v the result is the force for the acceleration a. C is that of Christoffel's symbols: M' - 2 C is skew.

    Returns
    -------
    ndarray, shape (coordinates, parameters)

    Raises
    ------
    InputError
        When there is not one of each for every coordinate.

    References
    ----------
    Slotine and Li, Applied Nonlinear Control (1991), section 9.2.

    Examples
    --------
    >>> def inertia(position, parameters, out):
    ...     out[:] = parameters[0]
    >>> def bias(position, velocity, parameters, out):
    ...     out[:] = parameters[1] * velocity
    >>> cart = control.Mechanism(inertia, bias, 1, [2.0, 0.5])  # kg, N s/m
    >>> control.regressor(cart, [0.0], [3.0], [3.0], [1.0])
    array([[1., 3.]])
    """
    n = mechanism.coordinates
    given = [
        require_array(name, each, shape=(n,))
        for name, each in (
            ("position", position),
            ("velocity", velocity),
            ("reference", reference),
            ("acceleration", acceleration),
        )
    ]
    return regressor_at(mechanism, *map(np.ascontiguousarray, given))


def regressor_at(mechanism, *motion):
    n, count = mechanism.coordinates, len(mechanism.parameters)
    out = np.zeros((n, count))
    fill_regressor(*mechanism.compiled[:2], np.eye(count), *motion, np.zeros((n + ROOM, n)), out)
    return out
