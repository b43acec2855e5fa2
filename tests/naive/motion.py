"""Slow, obvious twins of what the motion topic and the linear models compute fast."""

from fractions import Fraction

import numpy as np


def exponential(a, b, sample_time):
    """Zero-order hold exp([A B; 0 0] T) in fixed-point arithmetic of 400 binary places."""
    places, halvings = 400, 30
    n, m = b.shape
    whole = np.zeros((n + m, n + m), dtype=object)
    for (i, j), value in np.ndenumerate(np.hstack([a, b])):
        whole[i, j] = int(Fraction(float(value)) * Fraction(sample_time) * 2 ** (places - halvings))
    one = np.array([[int(i == j) << places for j in range(n + m)] for i in range(n + m)], dtype=object)
    total, term = one, one
    for k in range(1, 30):
        term = (term @ whole >> places) // k
        total = total + term
    for _ in range(halvings):
        total = total @ total >> places
    full = np.array([[float(Fraction(int(value), 2**places)) for value in row] for row in total])
    return full[:n, :n], full[:n, n:]


def step_by_step(a, b, c, d, inputs, initial):
    """x <- A x + B u, one sample after the other."""
    x, outputs = initial.copy(), []
    for u in inputs.T:
        outputs.append(c @ x + d @ u)
        x = a @ x + b @ u
    return np.array(outputs).T


def moving_windows(error, width):
    """Mean and standard deviation of every window."""
    windows = [error[k : k + width] for k in range(len(error) - width + 1)]
    return np.array([w.mean() for w in windows]), np.array([w.std() for w in windows])
