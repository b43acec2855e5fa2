"""The closed loop, sample by sample: plant, instruments, skyhook, feedforward and its adaptation in one kernel.

The kernel works on blocks of samples with all memory in `ClosedLoop`, so that a run of any length takes constant
memory and does not depend on how it is cut into blocks. Filters are cascades of second-order sections in
transposed direct form II, a bank of channels side by side: section after section, each over all channels.

Several runs of one loop go through the same kernel: their channels stand one run after the other in every bank, so that a
section's loop is as long as all of them together. What a run has for itself, plant and adaptation, goes run by run.
"""

from typing import NamedTuple

import numpy as np

from experiments.isolation.twin import Twin
from stillwork.base.algebra import plus_row
from stillwork.base.checks import InputError
from stillwork.base.kernels import borrowing_kernel, pasted_kernel
from stillwork.estimation.adaptive import Recursion, felms_update, ferls_step

FROZEN, FELMS, FERLS = 0, 1, 2  # what the kernel does with the weights
STABLE, OVERLOAD, INDEFINITE = 0, 1, 2  # why it stopped

VECTOR = 8  # numbers in a vector of the processor
COLUMNS = 4  # of the plant's matrix that a product takes at a time
RUNS = 4  # whose products go together
CACHE_LINE = 64  # bytes


class Bank(NamedTuple):
    """One cascade for several channels, with its memory."""

    sections: np.ndarray  # (sections, 5): b0, b1, b2, a1, a2
    first: np.ndarray  # (sections, channels)
    second: np.ndarray  # (sections, channels)


class Law(NamedTuple):
    """What the kernel does with the weights, and the numbers of FeLMS."""

    code: int  # FROZEN, FELMS or FERLS
    step_size: float = 0.0
    regularisation: float = 1.0
    trace_copies: float = 1.0  # how often the trace counts the regressors
    modified: bool = False  # whether the error is the modified one


class Rows(NamedTuple):
    """Workspace of one sample, a row a run."""

    vector: np.ndarray  # (runs, inputs): states of the plant and workspace for its inputs
    product: np.ndarray  # (runs, outputs) of the plant
    platform: np.ndarray  # (runs, outputs), a1
    readings: np.ndarray  # (runs, outputs) of the platform's sensors
    floor: np.ndarray  # (runs, sensors): readings of the floor's
    command: np.ndarray  # (runs, actuators): u on its way through the sample of delay
    resonance: np.ndarray  # (runs, actuators)
    damping: np.ndarray  # (runs, outputs)
    error: np.ndarray  # (runs, outputs)
    direct: np.ndarray  # (runs, sensors): the floor through the integrators
    band: np.ndarray  # (runs, sensors): the same of the shaped floor
    regressor: np.ndarray  # (runs, regressors), psi
    filtered: np.ndarray  # (runs, regressors), psi_N in the precision of the weights
    rounded: np.ndarray  # (runs, actuators), e in the precision of the weights
    sent: np.ndarray  # (runs, actuators), N[W psi]


class Channels(NamedTuple):
    """The same memory where a bank takes the channels of all runs in one loop."""

    readings: np.ndarray  # of the platform in all runs, then of the floor
    command: np.ndarray
    resonance: np.ndarray
    damping: np.ndarray
    error: np.ndarray
    sent: np.ndarray
    shaped: np.ndarray  # the floor through N
    both: np.ndarray  # `direct` of all runs, then `band`


class ClosedLoop(NamedTuple):
    """Coefficients and memory of a closed loop in several runs; the kernel changes the memory in place."""

    plant: np.ndarray  # (inputs, outputs): [A B; C D]' padded, from [states, force, floor] to [states, a1]
    states: int  # of the plant
    rows: Rows
    channels: Channels
    floor_inertia: np.ndarray  # (actuators, sensors)
    actuator: Bank
    parasitic: Bank
    conditioning: Bank  # platform sensors, then floor sensors
    skyhook: Bank
    shaping: Bank  # N on the floor sensors
    integrator: Bank  # beta H, power after power, on [a0, N a0]
    error: Bank  # N P2^-1
    weights: np.ndarray  # (runs, actuators, regressors), W
    recursion: Recursion  # of FeRLS; `matrix` and `levels` with a first axis of runs
    # Of the modified error, else empty: N on the feedforward's commands, and [psi_N, N[W psi]] of the last samples in turn
    sent: Bank
    past: np.ndarray  # (runs, 1 + delay, regressors + actuators)
    turn: np.ndarray  # (1,): samples so far
    power: np.ndarray  # (runs,): sum of e'e since the weights were last kept


