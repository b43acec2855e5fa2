r"""Entrants that carry parameters beside the states: three frequencies, the rigid body's gain and two more, at most.

With :math:`z = (x, \theta)` the model is :math:`x_k = A(\theta) x_{k-1} + B(\theta) (u_{k-1} + w)`, and
:math:`\theta` walks: relative errors of the frequencies, then of the gains."""

import numpy as np
from scipy.linalg import block_diag

from contest.fixed_gain import stationary
from contest.nominal import Baseline, CompiledObserver, NominalModel, NominalNoise, TuningParameter
from stillwork.base.algebra import cholesky_root, minus_row, plus_row
from stillwork.base.kernels import borrowing_kernel, inlined_kernel, kernel, pasted_kernel


def dominant(model: NominalModel, most: int) -> np.ndarray:
    """The flexible modes with the largest share in the static deflection, at most so many, in order of frequency."""
    rigid = model.rigid_modes
    seen, pushed = np.abs(model.output_shapes[:, rigid:]), np.abs(model.input_shapes[rigid:])
    shares = seen.max(axis=0) * pushed.max(axis=1) / model.frequencies[rigid:] ** 2
    return np.sort(np.argsort(-shares, kind="stable")[:most]) + rigid


@pasted_kernel
def predict_mode(a, b, force, i, x):
    """Position and velocity of one mode, at `i` and after it, one sample on: modes do not move each other."""
    first, second = x[i], x[i + 1]
    for r in range(i, i + 2):
        x[r] = plus_row(a[r, i] * first + a[r, i + 1] * second, b, r, force)


@pasted_kernel
def predict_modes(a, b, force, x):
    """All states one sample on."""
    for i in range(0, len(x), 2):
        predict_mode(a, b, force, i, x)


@borrowing_kernel
def sampled_mode(omega, damping, sample_time, block, lever):
    """Transition of one mode over a sample, 2 x 2, and what a unit force on it does, held meanwhile."""
    if omega == 0.0:
        block[0, 0] = block[1, 1] = 1.0
        block[0, 1], block[1, 0] = sample_time, 0.0
        lever[0], lever[1] = sample_time * sample_time / 2, sample_time
        return
    root = np.sqrt(1 - damping * damping)
    angle, decay = omega * root * sample_time, np.exp(-damping * omega * sample_time)
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


NUDGE = 1e-5  # of a relative error, for a central difference of one mode's block
GATE_RATE = 0.02  # of the level of innovations, a sample
WIDEST = 0.5  # relative error at which a parameter is held


@pasted_kernel
def _uncertain(force, omega, damping, shapes, places, sample_time, z, j, block, lever):
    """Fill the transition of mode `j` of the uncertain ones; what pushes it, the same by its gain, its frequency's error."""
    push = plus_row(0.0, shapes, j, force)
    frequency, gain = places[j, 0], places[j, 1]
    bent = z[frequency] if frequency >= 0 else 0.0
    sampled_mode(omega[j] * (1 + bent), damping[j], sample_time, block, lever)
    return push, push * (1 + z[gain] if gain >= 0 else 1.0), bent


@kernel
def _move(force, data, points):
    """Take every z among these points one sample on without noise."""
    a, b, modes, omega, damping, shapes, places, settings = data[:8]
    n = len(a)
    block, lever = np.empty((2, 2)), np.empty(2)
    for s in range(len(points)):
        j = 0
        for i in range(0, n, 2):
            first, second = points[s, i], points[s, i + 1]
            if j == len(modes) or 2 * modes[j] != i:
                predict_mode(a, b, force, i, points[s])
                continue
            _, pushed, _ = _uncertain(
                force, omega, damping, shapes, places, settings[0], points[s], j, block, lever
            )
            for r in range(2):
                points[s, i + r] = block[r, 0] * first + block[r, 1] * second + lever[r] * pushed
            j += 1


