"""Slow, obvious twins of the other filters in the robust comparison, and of its simulation."""

import numpy as np


def hinfinity(a, b, g, c, q, r, wanted, level, p, u, y):
    """A-posteriori H-infinity filter with inverse covariances, as in the literature."""
    n, samples = a.shape[0], len(c)
    x, states = np.zeros(n), np.zeros((n, samples))
    for k in range(1, samples):
        x = a @ x + b @ u[:, k - 1]
        inflated = np.linalg.inv(np.linalg.inv(p) - wanted.T @ wanted / level**2)
        assert np.linalg.eigvalsh(inflated)[0] > 0
        predicted = a @ inflated @ a.T + g @ q @ g.T
        p = np.linalg.inv(np.linalg.inv(predicted) + c[k].T @ np.linalg.inv(r) @ c[k])
        x = x + p @ c[k].T @ np.linalg.inv(r) @ (y[:, k] - c[k] @ x)
        states[:, k] = x
    return states


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