class Signals(NamedTuple):
    """What a block of samples leaves behind, a row a run; the first six have length 0 where they are not kept."""

    platform: np.ndarray  # (samples, runs, outputs), a1 without noise
    measured_platform: np.ndarray  # (samples, runs, outputs), noisy and conditioned
    sensed_floor: np.ndarray  # (samples, runs, sensors), floor, noisy and conditioned
    command: np.ndarray  # (samples, runs, actuators)
    filtered_regressors: np.ndarray  # (samples, runs, regressors), psi_N
    error: np.ndarray  # (samples, runs, actuators), e
    weights: np.ndarray  # (kept, runs, actuators, regressors)
    error_power: np.ndarray  # (kept, runs), mean of e'e since the last kept


def loop_of(
    twin: Twin, feedback: bool, weights: np.ndarray, recursion: Recursion, path_delay: int | None = None
) -> ClosedLoop:
    """Loop of a twin at rest, with its skyhook closed or open, in as many runs as there are `weights`."""
    runs, model = len(weights), twin.plant.discrete(twin.sample_time)
    matrix = np.block([[model.a, model.b], [model.c, model.d]]).T
    inputs, outputs = (padded(size) for size in matrix.shape)
    plant = aligned(inputs, outputs)
    plant[: len(matrix), : matrix.shape[1]] = matrix
    skyhook = bank_of(twin.skyhook_filter, twin.outputs * runs)
    skyhook.sections[:] *= feedback
    recursion = recursion._replace(
        **{name: np.stack([getattr(recursion, name)] * runs) for name in ("matrix", "levels")}
    )
    integrator = np.tile(twin.integrator, (twin.feedforward.integrator_powers, 1))
    rows, channels = _memory(twin, runs, inputs, outputs, recursion.matrix.dtype)
    return ClosedLoop(
        plant=plant,
        states=len(model.a),
        rows=rows,
        channels=channels,
        floor_inertia=twin.plant.floor_inertia,
        actuator=bank_of(twin.instruments.actuator, twin.actuators * runs),
        parasitic=bank_of(twin.instruments.parasitic, twin.actuators * runs),
        conditioning=bank_of(twin.instruments.conditioning, (twin.outputs + twin.sensors) * runs),
        skyhook=skyhook,
        shaping=bank_of(twin.noise_shaping, twin.sensors * runs),
        integrator=bank_of(integrator, padded(2 * twin.sensors * runs)),
        error=bank_of(twin.error_filter, padded(twin.outputs * runs)),
        weights=weights.astype(recursion.matrix.dtype),
        recursion=recursion,
        sent=bank_of(twin.noise_shaping, padded(twin.actuators * runs)),
        past=np.zeros(
            (runs, 0 if path_delay is None else path_delay + 1, twin.regressors + twin.actuators),
            recursion.matrix.dtype,
        ),
        turn=np.zeros(1, int),
        power=np.zeros(runs),
    )


def _memory(twin: Twin, runs: int, inputs: int, outputs: int, precision) -> tuple[Rows, Channels]:
    a, o, n = twin.actuators, twin.outputs, twin.sensors
    sizes = {"command": a, "resonance": a, "damping": o, "error": o, "sent": a}
    wide = {name: aligned(padded(size * runs)) for name, size in sizes.items()}
    readings, both = aligned(runs * (o + n)), aligned(padded(2 * n * runs))
    rows = {name: wide[name][: runs * size].reshape(runs, size) for name, size in sizes.items()}
    channels = {name: wide[name][: runs * size] for name, size in sizes.items()} | {
        name: wide[name] for name in ("error", "sent")
    }
    found = Rows(
        vector=aligned(runs, inputs),
        product=aligned(runs, outputs),
        platform=aligned(runs, o),
        readings=readings[: runs * o].reshape(runs, o),
        floor=readings[runs * o :].reshape(runs, n),
        direct=both[: runs * n].reshape(runs, n),
        band=both[runs * n : 2 * runs * n].reshape(runs, n),
        regressor=aligned(runs, twin.regressors),
        filtered=aligned(runs, twin.regressors).astype(precision, copy=False),
        rounded=np.zeros((runs, a), precision),
        **rows,
    )
    return found, Channels(readings=readings, shaped=aligned(runs * n), both=both, **channels)