@kernel
def measure_in_turn(z, p, c, sensor, measured, considered):
    """Take in the outputs one after the other; of the last `considered` states only the covariance is learnt.

    Returns the logarithm of their density, less a constant.
    """
    size, score = len(z), 0.0
    kept = size - considered
    cross, gain = np.empty(size), np.zeros(size)
    for o in range(len(c)):
        for i in range(size):
            cross[i] = plus_row(0.0, c, o, p[i])
        variance, innovation = plus_row(sensor[o], c, o, cross), minus_row(measured[o], c, o, z)
        score -= (innovation * innovation / variance + np.log(variance)) / 2
        for i in range(kept):
            gain[i] = cross[i] / variance
            z[i] += gain[i] * innovation
        for i in range(size):
            for j in range(i + 1):
                p[i, j] -= gain[i] * cross[j] + cross[i] * gain[j] - gain[i] * gain[j] * variance
                p[j, i] = p[i, j]
    return score


@kernel
def predict(force, data, omega, z, p, a, by):
    """Take z and P one sample on, the uncertain modes at these frequencies; A and D are filled on the way."""
    _, b, modes, _, damping, shapes, places, settings, _, _, added = data
    n = len(a)
    block, lever = np.empty((2, 2)), np.empty(2)
    blocks, levers = np.empty((2, 2, 2)), np.empty((2, 2))
    j = 0
    for i in range(0, n, 2):
        if j == len(modes) or 2 * modes[j] != i:
            predict_mode(a, b, force, i, z)
            continue
        first, second, frequency, gain = z[i], z[i + 1], places[j, 0], places[j, 1]
        push, pushed, bent = _uncertain(
            force, omega, damping, shapes, places, settings[0], z, j, block, lever
        )
        if frequency >= 0:
            for side in range(2):
                nudged = omega[j] * (1 + bent + (2 * side - 1) * NUDGE)
                sampled_mode(nudged, damping[j], settings[0], blocks[side], levers[side])
        for r in range(2):
            a[i + r, i], a[i + r, i + 1] = block[r, 0], block[r, 1]
            z[i + r] = block[r, 0] * first + block[r, 1] * second + lever[r] * pushed
            if frequency >= 0:
                moved = (levers[1, r] - levers[0, r]) * pushed
                moved += (blocks[1, r, 0] - blocks[0, r, 0]) * first
                moved += (blocks[1, r, 1] - blocks[0, r, 1]) * second
                by[i + r, frequency - n] = moved / (2 * NUDGE)
            if gain >= 0:
                by[i + r, gain - n] = lever[r] * push
        j += 1
    propagate(a, by, p)
    for i in range(len(z)):
        for j in range(len(z)):
            p[i, j] += added[i, j]


@kernel
def _advance_extended(data, memory, inputs, measurements, estimates):
    omega, settings, c, sensor = data[3], data[7], data[8], data[9]
    z, p, fresh, level = memory
    n, considered, gate = c.shape[1], int(settings[1]), settings[2]
    a, by, cross = data[0].copy(), np.zeros((n, len(z) - n)), np.empty(len(z))
    for k in range(len(inputs)):
        predict(inputs[k], data, omega, z, p, a, by)
        if not np.isnan(measurements[k, 0]):
            for o in range(len(c)):
                for i in range(n):
                    cross[i] = plus_row(0.0, c, o, p[i])
                expected = plus_row(sensor[o], c, o, cross)
                surprise = min(minus_row(measurements[k, o], c, o, z) ** 2 / expected, 100.0)
                level[0] += GATE_RATE * (surprise - level[0]) / len(c)
            # Where what it has learnt does not explain the innovations, it forgets that, and considers until it does.
            doubtful = level[0] > gate
            if doubtful and level[1] == 0.0:
                z[n:] = 0.0
                p[n:] = fresh[n:]
                p[:, n:] = fresh[:, n:]
            level[1] = 1.0 if doubtful else 0.0
            measure_in_turn(z, p, c, sensor, measurements[k], len(z) - n if doubtful else considered)
        _finish(z, n, estimates[k])


@inlined_kernel
def _finish(z, n, estimate):
    # Parameters are held within what is physical.
    for i in range(n, len(z)):
        z[i] = min(max(z[i], -WIDEST), WIDEST)
    for i in range(n):
        estimate[i] = z[i]


