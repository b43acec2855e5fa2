"""A planar arm with two links and a motor in each joint, as a template for a plant with several coordinates.

q1 is the angle of the first link from the horizontal, q2 that of the second from the first, in rad; the motors give
torques in N m. The dynamics M(q) q'' + h(q, q') = u are those of M. W. Spong, S. Hutchinson, M. Vidyasagar, "Robot
Modeling and Control", Wiley 2006, section 7.4 (planar elbow manipulator), with friction added:

    M11 = m1 c1^2 + m2 (l1^2 + c2^2 + 2 l1 c2 cos q2) + I1 + I2,  M12 = m2 (c2^2 + l1 c2 cos q2) + I2,  M22 = m2 c2^2 + I2
    h1  = -s (2 q1' q2' + q2'^2) + g (m1 c1 + m2 l1) cos q1 + m2 c2 g cos(q1 + q2) + d1 q1' + f1 tanh(q1' / v)
    h2  = s q1'^2 + m2 c2 g cos(q1 + q2) + d2 q2' + f2 tanh(q2' / v),  s = m2 l1 c2 sin q2

The masses and lengths are made up. The controller believes in other masses, and knows nothing of the load at the tip,
which is in m2, c2 and I2, nor of the dry friction.

UNITS names the unit of each coordinate, m or rad. Both functions fill their last argument. They are compiled: use
numbers, loops, `math` and `numpy`, and take every constant from `parameters`, which holds the values of EXACT or
APPROXIMATE in their order. Where the approximate model has another form, write it as `approximate_inertia` and
`approximate_bias`.
"""

import math

UNITS = ("rad", "rad")
EXACT = {  # the plant
    "m1": 3.0,  # kg
    "c1": 0.20,  # m, from the joint to the link's centre of mass
    "I1": 0.040,  # kg m^2, about that centre
    "l1": 0.40,  # m
    "m2": 2.5,
    "c2": 0.22,
    "I2": 0.045,
    "g": 9.81,  # m/s^2; 0 for an arm that lies flat
    "d1": 0.4,  # N m s
    "d2": 0.2,
    "f1": 0.8,  # N m
    "f2": 0.3,
    "v": 0.01,  # rad/s
}
APPROXIMATE = {  # what the controller knows
    "m1": 3.5,
    "c1": 0.20,
    "I1": 0.050,
    "l1": 0.40,
    "m2": 2.0,
    "c2": 0.18,
    "I2": 0.020,
    "g": 9.81,
    "d1": 0.3,
    "d2": 0.3,
    "f1": 0.0,
    "f2": 0.0,
    "v": 0.01,
}


def inertia(position, parameters, out):
    """M(q), kg m^2."""
    m1, c1, i1, l1, m2, c2, i2 = parameters[:7]
    reach = l1 * c2 * math.cos(position[1])
    out[0, 0] = m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * reach) + i1 + i2
    out[0, 1] = m2 * (c2**2 + reach) + i2
    out[1, 0] = out[0, 1]
    out[1, 1] = m2 * c2**2 + i2


def bias(position, velocity, parameters, out):
    """h(q, q'), N m: Coriolis and centrifugal torques, weight, friction."""
    m1, c1, l1, m2, c2 = parameters[0], parameters[1], parameters[3], parameters[4], parameters[5]
    s = m2 * l1 * c2 * math.sin(position[1])
    weight = parameters[7] * m2 * c2 * math.cos(position[0] + position[1])
    out[0] = -s * velocity[1] * (2 * velocity[0] + velocity[1]) + weight
    out[0] += parameters[7] * (m1 * c1 + m2 * l1) * math.cos(position[0])
    out[1] = s * velocity[0] ** 2 + weight
    for joint in range(2):
        out[joint] += parameters[8 + joint] * velocity[joint]
        out[joint] += parameters[10 + joint] * math.tanh(velocity[joint] / parameters[12])
