"""Machines whose frequencies and gains are in doubt: which of them, and their sampled modes inside kernels."""

import numpy as np

from experiments.motion.observer_contest.told import ToldModel
from stillwork.base.kernels import borrowing_kernel, kernel, pasted_kernel


def dominant(model: ToldModel, most: int) -> np.ndarray:
    """The flexible modes with the largest share in the static deflection, at most so many, in order of frequency."""
    rigid = model.rigid_modes
    shares = np.abs(model.output_shapes[:, rigid:]).max(axis=0) * np.abs(model.input_shapes[rigid:]).max(
        axis=1
    )
    shares = shares / model.frequencies[rigid:] ** 2
    return np.sort(np.argsort(-shares, kind="stable")[:most]) + rigid


@pasted_kernel
def predict_mode(a, b, force, i, x):
    """Position and velocity of one mode, at `i` and after it, one sample on: modes do not move each other."""
    first, second = x[i], x[i + 1]
    for r in range(i, i + 2):
        x[r] = a[r, i] * first + a[r, i + 1] * second
        for q in range(len(force)):
            x[r] += b[r, q] * force[q]


@borrowing_kernel
def sampled_mode(omega, damping, step, block, lever):
    """Transition of one mode over a step, 2 x 2, and what a unit force on it does, held over the step."""
    if omega == 0.0:
        block[0, 0] = block[1, 1] = 1.0
        block[0, 1], block[1, 0] = step, 0.0
        lever[0], lever[1] = step * step / 2, step
        return
    root = np.sqrt(1 - damping * damping)
    angle, decay = omega * root * step, np.exp(-damping * omega * step)
    sine, cosine = np.sin(angle), np.cos(angle)
    block[0, 0] = decay * (cosine + damping / root * sine)
    block[0, 1] = decay * sine / (omega * root)
    block[1, 0] = -decay * omega * sine / root
    block[1, 1] = decay * (cosine - damping / root * sine)
    lever[0] = (1 - block[0, 0]) / (omega * omega)
    lever[1] = block[0, 1]


@kernel
def propagate(a, by, p):
    """P = F P F' where F = (A, D; 0, I): blocks of 2 x 2 along A, and D, `by`, what constants beside the states do."""
    n, constants = by.shape
    for i in range(0, n, 2):
        for j in range(n + constants):
            first, second = p[i, j], p[i + 1, j]
            p[i, j] = a[i, i] * first + a[i, i + 1] * second
            p[i + 1, j] = a[i + 1, i] * first + a[i + 1, i + 1] * second
            for q in range(constants):
                p[i, j] += by[i, q] * p[n + q, j]
                p[i + 1, j] += by[i + 1, q] * p[n + q, j]
    for j in range(n + constants):
        for i in range(0, n, 2):
            first, second = p[j, i], p[j, i + 1]
            p[j, i] = a[i, i] * first + a[i, i + 1] * second
            p[j, i + 1] = a[i + 1, i] * first + a[i + 1, i + 1] * second
            for q in range(constants):
                p[j, i] += by[i, q] * p[j, n + q]
                p[j, i + 1] += by[i + 1, q] * p[j, n + q]
    for i in range(n + constants):  # what rounding leaves of asymmetry would grow where nothing forgets
        for j in range(i):
            p[i, j] = p[j, i] = (p[i, j] + p[j, i]) / 2