def rows_of(sections: np.ndarray) -> np.ndarray:
    """Sections of scipy, (sections, 6, ...), as the kernel's (sections, 5, ...)."""
    if not np.allclose(sections[:, 3], 1):
        raise InputError("sections: a leading denominator coefficient is not 1; normalise them")
    return np.ascontiguousarray(np.delete(sections, 3, axis=1))


def bank_of(sections: np.ndarray, channels: int) -> Bank:
    """Bank at rest with scipy's sections, of all channels or, along a last axis, of each."""
    return Bank(rows_of(sections), aligned(len(sections), channels), aligned(len(sections), channels))


def padded(size: int) -> int:
    """Next multiple of a vector: whole vectors take less time than a part of one."""
    return -(-size // VECTOR) * VECTOR


def aligned(*shape: int) -> np.ndarray:
    """Zeros that start at a cache line: vectors that straddle two lines halve the speed of the banks."""
    size = int(np.prod(shape))
    raw = np.zeros(size + CACHE_LINE // 8)
    offset = -raw.ctypes.data // 8 % (CACHE_LINE // 8)
    return raw[offset : offset + size].reshape(shape)


@pasted_kernel
def _filter(bank, values):
    """One sample of every channel of a bank, in place.

    The two halves of the memory are arrays of their own: interleaved, they would overlap for all that the
    compiler can tell, and it would not vectorise.
    """
    sections, first, second = bank
    for s in range(sections.shape[0]):
        b0, b1, b2 = sections[s, 0], sections[s, 1], sections[s, 2]
        a1, a2 = sections[s, 3], sections[s, 4]
        for c in range(len(values)):
            value = values[c]
            out = b0 * value + first[s, c]
            first[s, c] = b1 * value - a1 * out + second[s, c]
            second[s, c] = b2 * value - a2 * out
            values[c] = out


@pasted_kernel
def _filter_each(bank, values):
    """The same where every channel has a cascade of its own, (sections, 5, channels)."""
    sections, first, second = bank
    for s in range(sections.shape[0]):
        for c in range(sections.shape[2]):
            value = values[c]
            out = sections[s, 0, c] * value + first[s, c]
            first[s, c] = sections[s, 1, c] * value - sections[s, 3, c] * out + second[s, c]
            second[s, c] = sections[s, 2, c] * value - sections[s, 4, c] * out
            values[c] = out


@borrowing_kernel
def filter_block(bank, signals):
    """A block of samples, (samples, channels), through a bank with a cascade for each channel, in place."""
    for k in range(len(signals)):
        _filter_each(bank, signals[k])


@pasted_kernel
def _copy(source, target):
    """The channels of one array, or the first of them, to all of another."""
    for i in range(len(target)):
        target[i] = source[i]


@pasted_kernel
def _copy_rows(source, target):
    for run in range(target.shape[0]):
        for i in range(target.shape[1]):
            target[run, i] = source[run, i]


@pasted_kernel
def _multiply(matrix, vector, product):
    """product = matrix' vector, four inputs at a time: one pass through memory where there would be four."""
    for i in range(matrix.shape[1]):
        product[i] = 0.0
    for j in range(0, matrix.shape[0], COLUMNS):
        a, b, c, d = vector[j], vector[j + 1], vector[j + 2], vector[j + 3]
        for i in range(matrix.shape[1]):
            product[i] += (matrix[j, i] * a + matrix[j + 1, i] * b) + (
                matrix[j + 2, i] * c + matrix[j + 3, i] * d
            )


@pasted_kernel
def _multiply_four(matrix, vectors, products):
    """The same of four runs, for which the matrix is read once: it is what takes the time."""
    p, q, r, s = products[0], products[1], products[2], products[3]
    t, u, v, w = vectors[0], vectors[1], vectors[2], vectors[3]
    for i in range(matrix.shape[1]):
        p[i] = q[i] = r[i] = s[i] = 0.0
    for j in range(0, matrix.shape[0], COLUMNS):
        t0, t1, t2, t3 = t[j], t[j + 1], t[j + 2], t[j + 3]
        u0, u1, u2, u3 = u[j], u[j + 1], u[j + 2], u[j + 3]
        v0, v1, v2, v3 = v[j], v[j + 1], v[j + 2], v[j + 3]
        w0, w1, w2, w3 = w[j], w[j + 1], w[j + 2], w[j + 3]
        for i in range(matrix.shape[1]):
            a, b, c, d = matrix[j, i], matrix[j + 1, i], matrix[j + 2, i], matrix[j + 3, i]
            p[i] += (a * t0 + b * t1) + (c * t2 + d * t3)
            q[i] += (a * u0 + b * u1) + (c * u2 + d * u3)
            r[i] += (a * v0 + b * v1) + (c * v2 + d * v3)
            s[i] += (a * w0 + b * w1) + (c * w2 + d * w3)


@pasted_kernel
def _move(loop, floor):
    """Plant: the command of the sample before, through the actuators' lag, and the floor move it; a1 of all runs."""
    rows, channels, states = loop.rows, loop.channels, loop.states
    actuators, sensors = loop.floor_inertia.shape
    _filter(loop.actuator, channels.command)
    _copy(channels.command, channels.resonance)
    _filter(loop.parasitic, channels.resonance)
    for run in range(len(floor)):
        vector = rows.vector[run]
        forces, ground = vector[states:], vector[states + actuators :]
        for i in range(actuators):
            forces[i] = rows.command[run, i]
        for i in range(sensors):
            ground[i] = floor[run, i]
    whole = len(floor) // RUNS * RUNS
    for run in range(0, whole, RUNS):
        _multiply_four(loop.plant, rows.vector[run : run + RUNS], rows.product[run : run + RUNS])
    for run in range(whole, len(floor)):
        _multiply(loop.plant, rows.vector[run], rows.product[run])
    for run in range(len(floor)):
        vector, product = rows.vector[run], rows.product[run]
        for i in range(states):
            vector[i] = product[i]
        for i in range(rows.platform.shape[1]):
            rows.platform[run, i] = product[states + i] + rows.resonance[run, i]


@pasted_kernel
def _sense(loop, floor, platform_noise, floor_noise):
    """Readings of all sensors, noisy and conditioned."""
    rows = loop.rows
    for run in range(len(floor)):
        for i in range(rows.platform.shape[1]):
            rows.readings[run, i] = rows.platform[run, i] + platform_noise[run, i]
        for i in range(floor.shape[1]):
            rows.floor[run, i] = floor[run, i] + floor_noise[run, i]
    _filter(loop.conditioning, loop.channels.readings)


@pasted_kernel
def _filter_error(loop):
    """Filtered error, eq. (16)."""
    rows, channels = loop.rows, loop.channels
    _copy(channels.readings, channels.damping)
    _copy_rows(rows.readings, rows.error)
    _filter(loop.error, channels.error)


@pasted_kernel
def _regress(loop):
    """Regressors psi and psi_N: N acts on the sensors, before the integrators."""
    rows, channels = loop.rows, loop.channels
    sections, first, second = loop.integrator
    sensors, count = rows.floor.shape[1], rows.regressor.shape[1]
    through = len(sections) * sensors // max(count - sensors, 1)  # sections of one power of beta H
    band = channels.both[len(channels.shaped) :]
    _copy_rows(rows.floor, rows.direct)
    _copy(channels.both, channels.shaped)
    _filter(loop.shaping, channels.shaped)
    for i in range(len(channels.shaped)):
        band[i] = channels.shaped[i]
    for power in range(count // sensors):
        if power > 0:
            begin, end = (power - 1) * through, power * through
            _filter((sections[begin:end], first[begin:end], second[begin:end]), channels.both)
        for run in range(len(rows.floor)):
            for i in range(sensors):
                rows.regressor[run, power * sensors + i] = rows.direct[run, i]
                rows.filtered[run, power * sensors + i] = rows.band[run, i]


@pasted_kernel
def _command(loop, force_limit, modified):
    """Feedforward (13) and skyhook (1); returns a run whose command is too large, or -1.

    Where the error is `modified` the feedforward alone goes through N, too.
    """
    rows = loop.rows
    _filter(loop.skyhook, loop.channels.damping)
    stopped = -1
    for run in range(len(rows.command)):
        weights, regressor, squares = loop.weights[run], rows.regressor[run], 0.0
        for i in range(len(weights)):
            rows.command[run, i] = plus_row(-rows.damping[run, i], weights, i, regressor)
            if modified:
                rows.sent[run, i] = rows.command[run, i] + rows.damping[run, i]
            squares += rows.error[run, i] * rows.error[run, i]
            if not abs(rows.command[run, i]) <= force_limit:  # true for NaN as well
                stopped = run
        loop.power[run] += squares
    if modified:
        _filter(loop.sent, loop.channels.sent)
    return stopped


@pasted_kernel
def _keep(loop, signals, k):
    """What is kept of sample k."""
    rows = loop.rows
    _copy_rows(rows.platform, signals.platform[k])
    _copy_rows(rows.readings, signals.measured_platform[k])
    _copy_rows(rows.floor, signals.sensed_floor[k])
    _copy_rows(rows.command, signals.command[k])
    _copy_rows(rows.filtered, signals.filtered_regressors[k])
    _copy_rows(rows.error, signals.error[k])


@pasted_kernel
def _compensate(loop, floor):
    """Add what the floor's inertia takes, on the same way as the command."""
    command = loop.rows.command
    for run in range(len(command)):
        for i in range(command.shape[1]):
            command[run, i] = plus_row(command[run, i], loop.floor_inertia, i, floor[run])


@pasted_kernel
def _modify(loop):
    """The modified error in place of e, and psi_N of as many samples ago as the path is late."""
    rows, turn = loop.rows, loop.turn[0]
    n, places = rows.filtered.shape[1], loop.past.shape[1]
    for run in range(len(loop.past)):
        now, then = loop.past[run, turn % places], loop.past[run, (turn + 1) % places]
        for i in range(n):
            now[i] = rows.filtered[run, i]
        for a in range(rows.sent.shape[1]):
            now[n + a] = rows.sent[run, a]
        for i in range(n):
            rows.filtered[run, i] = then[i]
        for a in range(rows.sent.shape[1]):
            rows.error[run, a] = plus_row(
                rows.error[run, a] - then[n + a], loop.weights[run], a, rows.filtered[run]
            )
    loop.turn[0] += 1


@pasted_kernel
def _adapt(loop, law, inner, other, k):
    """One sample of the adaptation; returns a run whose P is indefinite, or -1."""
    rows, recursion = loop.rows, loop.recursion
    if law.modified:
        _modify(loop)
    if law.code == FELMS:
        numbers = law.step_size, law.regularisation, law.trace_copies
        for run in range(len(loop.weights)):
            felms_update(loop.weights[run], rows.filtered[run], rows.error[run], *numbers)
    elif law.code == FERLS:
        _copy_rows(rows.error, rows.rounded)
        for run in range(len(loop.weights)):
            leverage = ferls_step(
                loop.weights[run],
                recursion.matrix[run],
                recursion.form,
                recursion.forgetting,
                recursion.levels[run],
                recursion.allowance,
                recursion.gain,
                inner,
                other,
                rows.filtered[run],
                rows.rounded[run],
                k,
            )
            if not leverage >= recursion.forgetting:
                return run
    return -1


@pasted_kernel
def _keep_weights(loop, weights, error_power, keep_every):
    """The weights of all runs, and the mean power since the last that were kept."""
    for run in range(len(weights)):
        _copy_rows(loop.weights[run], weights[run])
        error_power[run] = loop.power[run] / float(keep_every)
        loop.power[run] = 0.0


@borrowing_kernel
def advance(floor, noise, loop, signals, keep_every, phase, law, inner, other, force_limit):
    """Advance the loop over a block of samples; returns (status, samples done, run that stopped it).

    The floor is a0 (samples, runs, sensors), the noise n1 and n0 (samples, runs, outputs) and (samples, runs, sensors),
    before the conditioners; `loop` and `signals` are changed in place. `keep_every` samples lie between two kept weights,
    `phase` since the last when the block starts. `inner` and `other`, of the loop's recursion, decide when this is compiled
    which forms it knows. A command beyond `force_limit`, or NaN, stops the run.
    """
    keep = len(signals.platform) > 0
    for k in range(len(floor)):
        _move(loop, floor[k])
        _sense(loop, floor[k], noise[0][k], noise[1][k])
        _filter_error(loop)
        _regress(loop)
        stopped = _command(loop, force_limit, law.modified)
        if stopped >= 0:
            return OVERLOAD, k, stopped
        if keep:
            _keep(loop, signals, k)
        _compensate(loop, floor[k])
        stopped = _adapt(loop, law, inner, other, k)
        if stopped >= 0:
            return INDEFINITE, k, stopped
        if (phase + k + 1) % keep_every == 0:
            row = (phase + k) // keep_every
            _keep_weights(loop, signals.weights[row], signals.error_power[row], keep_every)
    return STABLE, len(floor), 0