@kernel
def _advance_unscented(data, memory, inputs, measurements, estimates):
    c, sensor, added = data[8], data[9], data[10]
    z, p = memory
    size, n = len(z), c.shape[1]
    root, points = np.zeros((size, size)), np.empty((2 * size, size))
    for k in range(len(inputs)):
        # Points at plus and minus the columns of the root of N P, each with weight 1 / 2N: alpha = 1, kappa = 0.
        if not cholesky_root(p, root, size):
            estimates[k] = np.nan
            continue
        for s in range(2 * size):
            sign = np.sqrt(size) if s < size else -np.sqrt(size)
            for i in range(size):
                points[s, i] = z[i] + sign * root[i, s % size]
            for i in range(n, size):
                points[s, i] = min(max(points[s, i], -0.9), 0.9)
        _move(inputs[k], data, points)
        for i in range(size):
            total = 0.0
            for s in range(2 * size):
                total += points[s, i]
            z[i] = total / (2 * size)
        for i in range(size):
            for j in range(i + 1):
                total = 0.0
                for s in range(2 * size):
                    total += (points[s, i] - z[i]) * (points[s, j] - z[j])
                p[i, j] = p[j, i] = added[i, j] + total / (2 * size)
        if not np.isnan(measurements[k, 0]):
            measure_in_turn(z, p, c, sensor, measurements[k], 0)
        _finish(z, n, estimates[k])


def parts(
    model, noise, sample_time, deviation, walk, factor, gate=np.inf, *, considered=False, frequencies=True
):
    """Data and memory of a filter of states, gains and (or) `frequencies`."""
    bent = dominant(model, 3)
    stiff = min(model.rigid_modes, 1)  # of these only one gain is learnt
    modes = np.concatenate([np.zeros(stiff, int), bent])  # three frequencies, three gains
    n, count = len(model.a), len(modes)
    places = np.full((count, 2), -1)
    places[stiff:, 0] = n + np.arange(count - stiff) if frequencies else -1
    places[: min(count, 3), 1] = max(n - 1, places.max()) + 1 + np.arange(min(count, 3))
    size = places.max() + 1
    fair = NominalNoise(factor * noise.process, noise.sensor)
    added = block_diag(model.b @ fair.process @ model.b.T, walk**2 * np.eye(size - n))
    covariance = block_diag(stationary(model, fair)[1], deviation**2 * np.eye(size - n))
    data = (
        model.a,
        model.b,
        modes,
        model.frequencies[modes],
        model.damping[modes],
        model.input_shapes[modes],
        places,
        np.array([sample_time, size - n if considered else 0.0, gate]),
        model.c,
        np.diag(noise.sensor).copy(),
        added,
    )
    return data, (np.zeros(size), covariance)


def considering(
    model: NominalModel, noise: NominalNoise, sample_time: float, deviation: float
) -> CompiledObserver:
    """Schmidt-Kalman filter: the parameters are never estimated, but their uncertainty enters that of the states."""
    data, memory = parts(model, noise, sample_time, deviation, 0.0, 1.0, considered=True)
    return CompiledObserver(_advance_extended, data, gated(memory))


def gated(memory: tuple) -> tuple:
    """What a filter remembers that can forget: states, covariance, that at first, level of innovations and what it led to."""
    return *memory, memory[1].copy(), np.array([1.0, 0.0])


def extended(*given_and_knobs) -> CompiledObserver:
    """Extended Kalman filter of states and parameters; its last knob, where given, is the gate."""
    data, memory = parts(*given_and_knobs)
    return CompiledObserver(_advance_extended, data, gated(memory))


def unscented(*given_and_knobs) -> CompiledObserver:
    """Unscented Kalman filter of states and parameters."""
    return CompiledObserver(_advance_unscented, *parts(*given_and_knobs))


KNOBS = (
    TuningParameter("deviation of parameters", 0.002, 0.1, 0.03),
    TuningParameter("walk of parameters a sample", 1e-7, 1e-3, 1e-5),
    TuningParameter("factor on Q", 1.0, 1e5, 50.0),
)
PARAMETRIC = {
    "Schmidt-Kalman": Baseline(
        considering, (TuningParameter("deviation of parameters", 1e-4, 0.3, 0.03),), "Schmidt 1966"
    ),
    "extended Kalman": Baseline(extended, KNOBS, "Jazwinski 1970, section 8.3"),
    "gated extended Kalman": Baseline(
        extended,
        (*KNOBS, TuningParameter("gate on the innovations' level", 1.5, 30.0, 4.0)),
        "the extended Kalman filter, which is Schmidt's where its innovations are too large",
    ),
    "unscented Kalman": Baseline(unscented, KNOBS, "Julier and Uhlmann 2004"),
}
