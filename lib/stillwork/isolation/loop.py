"""The closed loop, sample by sample: plant, instruments, skyhook, feedforward and its adaptation in one kernel.

Filters are cascades of second-order sections in transposed direct form II, one state a channel. The kernel
works on blocks of samples with all memory in `State`, so that a run of any length takes constant memory and
does not depend on how it is cut into blocks.
"""

from typing import NamedTuple

import numpy as np

from stillwork.checks import InputError
from stillwork.isolation.adaptation import _felms_update, _ferls_update
from stillwork.isolation.twin import Twin
from stillwork.kernels import kernel

FROZEN, FELMS, FERLS = 0, 1, 2  # what the kernel does with the weights
STABLE, OVERLOAD, INDEFINITE = 0, 1, 2  # why it stopped


class System(NamedTuple):
    """All coefficients of the loop; sections are rows (b0, b1, b2, a1, a2)."""

    plant: (
        np.ndarray
    )  # (inputs, outputs) of [states, force, floor] -> [states, acceleration]: transposed [A B; C D]
    floor_inertia: np.ndarray  # (actuators, sensors)
    actuator: np.ndarray  # (1, sections, 5)
    parasitic: np.ndarray  # (1, sections, 5)
    conditioning: np.ndarray  # (1, sections, 5)
    skyhook: np.ndarray  # (1, sections, 5)
    integrator: np.ndarray  # (1, sections, 5), beta H
    shaping: np.ndarray  # (1, sections, 5), N
    error: np.ndarray  # (axes or 1, sections, 5), N P2^-1
    before: np.ndarray  # (axes, outputs); (0, 0) where the estimate is diagonal
    after: np.ndarray  # (actuators, axes)


class State(NamedTuple):
    """All memory of the loop between two samples; filter states are (channels, sections, 2)."""

    plant: np.ndarray  # (states,)
    command: np.ndarray  # (actuators,): on its way through the sample of delay
    actuator: np.ndarray
    parasitic: np.ndarray
    platform_conditioning: np.ndarray
    floor_conditioning: np.ndarray
    skyhook: np.ndarray
    integrators: np.ndarray  # (powers, sensors, sections, 2)
    shaping: np.ndarray
    shaped_integrators: np.ndarray
    error: np.ndarray
    weights: np.ndarray  # (actuators, regressors), W
    covariance: np.ndarray  # (regressors, regressors), P
    power: np.ndarray  # (1,): sum of e'e since the last kept weights


class Signals(NamedTuple):
    """What a block of samples leaves behind; arrays of length 0 are not kept."""

    platform: np.ndarray  # (samples, outputs), a1 without noise
    measured: np.ndarray  # (samples, outputs), conditioned and noisy
    sensed: np.ndarray  # (samples, sensors), conditioned and noisy floor
    command: np.ndarray  # (samples, actuators)
    regressors: np.ndarray  # (samples, regressors), psi_N
    error: np.ndarray  # (samples, actuators), e
    weights: np.ndarray  # (samples / keep_every, actuators, regressors)
    power: np.ndarray  # (samples / keep_every,), mean of e'e over the interval


def system_of(twin: Twin, feedback: bool) -> System:
    """Coefficients of a twin's loop; without `feedback` the skyhook is open."""
    a, b, c, d = twin.plant.discrete(twin.sample_time)
    skyhook = twin.skyhook_filter if feedback else 0 * twin.skyhook_filter + [0, 0, 0, 1, 0, 0]
    error = twin.error_filter
    diagonal = twin.feedforward.estimate == "diagonal"
    return System(
        plant=np.ascontiguousarray(np.block([[a, b], [c, d]]).T),
        floor_inertia=twin.plant.floor_inertia,
        actuator=_rows(twin.instruments.actuator),
        parasitic=_rows(twin.instruments.parasitic),
        conditioning=_rows(twin.instruments.conditioning),
        skyhook=_rows(skyhook),
        integrator=_rows(twin.integrator),
        shaping=_rows(twin.noise_shaping),
        error=_rows(error.sections[:1] if diagonal else error.sections),
        before=np.zeros((0, 0)) if diagonal else np.ascontiguousarray(error.before),
        after=np.zeros((0, 0)) if diagonal else np.ascontiguousarray(error.after),
    )


