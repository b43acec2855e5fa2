"""Model functions as a user would write them, in a file of their own."""

import math


def cart_acceleration(position, velocity, force, parameters):
    return (force - parameters[1] * math.tanh(velocity / 0.01)) / parameters[0]


def cart_force(position, velocity, acceleration, parameters):
    return parameters[0] * acceleration + parameters[1] * math.tanh(velocity / 0.01)
