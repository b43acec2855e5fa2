"""A bank of models of one machine, which mixes and is weighed by what each model predicts."""

import numpy as np

from experiments.motion.observer_contest.fixed_gain import stationary
from experiments.motion.observer_contest.modes import detuned, dominant
from experiments.motion.observer_contest.told import Knob, MadeObserver, Rival, ToldModel, ToldNoise
from stillwork.base.kernels import kernel

GRID = (11, 5)  # models along the frequencies of the first and second mode in doubt
SWITCHING = 1e-3  # probability that the machine changes model from one sample to the next


@kernel
def _advance_bank(data, memory, inputs, measurements, estimates):
    forward, onward, gain, c, whiten, logs, switching = data
    x, weights = memory
    models, n = x.shape
    outputs = c.shape[0]
    mixed, scores, innovation = np.empty((models, n)), np.empty(models), np.empty(outputs)
    leaving = switching[0] / max(models - 1, 1)
    staying = 1 - switching[0] if models > 1 else 1.0
    for k in range(len(inputs)):
        # Mixing: model j was model i a sample ago with probability `leaving`, was itself with `staying`.
        for i in range(n):
            total = 0.0
            for m in range(models):
                total += weights[m] * x[m, i]
            for m in range(models):
                before = (staying - leaving) * weights[m] * x[m, i] + leaving * total
                mixed[m, i] = before / ((staying - leaving) * weights[m] + leaving)
        best, present = -np.inf, not np.isnan(measurements[k, 0])
        for m in range(models):
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += forward[m, i, j] * mixed[m, j]
                for j in range(onward.shape[2]):
                    total += onward[m, i, j] * inputs[k, j]
                x[m, i] = total
            scores[m] = np.log((staying - leaving) * weights[m] + leaving)
            if present:
                for o in range(outputs):
                    total = measurements[k, o]
                    for i in range(n):
                        total -= c[o, i] * x[m, i]
                    innovation[o] = total
                scores[m] -= logs[m]
                for o in range(outputs):
                    total = 0.0
                    for j in range(o + 1):
                        total += whiten[m, o, j] * innovation[j]
                    scores[m] -= total * total / 2
                    for i in range(n):
                        x[m, i] += gain[m, i, o] * innovation[o]
            best = max(best, scores[m])
        total = 0.0
        for m in range(models):
            weights[m] = np.exp(scores[m] - best)
            total += weights[m]
        estimates[k] = 0.0
        for m in range(models):
            weights[m] /= total
            for i in range(n):
                estimates[k, i] += weights[m] * x[m, i]


def bank(
    model: ToldModel, noise: ToldNoise, sample_time: float, spread: float, factor: float
) -> MadeObserver:
    """Interacting multiple models with stationary gains: frequencies off by up to `spread`, Q times `factor`."""
    modes = dominant(model, 2)
    axes = [spread * np.linspace(-1, 1, points) for points in GRID[: len(modes)]]
    grid = np.stack([each.ravel() for each in np.meshgrid(*axes, indexing="ij")], axis=1)
    fair = ToldNoise(factor * noise.process, noise.sensor)
    parts = []
    for errors in grid:
        each = detuned(model, sample_time, modes, errors)
        gain, after = stationary(each, fair)
        before = each.a @ after @ each.a.T + each.b @ fair.process @ each.b.T
        root = np.linalg.cholesky(each.c @ before @ each.c.T + noise.sensor)
        parts.append((each.a, each.b, gain, np.linalg.inv(root), np.log(np.diag(root)).sum()))
    a, b, gain, whiten, logs = (np.array(each) for each in zip(*parts, strict=True))
    count = len(grid)
    data = (a, b, gain, np.ascontiguousarray(model.c), whiten, logs, np.array([SWITCHING]))
    return MadeObserver(_advance_bank, data, (np.zeros((count, len(model.a))), np.full(count, 1 / count)))


MULTI_MODEL = {
    "interacting models": Rival(
        bank,
        (Knob("spread of frequencies", 0.005, 0.2, 0.05), Knob("factor on Q", 1.0, 1e5, 50.0)),
        "Blom and Bar-Shalom 1988",
    ),
}
