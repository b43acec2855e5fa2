"""The closed loop, sample by sample: plant, instruments, skyhook, feedforward and its adaptation in one kernel.

The kernel works on blocks of samples with all memory in `State`, so that a run of any length takes constant
memory and does not depend on how it is cut into blocks. Filters are cascades of second-order sections in
transposed direct form II, a bank of channels side by side: section after section, each over all channels.

Several runs of one loop go side by side in the same kernel (`together`): every channel then stands once a run, the
runs next to each other, so that a processor's vectors hold the same number of several runs.
"""

from typing import NamedTuple

import numpy as np

from experiments.isolation.together import COLUMNS, command_of, felms_updates, ferls_updates, multiply_runs
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError
from stillwork.base.kernels import inlined_kernel, kernel
from stillwork.estimation.adaptive import Recursion, felms_update, ferls_step

FROZEN, FELMS, FERLS = 0, 1, 2  # what the kernel does with the weights
STABLE, OVERLOAD, INDEFINITE = 0, 1, 2  # why it stopped

CACHE_LINE = 64  # bytes


class Bank(NamedTuple):
    """One cascade for several channels, with its memory."""

    sections: np.ndarray  # (sections, 5): b0, b1, b2, a1, a2
    first: np.ndarray  # (sections, channels)
    second: np.ndarray  # (sections, channels)


