"""The entrant whose noises are bounded: a set that holds every state which the bounds allow."""

import numpy as np

from contest.fixed_gain import stationary
from contest.nominal import Baseline, CompiledObserver, NominalModel, NominalNoise, TuningParameter
from contest.parametric import predict_modes, propagate
from stillwork.base.algebra import copy_vector, measure, minus_row
from stillwork.base.kernels import kernel

MET = 0.9  # innovation over the reach of ellipsoid and bound together, at which they count as meeting


@kernel
def _advance_sets(data, memory, inputs, measurements, estimates):
    a, b, c, bounds, added, units = data
    x, p = memory
    n = len(x)
    cross, alone = np.empty(n), np.empty((n, 0))
    for k in range(len(inputs)):
        predict_modes(a, b, inputs[k], x)
        propagate(a, alone, p)
        # The sum of two ellipsoids lies in one; this weight gives it the least trace, in the states' units.
        own, other = 0.0, 0.0
        for i in range(n):
            own += p[i, i] / units[i] ** 2
            other += added[i, i] / units[i] ** 2
        weight = np.sqrt(other / own)
        for i in range(n):
            for j in range(n):
                p[i, j] = (1 + weight) * p[i, j] + (1 + 1 / weight) * added[i, j]
        if not np.isnan(measurements[k, 0]):
            for o in range(len(c)):
                spread = measure(p, c, o, 0.0, cross)
                _cut(x, p, cross, minus_row(measurements[k, o], c, o, x), spread, bounds[o] ** 2)
        copy_vector(x, estimates[k])


@kernel
def _cut(x, p, cross, innovation, spread, bound):
    # The ellipsoid of least volume around what the strip |y - c x|^2 <= bound leaves of the last one.
    n = len(x)
    reach = np.sqrt(bound) + np.sqrt(spread)
    if abs(innovation) > MET * reach:  # ellipsoid and strip hardly meet: the bounds are broken, so widen it
        wider = ((abs(innovation) / MET - np.sqrt(bound)) / np.sqrt(spread)) ** 2
        for i in range(n):
            cross[i] *= wider
            for j in range(n):
                p[i, j] *= wider
        spread *= wider
    excess = bound - innovation * innovation
    second = (n - 1) * spread * spread
    first = ((2 * n - 1) * bound - spread + innovation * innovation) * spread
    constant = (n * excess - spread) * bound
    root = first * first - 4 * second * constant
    if constant >= 0 or root < 0:
        return  # the strip cuts nothing off that would pay
    share = (np.sqrt(root) - first) / (2 * second)
    variance = bound + share * spread
    size = 1 + share - share * innovation * innovation / variance
    for i in range(n):
        x[i] += share * cross[i] * innovation / variance
        for j in range(n):
            p[i, j] = size * (p[i, j] - share * cross[i] * cross[j] / variance)


def set_membership(
    model: NominalModel, noise: NominalNoise, sample_time: float, sensor: float, process: float
) -> CompiledObserver:
    """Ellipsoids that hold every state the bounds allow: so many deviations of the sensor, and of the force."""
    after = stationary(model, noise)[1]
    bounds, added = sensor * np.sqrt(np.diag(noise.sensor)), process**2 * model.b @ noise.process @ model.b.T
    data = (model.a, model.b, model.c, bounds, added, np.sqrt(np.diag(after)))
    return CompiledObserver(_advance_sets, data, (np.zeros(len(model.a)), sensor**2 * after))


SET_MEMBERSHIP = {
    "set membership": Baseline(
        set_membership,
        (
            TuningParameter("bound of the sensor over its deviation", 1.0, 10.0, 3.0),
            TuningParameter("bound of w over its own", 1.0, 1e4, 10.0),
        ),
        "Fogel and Huang 1982; Schweppe 1968",
    ),
}