def _rows(sections: np.ndarray) -> np.ndarray:
    """Sections of scipy, (..., sections, 6), as the kernel's (channels, sections, 5)."""
    sections = np.atleast_3d(sections) if sections.ndim == 3 else sections[None]
    if not np.allclose(sections[..., 3], 1):
        raise InputError("sections: a leading denominator coefficient is not 1; normalise them")
    return np.ascontiguousarray(np.delete(sections, 3, axis=2))


def rest(twin: Twin, system: System, weights: np.ndarray, covariance: np.ndarray) -> State:
    """State of a loop at rest with the given weights."""
    outputs, sensors, powers = twin.outputs, twin.sensors, twin.feedforward.integrator_powers

    def memory(channels, coefficients):
        return np.zeros((channels, coefficients.shape[1], 2))

    integrators = np.zeros((powers, sensors, system.integrator.shape[1], 2))
    return State(
        plant=np.zeros(2 * len(twin.plant.mass)),
        command=np.zeros(twin.actuators),
        actuator=memory(twin.actuators, system.actuator),
        parasitic=memory(twin.actuators, system.parasitic),
        platform_conditioning=memory(outputs, system.conditioning),
        floor_conditioning=memory(sensors, system.conditioning),
        skyhook=memory(outputs, system.skyhook),
        integrators=integrators,
        shaping=memory(sensors, system.shaping),
        shaped_integrators=integrators.copy(),
        error=memory(outputs, system.error),
        weights=np.array(weights, dtype=np.float64),
        covariance=np.array(covariance, dtype=np.float64),
        power=np.zeros(1),
    )


@kernel
def _filter(coefficients, state, values):
    """One sample of every channel through its cascade, in place; one cascade may serve all channels."""
    shared = coefficients.shape[0] == 1
    for c in range(len(values)):
        row = 0 if shared else c
        value = values[c]
        for s in range(coefficients.shape[1]):
            out = coefficients[row, s, 0] * value + state[c, s, 0]
            state[c, s, 0] = coefficients[row, s, 1] * value - coefficients[row, s, 3] * out + state[c, s, 1]
            state[c, s, 1] = coefficients[row, s, 2] * value - coefficients[row, s, 4] * out
            value = out
        values[c] = value


@kernel
def _filter_block(coefficients, state, signals):
    """A block of samples, (samples, channels), through the cascades, in place."""
    for k in range(len(signals)):
        _filter(coefficients, state, signals[k])


@kernel
def _stack(integrator, state, values, stacked):
    """Regressors [x, beta H x, (beta H)^2 x, ...] of one sample x; overwrites `values`."""
    sensors = len(values)
    for i in range(sensors):
        stacked[i] = values[i]
    for power in range(len(state)):
        _filter(integrator, state[power], values)
        for i in range(sensors):
            stacked[(power + 1) * sensors + i] = values[i]


