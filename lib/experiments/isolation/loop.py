"""The closed loop, sample by sample: plant, instruments, skyhook, feedforward and its adaptation in one kernel.

The kernel works on blocks of samples with all memory in `State`, so that a run of any length takes constant
memory and does not depend on how it is cut into blocks. Filters are cascades of second-order sections in
transposed direct form II, a bank of channels side by side: section after section, each over all channels.

Several runs of one loop go side by side in the same kernel (`together`): every channel then stands once a run, the
runs next to each other, so that a processor's vectors hold the same number of several runs.
"""

from typing import NamedTuple

import numpy as np

from experiments.isolation.lanes import at_most, lanes
from experiments.isolation.together import ferls_updates, hold_each
from experiments.isolation.twin import Twin
from stillwork.base.algebra import plus_row, set_product
from stillwork.base.checks import InputError
from stillwork.base.kernels import borrowing_kernel, inlined_kernel, kernel, pasted_kernel
from stillwork.estimation.adaptive import Recursion, felms_update, ferls_step

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


class Workspace(NamedTuple):
    """Workspace of one sample."""

    product: np.ndarray  # (outputs,) of the plant
    readings: np.ndarray  # (outputs + sensors,): readings of the sensors
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
    vector: np.ndarray  # (inputs,): states of the plant and workspace for its inputs
    workspace: Workspace
    floor_inertia: np.ndarray  # (actuators, sensors)
    command: np.ndarray  # (actuators,): u on its way through the sample of delay
    actuator: Bank
    parasitic: Bank
    conditioning: Bank  # platform sensors, then floor sensors
    skyhook: Bank
    shaping: Bank  # N on the floor sensors
    integrator: Bank  # beta H, power after power, on [a0, N a0]
    error: Bank  # N P2^-1
    modes: np.ndarray  # (sections, 5, axes), N P2^-1 of a full estimate; empty if diagonal
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
    measured_platform: np.ndarray  # (samples, outputs), noisy and conditioned
    sensed_floor: np.ndarray  # (samples, sensors), floor, noisy and conditioned
    command: np.ndarray  # (samples, actuators)
    filtered_regressors: np.ndarray  # (samples, regressors), psi_N
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
    skyhook = bank_of(twin.skyhook_filter, twin.outputs * runs)
    skyhook.sections[:] *= feedback
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
        workspace=Workspace(
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
        actuator=bank_of(twin.instruments.actuator, twin.actuators * runs),
        parasitic=bank_of(twin.instruments.parasitic, twin.actuators * runs),
        conditioning=bank_of(twin.instruments.conditioning, (twin.outputs + twin.sensors) * runs),
        skyhook=skyhook,
        shaping=bank_of(twin.noise_shaping, twin.sensors * runs),
        integrator=bank_of(np.tile(twin.integrator, (powers, 1)), floors),
        error=bank_of(filters.sections[0], errors),
        modes=np.zeros((0, 5, 0)) if diagonal else rows_of(np.moveaxis(filters.sections, 0, -1)),
        before=np.ascontiguousarray(filters.before),
        after=np.ascontiguousarray(filters.after),
        weights=side_by_side(weights, 1).astype(precision, copy=False),
        recursion=recursion,
        power=np.zeros(runs),
    )


def rows_of(sections: np.ndarray) -> np.ndarray:
    """Sections of scipy, (sections, 6, ...), as the kernel's (sections, 5, ...)."""
    if not np.allclose(sections[:, 3], 1):
        raise InputError("sections: a leading denominator coefficient is not 1; normalise them")
    return np.ascontiguousarray(np.delete(sections, 3, axis=1))


def bank_of(sections: np.ndarray, channels: int) -> Bank:
    """Bank at rest with scipy's sections, of all channels or, along a last axis, of each."""
    return Bank(rows_of(sections), aligned(len(sections), channels), aligned(len(sections), channels))


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
def filter_block(bank, signals, together):
    """A block of samples, (samples, channels), through a bank with a cascade for each channel, in place."""
    bank, signals = _bank_in_lanes(bank, together), lanes(signals, together)
    for k in range(len(signals)):
        _filter_each(bank, signals[k])


@inlined_kernel
def _bank_in_lanes(bank, together):
    return bank.sections, lanes(bank.first, together), lanes(bank.second, together)


@pasted_kernel
def _copy(source, target):
    """The channels of one array, or the first of them, to all of another."""
    for i in range(len(target)):
        target[i] = source[i]


@pasted_kernel
def _place(source, target, place):
    """All channels of one array into another, from a place on."""
    for i in range(len(source)):
        target[place + i] = source[i]


