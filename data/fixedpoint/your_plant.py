"""A table whose mass grows with its position, as a template for a plant of your own.

A carriage of mass m0 drives a load through a lever, so that the mass it feels grows with its position q:
(m0 + m1 q^2) q'' + m1 q q'^2 + k q + c q' + f tanh(q' / v) = u. The controller believes in a constant mass and
knows nothing of the dry friction. All in SI units: m, m/s, m/s^2, N.

Give two functions, each the inverse of the other. They are compiled: use numbers, loops, `math` and `numpy`, and
take every constant from `parameters`, which holds the values of EXACT or APPROXIMATE in their order. Where the
approximate model has another form, write it as `approximate_acceleration` and `approximate_force`.
"""

import math

EXACT = {  # the plant
    "m0": 1.0,  # kg
    "m1": 1.5,  # kg/m^2
    "k": 60.0,  # N/m
    "c": 2.0,  # N s/m
    "f": 1.0,  # N
    "v": 0.01,  # m/s
}
APPROXIMATE = {  # what the controller and the Kalman filter know
    "m0": 1.4,
    "m1": 0.0,
    "k": 80.0,
    "c": 1.0,
    "f": 0.0,
    "v": 0.01,
}


def acceleration(position, velocity, force, parameters):
    """m/s^2 that the force gives."""
    mass = parameters[0] + parameters[1] * position**2
    resistance = parameters[1] * position * velocity**2 + parameters[2] * position + parameters[3] * velocity
    resistance += parameters[4] * math.tanh(velocity / parameters[5])
    return (force - resistance) / mass


def force(position, velocity, acceleration, parameters):
    """N that the acceleration takes."""
    mass = parameters[0] + parameters[1] * position**2
    resistance = parameters[1] * position * velocity**2 + parameters[2] * position + parameters[3] * velocity
    resistance += parameters[4] * math.tanh(velocity / parameters[5])
    return mass * acceleration + resistance
