"""Many models of one machine, weighed by what each predicts: banks that mix or do not, and particles that wander.

Given its frequencies a machine is linear in states and gains together: each model has its exact Kalman filter. Only
the fine bank takes the gains as told, so that its filters stand still from the start.
"""

import numpy as np

from contest.nominal import Baseline, CompiledObserver, NominalModel, NominalNoise, TuningParameter
from contest.parametric import (
    KNOBS,
    WIDEST,
    dominant,
    measure_in_turn,
    parts,
    predict,
    predict_modes,
    sampled_mode,
)
from stillwork.base.algebra import add_product, copy_vector, minus_row, plus_column, plus_row
from stillwork.base.kernels import inlined_kernel, kernel
from stillwork.estimation.riccati import discrete_gain

GRID, FINE = (9, 3), (11, 5)  # models along the frequencies of the first and second mode in doubt
PARTICLES = 24


@inlined_kernel
def _filter_all(force, measured, data, omegas, z, p, scores, a, by):
    """One sample of every model's filter; its score grows by the logarithm of the measurement's density."""
    for m in range(len(omegas)):
        predict(force, data, omegas[m], z[m], p[m], a, by)
        if not np.isnan(measured[0]):
            scores[m] += measure_in_turn(z[m], p[m], data[8], data[9], measured, 0)


@kernel
def _weigh(scores, weights, z, estimate):
    """Turn scores into weights that sum to one; the estimate is the weighted mean."""
    best, total = scores[0], 0.0
    for m in range(len(scores)):
        best = max(best, scores[m])
    for m in range(len(scores)):
        weights[m] = np.exp(scores[m] - best)
        total += weights[m]
    for m in range(len(scores)):
        weights[m] /= total
    for i in range(len(estimate)):
        estimate[i] = plus_column(0.0, z, i, weights)


@kernel
def _mix(switching, weights, z, p, scores, mean, spread):
    """Every model begins with what it holds if the machine switched to it: the moments of a mixture."""
    models, size = z.shape
    leaving = switching / max(models - 1, 1)
    spread[:] = 0.0
    for i in range(size):
        mean[i] = plus_column(0.0, z, i, weights)
    for m in range(models):
        for i in range(size):
            for j in range(size):
                spread[i, j] += weights[m] * (p[m, i, j] + (z[m, i] - mean[i]) * (z[m, j] - mean[j]))
    for m in range(models):
        stays = (1 - switching - leaving if models > 1 else 1.0) * weights[m]
        own = stays / (stays + leaving)
        scores[m] = np.log(stays + leaving)
        for i in range(size):
            for j in range(size):
                apart = (z[m, i] - mean[i]) * (z[m, j] - mean[j])
                p[m, i, j] = own * p[m, i, j] + (1 - own) * (spread[i, j] + own * apart)
        for i in range(size):
            z[m, i] = own * z[m, i] + (1 - own) * mean[i]


@kernel
def _advance_bank(data, memory, inputs, measurements, estimates):
    filters, omegas, switching = data[:11], data[11], data[12]
    z, p, weights = memory
    n, size = estimates.shape[1], z.shape[1]
    a, by = data[0].copy(), np.zeros((n, size - n))
    mean, spread, scores = np.empty(size), np.empty((size, size)), np.empty(len(z))
    for k in range(len(inputs)):
        _mix(switching[0], weights, z, p, scores, mean, spread)
        _filter_all(inputs[k], measurements[k], filters, omegas, z, p, scores, a, by)
        _weigh(scores, weights, z, estimates[k])


