"""A slow, obvious twin of the simulation in the robust comparison."""

import numpy as np


def scan(a, b, shapes, reference, forward, control, noise):
    """One scan with matrix products: plant, sampled controller, feedforward, noise (w, v, d)."""
    x, z = np.zeros(a.shape[0]), np.zeros(control.a.shape[0])
    states, u, y = [], [], []
    for k in range(len(reference)):
        w, v, d = noise[:, k]
        output = shapes[k] @ x[::2] - v + d
        force = (control.c @ z)[0] + forward[k]
        states.append(x)
        u.append(force)
        y.append(output)
        z = control.a @ z + control.b[:, 0] * (reference[k] - output)
        x = a @ x + b[:, 0] * (force + w)
    return np.array(states).T, np.array(u), np.array(y)