@kernel
def _advance(
    floor,
    floor_noise,
    platform_noise,
    system,
    state,
    signals,
    keep_every,
    phase,
    adaptation,
    step_size,
    regularisation,
    trace_copies,
    forgetting,
    limits,
    force_limit,
):
    """Advance the loop over a block; returns (status, samples done).

    Parameters
    ----------
    floor, floor_noise : (samples, sensors)
        a0 and n0.
    platform_noise : (samples, outputs)
        n1.
    system, state, signals
        `System`, `State` (changed in place), `Signals` (filled).
    keep_every : int
        Samples between two kept weights.
    phase : int
        Samples since the last kept weights when the block starts.
    adaptation : int
        FROZEN, FELMS or FERLS.
    step_size, regularisation, trace_copies : float
        mu, epsilon and the trace's reading, for FELMS.
    forgetting : float
        lambda, for FERLS.
    limits : (regressors,)
        Cap of the diagonal of P, for FERLS.
    force_limit : float
        A command beyond it, or NaN, stops the block.
    """
    samples, sensors = floor.shape
    outputs = platform_noise.shape[1]
    actuators, count = state.weights.shape
    states = len(state.plant)
    force = np.empty(actuators)
    parasitic = np.empty(actuators)
    response = np.empty(states + outputs)
    measured = np.empty(outputs)
    damping = np.empty(outputs)
    sensed = np.empty(sensors)
    regressor = np.empty(count)
    shaped = np.empty(count)
    axes = np.empty(outputs)
    error = np.empty(actuators)
    gain = np.empty(count)
    full = system.before.shape[0] > 0

    for k in range(samples):
        # Force: the command of the sample before, through the actuator's lag.
        for i in range(actuators):
            force[i] = state.command[i]
        _filter(system.actuator, state.actuator, force)
        for i in range(actuators):
            parasitic[i] = force[i]
        _filter(system.parasitic, state.parasitic, parasitic)

        # Plant.
        for i in range(states + outputs):
            response[i] = 0.0
        for j in range(states):
            value = state.plant[j]
            for i in range(states + outputs):
                response[i] += system.plant[j, i] * value
        for j in range(actuators):
            value = force[j]
            for i in range(states + outputs):
                response[i] += system.plant[states + j, i] * value
        for j in range(sensors):
            value = floor[k, j]
            for i in range(states + outputs):
                response[i] += system.plant[states + actuators + j, i] * value
        for i in range(states):
            state.plant[i] = response[i]

        # Sensors.
        for i in range(outputs):
            response[states + i] += parasitic[i]
            measured[i] = response[states + i] + platform_noise[k, i]
        _filter(system.conditioning, state.platform_conditioning, measured)
        for i in range(sensors):
            sensed[i] = floor[k, i] + floor_noise[k, i]
        _filter(system.conditioning, state.floor_conditioning, sensed)
        if len(signals.sensed):
            signals.platform[k] = response[states:]
            signals.measured[k] = measured
            signals.sensed[k] = sensed

        # Regressors psi and psi_N = N psi: N acts on the sensors, before the integrators.
        for i in range(sensors):
            gain[i] = sensed[i]
        _stack(system.integrator, state.integrators, gain[:sensors], regressor)
        _filter(system.shaping, state.shaping, sensed)
        _stack(system.integrator, state.shaped_integrators, sensed, shaped)

        # Filtered error, eq. (16).
        if full:
            for i in range(outputs):
                total = 0.0
                for j in range(outputs):
                    total += system.before[i, j] * measured[j]
                axes[i] = total
            _filter(system.error, state.error, axes)
            for i in range(actuators):
                total = 0.0
                for j in range(outputs):
                    total += system.after[i, j] * axes[j]
                error[i] = total
        else:
            for i in range(outputs):
                error[i] = measured[i]
            _filter(system.error, state.error, error)

        # Command: feedforward (13), skyhook (1), and what the floor's inertia adds to the same path.
        for i in range(outputs):
            damping[i] = measured[i]
        _filter(system.skyhook, state.skyhook, damping)
        squares = 0.0
        for i in range(actuators):
            total = -damping[i]
            for j in range(count):
                total += state.weights[i, j] * regressor[j]
            # Not (a <= b) is true for NaN as well.
            if not abs(total) <= force_limit:
                return OVERLOAD, k
            if len(signals.command):
                signals.command[k, i] = total
            for j in range(sensors):
                total += system.floor_inertia[i, j] * floor[k, j]
            state.command[i] = total
            squares += error[i] * error[i]

        if adaptation == FELMS:
            _felms_update(state.weights, shaped, error, step_size, regularisation, trace_copies)
        elif adaptation == FERLS:
            _ferls_update(state.weights, state.covariance, shaped, error, forgetting, limits, gain)
            for i in range(count):
                if not state.covariance[i, i] > 0.0:
                    return INDEFINITE, k

        if len(signals.regressors):
            signals.regressors[k] = shaped
            signals.error[k] = error
        state.power[0] += squares
        if (phase + k + 1) % keep_every == 0:
            row = (phase + k) // keep_every
            signals.weights[row] = state.weights
            signals.power[row] = state.power[0] / keep_every
            state.power[0] = 0.0
    return STABLE, samples