def _grid(model: NominalModel, spread: float, points: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Two modes, or the only one, and the relative errors of their frequencies in each model."""
    bent = dominant(model, 2)
    axes = [spread * np.linspace(-1, 1, count) for count in points[: len(bent)]]
    return bent, np.stack([each.ravel() for each in np.meshgrid(*axes, indexing="ij")], axis=1)


def bank(
    model: NominalModel,
    noise: NominalNoise,
    sample_time: float,
    spread: float,
    switching: float,
    factor: float,
) -> CompiledObserver:
    """Interacting multiple models: frequencies off by up to `spread`, gains by as much in deviation, Q times `factor`."""
    data, (z, p) = parts(model, noise, sample_time, spread, 0.0, factor, frequencies=False)
    bent, grid = _grid(model, spread, GRID)
    count, omegas = len(grid), np.tile(data[3], (len(grid), 1))
    omegas[:, np.searchsorted(data[2], bent)] *= 1 + grid
    memory = (np.tile(z, (count, 1)), np.tile(p, (count, 1, 1)), np.full(count, 1 / count))
    return CompiledObserver(_advance_bank, (*data, omegas, np.array([switching])), memory)


@kernel
def _advance_fine(data, memory, inputs, measurements, estimates):
    a, b, c, gain, whitening, logs, switching = data
    z, weights = memory
    models, outputs = len(z), len(c)
    innovation, scores = np.empty(outputs), np.empty(models)
    for k in range(len(inputs)):
        for m in range(models):
            predict_modes(a[m], b[m], inputs[k], z[m])
            scores[m] = np.log((1 - switching[0]) * weights[m] + switching[0] / models)
            if np.isnan(measurements[k, 0]):
                continue
            for o in range(outputs):
                innovation[o] = minus_row(measurements[k, o], c, o, z[m])
            scores[m] -= logs[m]
            for o in range(outputs):
                white = plus_row(0.0, whitening[m], o, innovation)
                scores[m] -= white * white / 2
            add_product(gain[m], innovation, z[m])
        _weigh(scores, weights, z, estimates[k])


def fine_bank(
    model: NominalModel,
    noise: NominalNoise,
    sample_time: float,
    spread: float,
    switching: float,
    factor: float,
) -> CompiledObserver:
    """Stationary Kalman filters side by side, Q times `factor`; only their beliefs leak into each other."""
    bent, grid = _grid(model, spread, FINE)
    a, b = (np.tile(x, (len(grid), 1, 1)) for x in (model.a, model.b))
    gains, whitening, block, lever = [], [], np.empty((2, 2)), np.empty(2)
    for own_a, own_b, errors in zip(a, b, grid, strict=True):
        for mode, error in zip(bent, errors, strict=True):
            pair = slice(2 * mode, 2 * mode + 2)
            omega = model.frequencies[mode] * (1 + error)
            sampled_mode(omega, model.damping[mode], sample_time, block, lever)
            own_a[pair, pair], own_b[pair] = block, np.outer(lever, model.input_shapes[mode])
        solved = discrete_gain(own_a, own_b, model.c, factor * noise.process, noise.sensor)
        gains.append(solved.filter_gain)
        root = np.linalg.cholesky(model.c @ solved.covariance @ model.c.T + noise.sensor)
        whitening.append(np.tril(np.linalg.inv(root)))
    whitening = np.array(whitening)
    logs = -np.log(np.einsum("moo->mo", whitening)).sum(axis=1)
    data = (a, b, model.c, np.array(gains), whitening, logs, np.array([switching]))
    memory = (np.zeros((len(grid), len(model.a))), np.full(len(grid), 1 / len(grid)))
    return CompiledObserver(_advance_fine, data, memory)


@inlined_kernel
def _uniform(state):
    # xorshift64*: all that it remembers is `state`, so that a scan begun again is the same scan.
    word = state[0]
    word ^= word >> np.uint64(12)
    word ^= word << np.uint64(25)
    word ^= word >> np.uint64(27)
    state[0] = word
    return (float((word * np.uint64(2685821657736338717)) >> np.uint64(11)) + 0.5) / 9007199254740992.0


@kernel
def _normal(state):
    """A standard normal number, by Box and Muller."""
    size = np.sqrt(-2 * np.log(_uniform(state)))
    return size * np.cos(2 * np.pi * _uniform(state))


@kernel
def _resample(weights, scores, bent, z, p):
    """Put particles at even distances along the sum of their weights, each with what it holds."""
    count, chosen, passed = len(scores), 0, weights[0]
    old, states, covariances = bent.copy(), z.copy(), p.copy()
    for m in range(count):
        while passed < (m + 0.5) / count and chosen < count - 1:
            chosen += 1
            passed += weights[chosen]
        copy_vector(old[chosen], bent[m])
        copy_vector(states[chosen], z[m])
        for i in range(p.shape[1]):
            copy_vector(covariances[chosen, i], p[m, i])
    scores[:] = 0.0


@kernel
def _advance_particles(data, memory, inputs, measurements, estimates):
    filters, nominal, walk = data[:11], data[3], data[11][0]
    z, p, bent, scores, state = memory
    n, size = estimates.shape[1], z.shape[1]
    a, by = data[0].copy(), np.zeros((n, size - n))
    omegas, weights = np.empty(bent.shape), np.empty(len(z))
    for k in range(len(inputs)):
        for m in range(len(z)):
            for j in range(len(nominal)):
                bent[m, j] = min(max(bent[m, j] + walk * _normal(state), -WIDEST), WIDEST)
                omegas[m, j] = nominal[j] * (1 + bent[m, j])
        _filter_all(inputs[k], measurements[k], filters, omegas, z, p, scores, a, by)
        _weigh(scores, weights, z, estimates[k])
        scores -= scores.max()
        if len(z) * np.sum(weights * weights) > 2:  # fewer than half of them count
            _resample(weights, scores, bent, z, p)


def particles(
    model: NominalModel, noise: NominalNoise, sample_time: float, spread: float, walk: float, factor: float
) -> CompiledObserver:
    """Rao-Blackwellised particles: three frequencies walk, each particle has the exact filter of states and gains."""
    data, (z, p) = parts(model, noise, sample_time, spread, 0.0, factor, frequencies=False)
    bent = spread * np.random.default_rng(0).standard_normal((PARTICLES, len(data[3])))
    memory = (
        np.tile(z, (PARTICLES, 1)),
        np.tile(p, (PARTICLES, 1, 1)),
        np.clip(bent, -WIDEST, WIDEST),
        np.zeros(PARTICLES),
        np.array([88172645463325252], dtype=np.uint64),
    )
    return CompiledObserver(_advance_particles, (*data, np.array([walk])), memory)


GRID_KNOBS = (
    TuningParameter("spread of frequencies", 0.005, 0.2, 0.05),
    TuningParameter("probability of a switch a sample", 1e-6, 1e-2, 1e-3),
    TuningParameter("factor on Q", 1.0, 1e5, 50.0),
)
MULTI_MODEL = {
    "interacting models": Baseline(bank, GRID_KNOBS, "Blom and Bar-Shalom 1988", heavy=True),
    "bank of 55 models": Baseline(fine_bank, GRID_KNOBS, "Magill 1965; Maybeck 1982", heavy=True),
    "particles": Baseline(particles, KNOBS, "Doucet, de Freitas, Murphy and Russell 2000", heavy=True),
}
