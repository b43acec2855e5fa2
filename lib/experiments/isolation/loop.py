"""The closed loop, sample by sample: plant, instruments, skyhook, feedforward and its adaptation in one kernel.

The kernel works on blocks of samples with all memory in `State`, so that a run of any length takes constant
memory and does not depend on how it is cut into blocks. Filters are cascades of second-order sections in
transposed direct form II, a bank of channels side by side: section after section, each over all channels.

Several runs of one loop go side by side in the same kernel (`together`): every channel then stands once a run, the
runs next to each other, so that a processor's vectors hold the same number of several runs.
"""

from typing import NamedTuple

import numpy as np

from experiments.isolation.lanes import at_most, put, runs_of, same, take
from experiments.isolation.together import ferls_updates, first_below, hold_each
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError
from stillwork.base.kernels import borrowing_kernel, kernel, pasted_kernel
from stillwork.estimation.adaptive import Recursion, ferls_step

FROZEN, FELMS, FERLS = 0, 1, 2  # what the kernel does with the weights
STABLE, OVERLOAD, INDEFINITE = 0, 1, 2  # why it stopped

VECTOR = 8  # numbers in a vector of the processor
COLUMNS = 4  # of the plant's matrix that a product takes at a time
CACHE_LINE = 64  # bytes


class Bank(NamedTuple):
    """One cascade for several channels, with its memory."""

    sections: np.ndarray  # (sections, 5): b0, b1, b2, a1, a2
    first: np.ndarray  # (sections, channels)
    second: np.ndarray  # (sections, channels)


class Room(NamedTuple):
    """Room for what one sample needs."""

    product: np.ndarray  # (outputs,) of the plant
    readings: np.ndarray  # (outputs + sensors,): what the sensors tell
    resonance: np.ndarray  # (actuators,)
    damping: np.ndarray  # (outputs,)
    error: np.ndarray  # (outputs,)
    axes: np.ndarray  # (outputs,)
    shaped: np.ndarray  # (sensors,)
    both: np.ndarray  # (2 sensors,)
    regressor: np.ndarray  # (regressors,), psi
    filtered: np.ndarray  # (regressors,), psi_N in the precision of the weights
    rounded: np.ndarray  # (actuators,), e in the precision of the weights


class ClosedLoop(NamedTuple):
    """Coefficients and memory of a closed loop; the kernel changes the memory in place.

    Memory of several runs side by side is that many times as wide: channel after channel, each once a run.
    """

    plant: np.ndarray  # (inputs, outputs): [A B; C D]' padded, from [states, force, floor] to [states, a1]
    states: int  # of the plant
    vector: np.ndarray  # (inputs,): states of the plant and room for its inputs
    room: Room
    floor_inertia: np.ndarray  # (actuators, sensors)
    command: np.ndarray  # (actuators,): u on its way through the sample of delay
    actuator: Bank
    parasitic: Bank
    conditioning: Bank  # platform sensors, then floor sensors
    skyhook: Bank
    shaping: Bank  # N on the floor sensors
    integrator: Bank  # beta H, power after power, on [a0, N a0]
    error: Bank  # N P2^-1
    modes: np.ndarray  # (sections, 5, axes), N P2^-1 of a full estimate; empty, like its mixing, if diagonal
    before: np.ndarray  # (axes, outputs)
    after: np.ndarray  # (actuators, axes)
    weights: np.ndarray  # (actuators, regressors), W
    recursion: Recursion  # P, of FeRLS
    power: np.ndarray  # (runs,): sum of e'e since the weights were last kept


class Signals(NamedTuple):
    """What a block of samples leaves behind; the first six have length 0 where they are not kept.

    Of several runs side by side each channel stands once a run.
    """

    platform: np.ndarray  # (samples, outputs), a1 without noise
    measured: np.ndarray  # (samples, outputs), noisy and conditioned
    sensed: np.ndarray  # (samples, sensors), floor, noisy and conditioned
    command: np.ndarray  # (samples, actuators)
    regressors: np.ndarray  # (samples, regressors), psi_N
    error: np.ndarray  # (samples, actuators), e
    weights: np.ndarray  # (kept, actuators, regressors)
    error_power: np.ndarray  # (kept, runs), mean of e'e since the last kept


