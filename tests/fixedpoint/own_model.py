"""Model functions as a user would write them, in a file of their own."""

import math


def pendulum(state, inputs, parameters, out):
    """x = [angle, rate], semi-implicit; parameters: time step, g / l, damping."""
    step, pull, damping = parameters[0], parameters[1], parameters[2]
    out[1] = state[1] + step * (inputs[0] - pull * math.sin(state[0]) - damping * state[1])
    out[0] = state[0] + step * out[1]


def seen(state, inputs, parameters, out):
    out[0] = math.sin(state[0])


def three_masses(state, inputs, parameters, out):
    """Linear: x+ = A x + B u with A (9) and B (3) in the parameters."""
    for i in range(3):
        out[i] = parameters[9 + i] * inputs[0]
        for j in range(3):
            out[i] += parameters[3 * i + j] * state[j]


def two_sums(state, inputs, parameters, out):
    out[0] = state[0] + 0.5 * state[2]
    out[1] = state[1] - state[2]


def cart_acceleration(position, velocity, force, parameters):
    return (force - parameters[1] * math.tanh(velocity / 0.01)) / parameters[0]


def cart_force(position, velocity, acceleration, parameters):
    return parameters[0] * acceleration + parameters[1] * math.tanh(velocity / 0.01)
