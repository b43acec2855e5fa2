"""Many models of one machine, weighed by what each predicts: particles that wander.

Given its frequencies a machine is linear in states and gains together: each model has its exact Kalman filter.
"""

import numpy as np

from contest.nominal import Baseline, CompiledObserver, NominalModel, NominalNoise
from contest.parametric import (
    KNOBS,
    WIDEST,
    measure_in_turn,
    parts,
    predict,
)
from stillwork.base.algebra import copy_vector, inner_product, plus_column
from stillwork.base.kernels import inlined_kernel, kernel

PARTICLES = 16


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
        if len(z) * inner_product(weights, weights) > 2:  # fewer than half of them count
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


MULTI_MODEL = {
    "particles": Baseline(particles, KNOBS, "Doucet, de Freitas, Murphy and Russell 2000"),
}
