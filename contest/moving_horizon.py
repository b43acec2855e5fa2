"""Moving horizon with arrival cost: least squares over the last samples, with Huber's loss on the measurements."""

import numpy as np

from contest.fixed_gain import stationary
from contest.nominal import Baseline, CompiledObserver, NominalModel, NominalNoise, TuningParameter
from contest.parametric import predict_modes
from stillwork.base.algebra import cholesky_root, cholesky_solve, copy_vector, minus_row, plus_row
from stillwork.base.kernels import kernel

HORIZON = 15  # samples
ROUNDS = 3  # of reweighting
UNSEEN = 1e-12  # weight of a lost measurement


@kernel
def _advance_window(data, memory, inputs, measurements, estimates):
    a, b, c, spread, sensor, cross, threshold = data
    forces, seen, past, count = memory
    horizon, outputs, n = len(forces), len(c), a.shape[0]
    size = horizon * outputs
    x, residual, solved, weights = np.empty(n), np.empty(size), np.empty(size), np.empty(size)
    joint, root = np.empty((size, size)), np.zeros((size, size))
    for k in range(len(inputs)):
        place = count[0] % horizon
        copy_vector(past[place], x)  # the estimate so many samples ago, before which all rested
        copy_vector(inputs[k], forces[place])
        copy_vector(measurements[k], seen[place])
        for back in range(horizon):
            at = (count[0] + 1 + back) % horizon
            predict_modes(a, b, forces[at], x)
            for o in range(outputs):
                i = back * outputs + o
                lost = np.isnan(seen[at, o])
                residual[i] = 0.0 if lost else minus_row(seen[at, o], c, o, x)
                weights[i] = UNSEEN if lost else 1.0
        for _ in range(ROUNDS):
            for i in range(size):
                for j in range(size):
                    joint[i, j] = spread[i, j]
                joint[i, i] += sensor[i % outputs] / weights[i]
            if not cholesky_root(joint, root, size):
                break
            cholesky_solve(root, residual, solved)
            changed = False
            for i in range(size):
                if weights[i] > UNSEEN:
                    # What the fit leaves of the measurement, in its deviations.
                    off = abs(solved[i]) * np.sqrt(sensor[i % outputs]) / weights[i]
                    weight = min(1.0, threshold[0] / max(off, 1e-300))
                    changed = changed or abs(weight - weights[i]) > 1e-3 * weights[i]
                    weights[i] = max(weight, 2 * UNSEEN)
            if not changed:
                break
        for i in range(n):
            x[i] = plus_row(x[i], cross, i, solved)
        copy_vector(x, past[place])
        copy_vector(x, estimates[k])
        count[0] += 1


def moving_horizon(
    model: NominalModel, noise: NominalNoise, sample_time: float, threshold: float, factor: float
) -> CompiledObserver:
    """Least squares over a window after a prior, Huber's loss from `threshold` deviations on, Q times `factor`.

    The prior is the estimate before the window, with the stationary covariance: the arrival cost. With no outlier it is
    the Kalman filter. A lost sample weighs nothing.
    """
    fair = NominalNoise(factor * noise.process, noise.sensor)
    n, outputs = len(model.a), len(model.c)
    # Covariances of the window's outputs and of its last state with them.
    state = stationary(model, fair)[1]
    added = model.b @ fair.process @ model.b.T
    size = HORIZON * outputs
    spread, cross = np.zeros((size, size)), np.zeros((n, size))
    for k in range(HORIZON):
        own = slice(k * outputs, (k + 1) * outputs)
        state = model.a @ state @ model.a.T + added
        cross = model.a @ cross
        cross[:, own] = state @ model.c.T
        rows = model.c @ cross[:, : own.stop]
        spread[own, : own.stop] = rows
        spread[: own.stop, own] = rows.T
    data = (model.a, model.b, model.c, spread, np.diag(noise.sensor).copy(), cross, np.array([threshold]))
    shapes = ((HORIZON, model.b.shape[1]), (HORIZON, outputs), (HORIZON, n))
    return CompiledObserver(_advance_window, data, (*map(np.zeros, shapes), np.zeros(1, np.int64)))


MOVING = {
    "moving horizon": Baseline(
        moving_horizon,
        (
            TuningParameter("Huber's threshold", 1.0, 100.0, 3.0),
            TuningParameter("factor on Q", 1.0, 1e6, 50.0),
        ),
        "Rao, Rawlings and Lee 2001, with arrival cost; Huber 1964",
    ),
}