class ClosedLoop(NamedTuple):
    """Coefficients and memory of a closed loop; the kernel changes the memory in place.

    Memory of several runs side by side is that many times as wide: channel after channel, each once a run.
    """

    plant: np.ndarray  # (inputs, outputs): [A B; C D]' padded, from [states, force, floor] to [states, a1]
    states: int  # of the plant
    vector: np.ndarray  # (inputs,): states of the plant and room for its inputs
    product: np.ndarray  # (outputs,): room for its outputs
    readings: np.ndarray  # (outputs + sensors,): room for what the sensors tell
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
    inputs, outputs = (padded(size) for size in matrix.shape)
    plant = aligned(inputs, outputs)
    plant[: len(matrix), : matrix.shape[1]] = matrix
    filters = twin.error_filter
    diagonal = twin.feedforward.estimate == "diagonal"
    powers = twin.feedforward.integrator_powers
    skyhook = rows_of(twin.skyhook_filter)
    if runs > 1:
        recursion = recursion._replace(
            **{
                name: np.repeat(getattr(recursion, name), runs, axis=-1)
                for name in ("matrix", "levels", "gain")
            }
        )
    return ClosedLoop(
        plant=plant,
        states=len(model.a),
        vector=aligned(inputs * runs),
        product=aligned(outputs * runs),
        readings=aligned((twin.outputs + twin.sensors) * runs),
        floor_inertia=twin.plant.floor_inertia,
        command=aligned(twin.actuators * runs),
        actuator=bank_of(rows_of(twin.instruments.actuator), twin.actuators * runs),
        parasitic=bank_of(rows_of(twin.instruments.parasitic), twin.actuators * runs),
        conditioning=bank_of(rows_of(twin.instruments.conditioning), (twin.outputs + twin.sensors) * runs),
        skyhook=bank_of(skyhook if feedback else 0 * skyhook, twin.outputs * runs),
        shaping=bank_of(rows_of(twin.noise_shaping), twin.sensors * runs),
        integrator=bank_of(np.tile(rows_of(twin.integrator), (powers, 1)), padded(2 * twin.sensors * runs)),
        error=bank_of(rows_of(filters.sections[0]), padded(twin.outputs * runs)),
        modes=np.zeros((0, 5, 0))
        if diagonal
        else np.repeat(np.stack([rows_of(each) for each in filters.sections], axis=2), runs, axis=2),
        before=np.zeros((0, 0)) if diagonal else np.ascontiguousarray(filters.before),
        after=np.zeros((0, 0)) if diagonal else np.ascontiguousarray(filters.after),
        weights=np.array(weights, dtype=recursion.matrix.dtype),
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


def padded(size: int) -> int:
    """Next multiple of eight: whole vectors take less time than a part of one."""
    return -(-size // 8) * 8


def aligned(*shape: int) -> np.ndarray:
    """Zeros that start at a cache line: vectors that straddle two lines halve the speed of the banks."""
    size = int(np.prod(shape))
    raw = np.zeros(size + CACHE_LINE // 8)
    offset = -raw.ctypes.data // 8 % (CACHE_LINE // 8)
    return raw[offset : offset + size].reshape(shape)


@inlined_kernel
def _filter(sections, first, second, values):
    """One sample of every channel of a bank, in place.

    The two halves of the memory are arrays of their own: interleaved, they would overlap for all that the
    compiler can tell, and it would not vectorise.
    """
    for s in range(sections.shape[0]):
        b0, b1, b2 = sections[s, 0], sections[s, 1], sections[s, 2]
        a1, a2 = sections[s, 3], sections[s, 4]
        for c in range(len(values)):
            value = values[c]
            out = b0 * value + first[s, c]
            first[s, c] = b1 * value - a1 * out + second[s, c]
            second[s, c] = b2 * value - a2 * out
            values[c] = out


@inlined_kernel
def _filter_each(sections, first, second, values):
    """The same where every channel has a cascade of its own."""
    for s in range(sections.shape[0]):
        for c in range(len(values)):
            value = values[c]
            out = sections[s, 0, c] * value + first[s, c]
            first[s, c] = sections[s, 1, c] * value - sections[s, 3, c] * out + second[s, c]
            second[s, c] = sections[s, 2, c] * value - sections[s, 4, c] * out
            values[c] = out


@kernel
def filter_block(sections, first, second, signals):
    """A block of samples, (samples, channels), through a bank with a cascade for each channel, in place."""
    for k in range(len(signals)):
        _filter_each(sections, first, second, signals[k])


@inlined_kernel
def _multiply(matrix, vector, product):
    """product = matrix' vector, four inputs at a time: one pass through memory where there would be four."""
    for i in range(len(product)):
        product[i] = 0.0
    for j in range(0, len(vector), COLUMNS):
        a, b, c, d = vector[j], vector[j + 1], vector[j + 2], vector[j + 3]
        for i in range(len(product)):
            product[i] += (matrix[j, i] * a + matrix[j + 1, i] * b) + (
                matrix[j + 2, i] * c + matrix[j + 3, i] * d
            )


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
    if together is None:
        runs = 1
    else:
        runs = len(together)
    samples, sensors = floor.shape[0], floor.shape[1] // runs
    # Local names: numba counts references at every access of a field.
    plant, vector, floor_inertia, command = loop.plant, loop.vector, loop.floor_inertia, loop.command
    before, after, weights, power = loop.before, loop.after, loop.weights, loop.power
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

    vector, product, readings = loop.vector, loop.product, loop.readings
    modes = loop.modes
    actuators, count = weights.shape[0], weights.shape[1] // runs
    outputs = skyhook_1.shape[1] // runs
    through = len(integrator) * sensors // max(count - sensors, 1)  # sections of one power of beta H
    full = len(modes) > 0
    keep = len(kept_platform) > 0
    # Where groups of channels end in arrays that hold every run.
    states, forces, floors, outs = loop.states * runs, actuators * runs, sensors * runs, outputs * runs

    resonance = np.empty(forces)
    damping = np.empty(outs)
    error = np.zeros(error_1.shape[1])
    axes = np.empty(outs)
    shaped = np.empty(floors)
    both = np.zeros(integrator_1.shape[1])
    regressor = np.empty(count * runs)
    filtered = np.empty(count * runs, weights.dtype)
    rounded = np.empty(forces, weights.dtype)
    totals, shrink = np.empty(runs), np.empty(runs)

    for k in range(samples):
        # Force: the command of the sample before, through the actuator's lag.
        _filter(actuator, actuator_1, actuator_2, command)
        for i in range(forces):
            vector[states + i] = command[i]
            resonance[i] = command[i]
        _filter(parasitic, parasitic_1, parasitic_2, resonance)

        # Plant and sensors.
        for i in range(floors):
            vector[states + forces + i] = floor[k, i]
            readings[outs + i] = floor[k, i] + noise[k, outs + i]
        if together is None:
            _multiply(plant, vector, product)
        else:
            multiply_runs(plant, vector, product, together)
        for i in range(states):
            vector[i] = product[i]
        for i in range(outs):
            product[states + i] += resonance[i]
            readings[i] = product[states + i] + noise[k, i]
        _filter(conditioning, conditioning_1, conditioning_2, readings)

        # Filtered error, eq. (16).
        for i in range(outs):
            damping[i] = readings[i]
            error[i] = readings[i]
        if full:
            for i in range(outputs):
                for run in range(runs):
                    total = 0.0
                    for j in range(outputs):
                        total += before[i, j] * readings[j * runs + run]
                    axes[i * runs + run] = total
            _filter_each(modes, error_1, error_2, axes)
            for i in range(actuators):
                for run in range(runs):
                    total = 0.0
                    for j in range(outputs):
                        total += after[i, j] * axes[j * runs + run]
                    error[i * runs + run] = total
        else:
            _filter(error_sections, error_1, error_2, error)

        # Regressors psi and psi_N: N acts on the sensors, before the integrators.
        for i in range(floors):
            shaped[i] = readings[outs + i]
        _filter(shaping, shaping_1, shaping_2, shaped)
        for i in range(floors):
            both[i] = readings[outs + i]
            both[floors + i] = shaped[i]
            regressor[i] = both[i]
            filtered[i] = shaped[i]
        for power_of in range(1, count // sensors):
            first = (power_of - 1) * through
            last = first + through
            _filter(integrator[first:last], integrator_1[first:last], integrator_2[first:last], both)
            for i in range(floors):
                regressor[power_of * floors + i] = both[i]
                filtered[power_of * floors + i] = both[floors + i]

        # Command: feedforward (13), skyhook (1), and what the floor's inertia adds on the same way.
        _filter(skyhook, skyhook_1, skyhook_2, damping)
        if together is None:
            for i in range(actuators):
                total = -damping[i]
                for j in range(count):
                    total += weights[i, j] * regressor[j]
                command[i] = total
        else:
            command_of(weights, regressor, damping, command, totals, together)
        for i in range(forces):
            if not abs(command[i]) <= force_limit:  # true for NaN as well
                return OVERLOAD, k, i % runs
        for run in range(runs):
            squares = 0.0
            for i in range(actuators):
                squares += error[i * runs + run] * error[i * runs + run]
            power[run] += squares
        if keep:
            for i in range(outs):
                kept_platform[k, i] = product[states + i]
                kept_measured[k, i] = readings[i]
            for i in range(floors):
                kept_sensed[k, i] = readings[outs + i]
            for i in range(forces):
                kept_command[k, i] = command[i]
                kept_error[k, i] = error[i]
            for i in range(count * runs):
                kept_regressors[k, i] = filtered[i]
        for i in range(actuators):
            for j in range(sensors):
                for run in range(runs):
                    command[i * runs + run] += floor_inertia[i, j] * floor[k, j * runs + run]

        if together is not None:
            if adaptation == FELMS:
                felms_updates(
                    weights, filtered, error, step_size, regularisation, trace_copies, totals, together
                )
            elif adaptation == FERLS:
                lost = ferls_updates(
                    weights,
                    matrix,
                    forgetting,
                    levels,
                    allowance,
                    gain,
                    filtered,
                    error,
                    totals,
                    shrink,
                    together,
                )
                if lost >= 0:
                    return INDEFINITE, k, lost
        elif adaptation == FELMS:
            felms_update(weights, filtered, error, step_size, regularisation, trace_copies)
        elif adaptation == FERLS:
            for i in range(actuators):
                rounded[i] = error[i]
            leverage = ferls_step(
                weights, matrix, form, forgetting, levels, allowance, gain, inner, other, filtered, rounded, k
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
