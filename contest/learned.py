"""A small learned filter: a network sees the innovations of four filters and weighs them; trained on the development set.

`contest.training` makes its weights, ``data/motion/contest_learned.csv``.
"""

from functools import cache

import numpy as np

from contest.fixed_gain import fictitious, stationary
from contest.nominal import Baseline, CompiledObserver, NominalModel, NominalNoise
from contest.parametric import predict_modes
from stillwork.base.algebra import minus_row, plus_column, plus_row
from stillwork.base.kernels import kernel
from workbook import paths

FORCES = (1.0, 10.0, 100.0)  # fictitious forces over w of the filters that are mixed with the Kalman filter
FEATURES, HIDDEN = 4 + len(FORCES) + 1, 6
SIZE = HIDDEN * (FEATURES + len(FORCES) + 2)  # weights of both layers
FAST, SLOW = 0.2, 0.02  # rates of the means over innovations, a sample
FILE = paths.data("motion", "contest_learned.csv")


@kernel
def _advance_learned(data, memory, inputs, measurements, estimates):
    a, b, c, gains, sizes, first, second = data
    x, slow, fast, before, shares = memory
    outputs, n, hidden, filters = len(c), a.shape[0], len(first), len(gains)
    innovations, seen = np.empty((filters, outputs)), np.empty(first.shape[1])
    inner = np.empty(hidden)
    for k in range(len(inputs)):
        now, turned = np.zeros(filters), 0.0
        for m in range(filters):
            predict_modes(a, b, inputs[k], x[m])
            for o in range(outputs):
                innovations[m, o] = minus_row(measurements[k, o], c, o, x[m])
                now[m] += (innovations[m, o] / sizes[o]) ** 2 / outputs
        if not np.isnan(measurements[k, 0]):
            for o in range(outputs):
                turned += innovations[0, o] * before[o] / sizes[o] ** 2 / outputs
                before[o] = innovations[0, o]
            fast[0] += FAST * (now[0] - fast[0])
            fast[1] += SLOW * (turned - fast[1])
            for m in range(filters):
                slow[m] += SLOW * (now[m] - slow[m])
                seen[m] = np.log(slow[m] + 1e-3) / 4
            seen[filters] = np.log(fast[0] / (slow[0] + 1e-9) + 1e-3) / 4
            seen[filters + 1] = np.log(now[0] / (slow[0] + 1e-9) + 1e-3) / 4
            seen[filters + 2] = fast[1] / (slow[0] + 1e-9)
            seen[filters + 3] = 1.0
            for h in range(hidden):
                inner[h] = np.tanh(plus_row(0.0, first, h, seen))
            total = 0.0
            for m in range(filters):
                shares[m] = np.exp(plus_row(-4.0 * m, second, m, inner))  # begins near the Kalman filter
                total += shares[m]
            # The last output weights the innovation, less where it is an outlier.
            trust = 1 / (1 + np.exp(-3 - plus_row(0.0, second, filters, inner)))
            for m in range(filters):
                shares[m] /= total
                for i in range(n):
                    for o in range(outputs):
                        x[m, i] += trust * gains[m, i, o] * innovations[m, o]
        for i in range(n):
            estimates[k, i] = plus_column(0.0, x, i, shares)


def with_weights(
    weights: np.ndarray, model: NominalModel, noise: NominalNoise, sample_time: float
) -> CompiledObserver:
    """The filter of these weights: those of the first layer, row by row, then of the second."""
    usual, after = stationary(model, noise)
    gains = [usual, *(fictitious(model, noise, sample_time, force).data[2] for force in FORCES)]
    before = model.a @ after @ model.a.T + model.b @ noise.process @ model.b.T
    sizes = np.sqrt(np.diag(model.c @ before @ model.c.T + noise.sensor))
    first, second = np.split(weights, [HIDDEN * FEATURES])
    shapes = first.reshape(HIDDEN, FEATURES).copy(), second.reshape(-1, HIDDEN).copy()
    count = len(gains)
    memory = (
        np.zeros((count, len(model.a))),
        np.ones(count),
        np.array([1.0, 0.0]),
        np.zeros(len(model.c)),
        np.full(count, 1 / count),
    )
    return CompiledObserver(
        _advance_learned, (model.a, model.b, model.c, np.array(gains), sizes, *shapes), memory
    )


@cache
def _trained() -> np.ndarray:
    return np.loadtxt(FILE)


def learned(model: NominalModel, noise: NominalNoise, sample_time: float) -> CompiledObserver:
    """The filter as it was trained."""
    return with_weights(_trained(), model, noise, sample_time)


LEARNED = {"learned": Baseline(learned, (), "a small network after Revach and others 2022, KalmanNet")}
