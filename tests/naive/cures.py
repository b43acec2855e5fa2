"""Slow, obvious twin of the smallest closed loop with a cure, in plain numpy."""

import numpy as np
from scipy import signal

from naive.adaptation import limited


def closed_loop(cure, floor, optimum, integrator, shaping, start, forgetting, growth):
    """Weights, covariance and error of every sample; the filters run over the whole past each time."""
    sensors, samples = floor.shape
    n = len(start)
    stack = [floor]
    while len(stack) < n // sensors:
        stack.append(signal.sosfilt(integrator, stack[-1], axis=-1))
    psi = np.concatenate(stack)
    shaped = signal.sosfilt(shaping, psi, axis=-1)
    weights, p = np.zeros(n), np.diag(start)
    before, history, errors = [], [], []
    arriving = 0.0
    for k in range(samples):
        before.append(arriving)
        e = signal.sosfilt(shaping, before)[-1]
        arriving = (weights - optimum) @ psi[:, k]
        x = shaped[:, k]
        share = 1.0 if cure == "no forgetting" else forgetting
        p = np.linalg.inv(share * np.linalg.inv(p) + np.outer(x, x))
        weights = weights - e * p @ x
        if cure == "leakage":
            axis = np.eye(n)[k % n]
            amount = n * (1 - forgetting) / (growth * start[k % n])
            p = np.linalg.inv(np.linalg.inv(p) + amount * np.outer(axis, axis))
        elif cure == "limit":
            p = limited(p, growth * start)
        errors.append(e)
        history.append((weights, p))
    return history, np.array(errors)