@pasted_kernel
def _keep(source, kept, k):
    """Row k of a signal that is kept."""
    for i in range(kept.shape[1]):
        kept[k, i] = source[i]


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
def _command(weights, regressor, damping, command):
    """u = W psi less the damping."""
    for i in range(weights.shape[0]):
        command[i] = plus_row(-damping[i], weights, i, regressor)


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
    alone,
):
    """Advance the loop over a block of samples; returns (status, samples done, run whose command was too large).

    The floor is a0 (samples, sensors), the noise n1 and n0 (samples, outputs + sensors), before the conditioners;
    `loop` and `signals` are changed in place. `keep_every` samples lie between two kept weights, `phase` since the
    last when the block starts. `adaptation` is FROZEN, FELMS or FERLS; for FELMS `trace_copies` is how often the
    trace counts the regressors. `inner` and `other`, of the loop's recursion, decide when this is compiled which
    forms it knows. A command beyond `force_limit`, or NaN, stops the run. `together` is None or a tuple as long as
    the runs side by side are many, which the compiler then knows; each channel of every array stands for that many,
    and P has the triangle's form. `alone` is None where `together` is not: the compiler leaves out what asks for it.
    """
    runs, commands, each = len(loop.power), loop.command, loop.recursion.levels
    # Local names: what is read from a field anew at every sample costs time.
    floor, noise = lanes(floor, together), lanes(noise, together)
    plant, floor_inertia, before, after = loop.plant, loop.floor_inertia, loop.before, loop.after
    vector, command, weights, power = lanes((loop.vector, loop.command, loop.weights, loop.power), together)
    product, readings, resonance, damping, error, axes, shaped, both, regressor, filtered, rounded = lanes(
        loop.workspace, together
    )
    _, form, forgetting, _, allowance, _, _, _ = loop.recursion
    matrix, levels, gain = lanes((loop.recursion.matrix, each, loop.recursion.gain), together)
    actuator = _bank_in_lanes(loop.actuator, together)
    parasitic = _bank_in_lanes(loop.parasitic, together)
    conditioning = _bank_in_lanes(loop.conditioning, together)
    skyhook = _bank_in_lanes(loop.skyhook, together)
    shaping = _bank_in_lanes(loop.shaping, together)
    integrator, integrator_1, integrator_2 = _bank_in_lanes(loop.integrator, together)
    errors = _bank_in_lanes(loop.error, together)
    modes = (loop.modes, errors[1], errors[2])
    (
        kept_platform,
        kept_measured,
        kept_sensed,
        kept_command,
        kept_regressors,
        kept_error,
        kept_weights,
        kept_power,
    ) = lanes(signals, together)

    samples, sensors = floor.shape
    actuators, count = weights.shape
    outputs, states = skyhook[1].shape[1], loop.states
    through = len(integrator) * sensors // max(count - sensors, 1)  # sections of one power of beta H
    full = len(loop.modes) > 0
    keep = len(kept_platform) > 0
    # Parts of them, which have their meaning: an index from within a whole is looked at for its sign.
    motion, forces = vector[:states], vector[states : states + actuators]
    ground = vector[states + actuators :]
    unfiltered = error[:outputs]
    platform, platform_readings, floor_readings = product[states:], readings[:outputs], readings[outputs:]
    direct, band = both[:sensors], both[sensors : 2 * sensors]

    for k in range(samples):
        # Force: the command of the sample before, through the actuator's lag.
        _filter(actuator, command)
        _copy(command, forces)
        _copy(command, resonance)
        _filter(parasitic, resonance)

        # Plant and sensors.
        for i in range(sensors):
            ground[i] = floor[k, i]
            floor_readings[i] = floor[k, i] + noise[k, outputs + i]
        _multiply(plant, vector, product)
        _copy(product, motion)
        for i in range(outputs):
            platform[i] += resonance[i]
            platform_readings[i] = platform[i] + noise[k, i]
        _filter(conditioning, readings)

        # Filtered error, eq. (16).
        _copy(readings, damping)
        _copy(readings, unfiltered)
        if full:
            set_product(before, readings, axes)
            _filter_each(modes, axes)
            set_product(after, axes, error)
        else:
            _filter(errors, error)

        # Regressors psi and psi_N: N acts on the sensors, before the integrators.
        _copy(floor_readings, shaped)
        _filter(shaping, shaped)
        _copy(floor_readings, direct)
        _copy(shaped, band)
        _place(direct, regressor, 0)
        _place(band, filtered, 0)
        for power_of in range(1, count // sensors):
            first = (power_of - 1) * through
            last = first + through
            _filter((integrator[first:last], integrator_1[first:last], integrator_2[first:last]), both)
            _place(direct, regressor, power_of * sensors)
            _place(band, filtered, power_of * sensors)

        # Command: feedforward (13), skyhook (1), and what the floor's inertia adds on the same way.
        _filter(skyhook, damping)
        _command(weights, regressor, damping, command)
        for i in range(len(commands)):
            if not abs(commands[i]) <= force_limit:  # true for NaN as well
                return OVERLOAD, k, i % runs
        squares = 0.0
        for i in range(actuators):
            squares += error[i] * error[i]
        power[0] += squares
        if keep:
            _keep(platform, kept_platform, k)
            _keep(platform_readings, kept_measured, k)
            _keep(floor_readings, kept_sensed, k)
            _keep(command, kept_command, k)
            _keep(filtered, kept_regressors, k)
            _keep(error, kept_error, k)
        for i in range(actuators):
            command[i] = plus_row(command[i], floor_inertia, i, ground)

        if adaptation == FELMS:
            felms_update(weights, filtered, error, step_size, regularisation, trace_copies)
        elif adaptation == FERLS:
            if together is not None:
                leverage, within = ferls_updates(
                    weights, matrix, forgetting, levels, each, allowance, gain, filtered, error
                )
                if not at_most(forgetting, leverage):
                    return INDEFINITE, k, 0
                if not within:
                    hold_each(loop.recursion.matrix, forgetting, each, runs)
            if alone is not None:
                _copy(error, rounded)
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
                for j in range(count):
                    kept_weights[row, i, j] = weights[i, j]
            kept_power[row, 0] = power[0] / float(keep_every)
            power[0] = 0.0
    return STABLE, samples, 0