def loop_of(
    twin: Twin, feedback: bool, weights: np.ndarray, recursion: Recursion, runs: int = 1
) -> ClosedLoop:
    """Loop of a twin at rest, with its skyhook closed or open, for a number of runs side by side, each with its `weights`."""
    model = twin.plant.discrete(twin.sample_time)
    matrix = np.block([[model.a, model.b], [model.c, model.d]]).T
    # Vectors of the processor hold the channels of a single run, and are to be full.
    whole = VECTOR if runs == 1 else COLUMNS
    inputs, outputs = (padded(size, whole) for size in matrix.shape)
    plant = aligned(inputs, outputs)
    plant[: len(matrix), : matrix.shape[1]] = matrix
    filters = twin.error_filter
    diagonal = twin.feedforward.estimate == "diagonal"
    powers = twin.feedforward.integrator_powers
    skyhook = rows_of(twin.skyhook_filter)
    if runs > 1:
        recursion = recursion._replace(
            **{name: side_by_side(getattr(recursion, name), runs) for name in ("matrix", "levels", "gain")}
        )
    precision = recursion.matrix.dtype
    errors, floors = padded(twin.outputs * runs, VECTOR), padded(2 * twin.sensors * runs, VECTOR)
    return ClosedLoop(
        plant=plant,
        states=len(model.a),
        vector=aligned(inputs * runs),
        room=Room(
            product=aligned(outputs * runs),
            readings=aligned((twin.outputs + twin.sensors) * runs),
            resonance=aligned(twin.actuators * runs),
            damping=aligned(twin.outputs * runs),
            error=aligned(errors),
            axes=aligned(twin.outputs * runs),
            shaped=aligned(twin.sensors * runs),
            both=aligned(floors),
            regressor=aligned(twin.regressors * runs),
            filtered=aligned(twin.regressors * runs).astype(precision, copy=False),
            rounded=np.zeros(twin.actuators * runs, precision),
        ),
        floor_inertia=twin.plant.floor_inertia,
        command=aligned(twin.actuators * runs),
        actuator=bank_of(rows_of(twin.instruments.actuator), twin.actuators * runs),
        parasitic=bank_of(rows_of(twin.instruments.parasitic), twin.actuators * runs),
        conditioning=bank_of(rows_of(twin.instruments.conditioning), (twin.outputs + twin.sensors) * runs),
        skyhook=bank_of(skyhook if feedback else 0 * skyhook, twin.outputs * runs),
        shaping=bank_of(rows_of(twin.noise_shaping), twin.sensors * runs),
        integrator=bank_of(np.tile(rows_of(twin.integrator), (powers, 1)), floors),
        error=bank_of(rows_of(filters.sections[0]), errors),
        modes=np.zeros((0, 5, 0))
        if diagonal
        else np.stack([rows_of(each) for each in filters.sections], axis=2),
        before=np.zeros((0, 0)) if diagonal else np.ascontiguousarray(filters.before),
        after=np.zeros((0, 0)) if diagonal else np.ascontiguousarray(filters.after),
        weights=side_by_side(weights, 1).astype(precision, copy=False),
        recursion=recursion,
        power=np.zeros(runs),
    )


def rows_of(sections: np.ndarray) -> np.ndarray:
    """Sections of scipy, (sections, 6), as the kernel's (sections, 5)."""
    if not np.allclose(sections[:, 3], 1):
        raise InputError("sections: a leading denominator coefficient is not 1; normalise them")
    return np.ascontiguousarray(np.delete(sections, 3, axis=1))


