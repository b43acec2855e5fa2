"""Carts on springs that do not touch: a mass each, a spring and a drag, as functions of one and of several coordinates."""


def cart_inertia(position, parameters, out):
    for i in range(len(position)):
        for j in range(len(position)):
            out[i, j] = parameters[0] * (i == j)


def cart_bias(position, velocity, parameters, out):
    for i in range(len(position)):
        out[i] = parameters[1] * position[i] + parameters[2] * velocity[i] * abs(velocity[i])


def cart_acceleration(position, velocity, force, parameters):
    return (force - parameters[1] * position - parameters[2] * velocity * abs(velocity)) / parameters[0]


def cart_force(position, velocity, acceleration, parameters):
    return parameters[0] * acceleration + parameters[1] * position + parameters[2] * velocity * abs(velocity)