def bank_of(rows: np.ndarray, channels: int) -> Bank:
    """Bank at rest."""
    return Bank(np.ascontiguousarray(rows), aligned(len(rows), channels), aligned(len(rows), channels))


def padded(size: int, whole: int) -> int:
    """Next multiple: whole vectors take less time than a part of one."""
    return -(-size // whole) * whole


def aligned(*shape: int) -> np.ndarray:
    """Zeros that start at a cache line: vectors that straddle two lines halve the speed of the banks."""
    size = int(np.prod(shape))
    raw = np.zeros(size + CACHE_LINE // 8)
    offset = -raw.ctypes.data // 8 % (CACHE_LINE // 8)
    return raw[offset : offset + size].reshape(shape)


def side_by_side(array: np.ndarray, runs: int) -> np.ndarray:
    """Copy with every channel of the last axis once a run."""
    wide = aligned(*array.shape[:-1], array.shape[-1] * runs)
    wide[:] = np.repeat(array, runs, axis=-1)
    return wide


@pasted_kernel
def _filter(sections, first, second, values, together):
    """One sample of every channel of a bank, in place.

    The two halves of the memory are arrays of their own: interleaved, they would overlap for all that the
    compiler can tell, and it would not vectorise.
    """
    for s in range(sections.shape[0]):
        b0, b1, b2 = sections[s, 0], sections[s, 1], sections[s, 2]
        a1, a2 = sections[s, 3], sections[s, 4]
        for c in range(len(values) // runs_of(together)):
            value = take(values, c, together)
            out = b0 * value + take(first, (s, c), together)
            put(first, (s, c), b1 * value - a1 * out + take(second, (s, c), together), together)
            put(second, (s, c), b2 * value - a2 * out, together)
            put(values, c, out, together)


@pasted_kernel
def _filter_each(sections, first, second, values, together):
    """The same where every channel has a cascade of its own, (sections, 5, channels)."""
    for s in range(sections.shape[0]):
        for c in range(sections.shape[2]):
            value = take(values, c, together)
            out = sections[s, 0, c] * value + take(first, (s, c), together)
            following = sections[s, 1, c] * value - sections[s, 3, c] * out + take(second, (s, c), together)
            put(first, (s, c), following, together)
            put(second, (s, c), sections[s, 2, c] * value - sections[s, 4, c] * out, together)
            put(values, c, out, together)


@borrowing_kernel
def filter_block(sections, first, second, signals, together):
    """A block of samples, (samples, channels), through a bank with a cascade for each channel, in place."""
    for k in range(len(signals)):
        _filter_each(sections, first, second, signals[k], together)


@pasted_kernel
def _copy(source, first, target, place, channels, together):
    """So many channels of one array to a place in another."""
    for i in range(channels):
        put(target, place + i, take(source, first + i, together), together)


@pasted_kernel
def _keep(source, first, kept, k):
    """Row k of a signal that is kept: the numbers of every run from `first` on."""
    for i in range(kept.shape[1]):
        kept[k, i] = source[first + i]


@pasted_kernel
def _multiply(matrix, vector, product, together):
    """product = matrix' vector, four inputs at a time: one pass through memory where there would be four."""
    for i in range(matrix.shape[1]):
        put(product, i, 0.0, together)
    for j in range(0, matrix.shape[0], COLUMNS):
        a, b = take(vector, j, together), take(vector, j + 1, together)
        c, d = take(vector, j + 2, together), take(vector, j + 3, together)
        for i in range(matrix.shape[1]):
            total = (matrix[j, i] * a + matrix[j + 1, i] * b) + (matrix[j + 2, i] * c + matrix[j + 3, i] * d)
            put(product, i, take(product, i, together) + total, together)


@pasted_kernel
def _set_product(matrix, vector, out, together):
    """Out = matrix vector, of a few channels."""
    for i in range(matrix.shape[0]):
        total = same(0.0, together)
        for j in range(matrix.shape[1]):
            total += matrix[i, j] * take(vector, j, together)
        put(out, i, total, together)


@pasted_kernel
def _command(weights, regressor, damping, command, together):
    """u = W psi less the damping."""
    for i in range(weights.shape[0]):
        total = -take(damping, i, together)
        for j in range(weights.shape[1] // runs_of(together)):
            total += take(weights, (i, j), together) * take(regressor, j, together)
        put(command, i, total, together)


@pasted_kernel
def _felms(weights, regressor, error, step_size, regularisation, trace_copies, together):
    """`felms_update` of every run."""
    count = weights.shape[1] // runs_of(together)
    power = same(0.0, together)
    for j in range(count):
        power += take(regressor, j, together) * take(regressor, j, together)
    rate = step_size / (regularisation + trace_copies * power)
    for i in range(weights.shape[0]):
        scaled = rate * take(error, i, together)
        for j in range(count):
            step = scaled * take(regressor, j, together)
            put(weights, (i, j), take(weights, (i, j), together) - step, together)


@kernel
def advance(
    floor,
    noise,
    loop,
    signals,
    keep_every,
    phase,
    adaptation,
    step_size,
    regularisation,
    trace_copies,
    inner,
    other,
    force_limit,
    together,
):
    """Advance the loop over a block of samples; returns (status, samples done, run that stopped).

    The floor is a0 (samples, sensors), the noise n1 and n0 (samples, outputs + sensors), before the conditioners;
    `loop` and `signals` are changed in place. `keep_every` samples lie between two kept weights, `phase` since the
    last when the block starts. `adaptation` is FROZEN, FELMS or FERLS; for FELMS `trace_copies` is how often the
    trace counts the regressors. `inner` and `other`, of the loop's recursion, decide when this is compiled which
    forms it knows. A command beyond `force_limit`, or NaN, stops the run. `together` is None or a tuple as long as
    the runs side by side are many, which the compiler then knows; each channel of every array stands for that many,
    and P has the triangle's form.
    """
    runs = runs_of(together)
    samples, sensors = floor.shape[0], floor.shape[1] // runs
    # Local names: what is read from a field anew at every sample costs time.
    plant, vector, floor_inertia, command = loop.plant, loop.vector, loop.floor_inertia, loop.command
    modes, before, after, weights, power = loop.modes, loop.before, loop.after, loop.weights, loop.power
    product, readings, resonance, damping, error, axes, shaped, both, regressor, filtered, rounded = loop.room
    matrix, form, forgetting, levels, allowance, gain, _, _ = loop.recursion
    actuator, actuator_1, actuator_2 = loop.actuator
    parasitic, parasitic_1, parasitic_2 = loop.parasitic
    conditioning, conditioning_1, conditioning_2 = loop.conditioning
    skyhook, skyhook_1, skyhook_2 = loop.skyhook
    shaping, shaping_1, shaping_2 = loop.shaping
    integrator, integrator_1, integrator_2 = loop.integrator
    error_sections, error_1, error_2 = loop.error
    kept_platform, kept_measured, kept_sensed = signals.platform, signals.measured, signals.sensed
    kept_command, kept_regressors, kept_error = signals.command, signals.regressors, signals.error
    kept_weights, kept_power = signals.weights, signals.error_power

    actuators, count = weights.shape[0], weights.shape[1] // runs
    outputs, states = skyhook_1.shape[1] // runs, loop.states
    through = len(integrator) * sensors // max(count - sensors, 1)  # sections of one power of beta H
    full = len(modes) > 0
    keep = len(kept_platform) > 0

    for k in range(samples):
        # Force: the command of the sample before, through the actuator's lag.
        _filter(actuator, actuator_1, actuator_2, command, together)
        _copy(command, 0, vector, states, actuators, together)
        _copy(command, 0, resonance, 0, actuators, together)
        _filter(parasitic, parasitic_1, parasitic_2, resonance, together)

        # Plant and sensors.
        for i in range(sensors):
            motion = take(floor, (k, i), together)
            put(vector, states + actuators + i, motion, together)
            put(readings, outputs + i, motion + take(noise, (k, outputs + i), together), together)
        _multiply(plant, vector, product, together)
        _copy(product, 0, vector, 0, states, together)
        for i in range(outputs):
            moved = take(product, states + i, together) + take(resonance, i, together)
            put(product, states + i, moved, together)
            put(readings, i, moved + take(noise, (k, i), together), together)
        _filter(conditioning, conditioning_1, conditioning_2, readings, together)

        # Filtered error, eq. (16).
        _copy(readings, 0, damping, 0, outputs, together)
        _copy(readings, 0, error, 0, outputs, together)
        if full:
            _set_product(before, readings, axes, together)
            _filter_each(modes, error_1, error_2, axes, together)
            _set_product(after, axes, error, together)
        else:
            _filter(error_sections, error_1, error_2, error, together)

        # Regressors psi and psi_N: N acts on the sensors, before the integrators.
        _copy(readings, outputs, shaped, 0, sensors, together)
        _filter(shaping, shaping_1, shaping_2, shaped, together)
        _copy(readings, outputs, both, 0, sensors, together)
        _copy(shaped, 0, both, sensors, sensors, together)
        _copy(both, 0, regressor, 0, sensors, together)
        _copy(both, sensors, filtered, 0, sensors, together)
        for power_of in range(1, count // sensors):
            first = (power_of - 1) * through
            last = first + through
            _filter(
                integrator[first:last], integrator_1[first:last], integrator_2[first:last], both, together
            )
            _copy(both, 0, regressor, power_of * sensors, sensors, together)
            _copy(both, sensors, filtered, power_of * sensors, sensors, together)

        # Command: feedforward (13), skyhook (1), and what the floor's inertia adds on the same way.
        _filter(skyhook, skyhook_1, skyhook_2, damping, together)
        _command(weights, regressor, damping, command, together)
        for i in range(len(command)):
            if not abs(command[i]) <= force_limit:  # true for NaN as well
                return OVERLOAD, k, i % runs
        squares = same(0.0, together)
        for i in range(actuators):
            squares += take(error, i, together) * take(error, i, together)
        put(power, 0, take(power, 0, together) + squares, together)
        if keep:
            _keep(product, states * runs, kept_platform, k)
            _keep(readings, 0, kept_measured, k)
            _keep(readings, outputs * runs, kept_sensed, k)
            _keep(command, 0, kept_command, k)
            _keep(filtered, 0, kept_regressors, k)
            _keep(error, 0, kept_error, k)
        for i in range(actuators):
            for j in range(sensors):
                inertia = floor_inertia[i, j] * take(floor, (k, j), together)
                put(command, i, take(command, i, together) + inertia, together)

        if adaptation == FELMS:
            _felms(weights, filtered, error, step_size, regularisation, trace_copies, together)
        elif adaptation == FERLS:
            if together is not None:
                leverage, within = ferls_updates(
                    weights, matrix, forgetting, levels, allowance, gain, filtered, error, together
                )
                if not at_most(forgetting, leverage):
                    return INDEFINITE, k, first_below(forgetting, gain, filtered, runs)
                if not within:
                    hold_each(matrix, forgetting, levels, runs)
            else:
                _copy(error, 0, rounded, 0, actuators, together)
                leverage = ferls_step(
                    weights,
                    matrix,
                    form,
                    forgetting,
                    levels,
                    allowance,
                    gain,
                    inner,
                    other,
                    filtered,
                    rounded,
                    k,
                )
                if not leverage >= forgetting:
                    return INDEFINITE, k, 0

        if (phase + k + 1) % keep_every == 0:
            row = (phase + k) // keep_every
            for i in range(actuators):
                for j in range(count * runs):
                    kept_weights[row, i, j] = weights[i, j]
            for run in range(runs):
                kept_power[row, run] = power[run] / keep_every
                power[run] = 0.0
    return STABLE, samples, 0
