r"""Scans of uncertain plants for the comparison of observers, section 5.4.3 of the observer thesis.

One controller and one feedforward move every plant along the setpoint while the sensor slides along the
structure; what is recorded is the input, the measurement and the true states.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.machines import (
    published_deviations,
    published_setpoint,
    shapes_along,
    stage,
    stage_mass,
)
from experiments.motion.uncertainty import perturbed
from stillwork.base.algebra import advance_state, copy_vector, plus_row
from stillwork.base.checks import InputError
from stillwork.base.kernels import kernel
from stillwork.control.pid import PidFamily
from stillwork.control.setpoint import Setpoint
from stillwork.estimation.riccati import discrete_gain
from stillwork.estimation.time_varying import TimeVaryingModel
from stillwork.lti.discretisation import zoh, zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


@dataclass(frozen=True)
class Scan:
    """What all plants of a study share."""

    nominal: ModalModel  # with one output a grid point
    shapes: Float64[np.ndarray, "samples modes"]  # nominal output shape at every sample
    setpoint: Setpoint
    controller: StateModel  # sampled
    mass: float  # kg, of the acceleration feedforward
    deviations: tuple[float, float, float]  # of w (N), v (m) and d (m), each sample anew

    @property
    def sample_time(self) -> float:
        """Sample time, s."""
        return self.setpoint.sample_time


@dataclass(frozen=True)
class Records:
    """Recorded scans of several plants."""

    u: Float64[np.ndarray, "runs inputs samples"]  # N, force of controller and feedforward
    y: Float64[np.ndarray, "runs outputs samples"]  # m, measurement
    states: Float64[np.ndarray, "runs states samples"]  # true modal states, form 1


def published_scan(spacing: float = 0.05, bandwidth_hz: float = 30.0, sample_time: float = 1e-4) -> Scan:
    """Section 5.4.3: the first three modes of the stage on the setpoint of Fig. 3.32.

    Not published, and set here: the masses stand `spacing` metres apart, the move is centred on them, the
    controller is (3.1) at `bandwidth_hz`, the sample time is `sample_time`.
    """
    plant = stage().modes(slice(0, 3))
    setpoint = published_setpoint(sample_time)
    grid = spacing * np.arange(len(plant.output_shapes))
    position = setpoint.derivatives[0]
    start = (grid[-1] - position[-1]) / 2
    return Scan(
        plant,
        shapes_along(plant, grid, start + position),
        setpoint,
        zoh(PidFamily(stage_mass())(bandwidth_hz).state_space(), sample_time),
        stage_mass(),
        tuple(published_deviations().values()),
    )


def filter_model(scan: Scan) -> TimeVaryingModel:
    """Nominal model for the filters."""
    w, v, d = scan.deviations
    return along_scan(scan.nominal, scan.sample_time, scan.shapes, w**2, v**2 + d**2)


def along_scan(
    machine: ModalModel,
    sample_time: float,
    shapes: Float64[np.ndarray, "samples modes"],
    process: float,
    sensor: float,
) -> TimeVaryingModel:
    """A sampled machine under a moving sensor, started from the stationary covariance at the first place.

    `process` and `sensor` are the variances of w (N^2) and of the measurement (m^2).
    """
    sampled, c = zoh_modes(machine, sample_time), output_rows(shapes)
    q, r = np.array([[process]]), np.array([[sensor]])
    start = discrete_gain(sampled.a, sampled.b, c[0], q, r)
    initial = start.covariance - start.filter_gain @ c[0] @ start.covariance
    return TimeVaryingModel(sampled.a, sampled.b, sampled.b, c, q, r, (initial + initial.T) / 2)


def output_rows(shapes: Float64[np.ndarray, "samples modes"]) -> Float64[np.ndarray, "samples 1 states"]:
    """C at every sample for modal states of form 1 and a position sensor."""
    c = np.zeros((len(shapes), 1, 2 * shapes.shape[1]))
    c[:, 0, ::2] = shapes
    return c


def record_scans(scan: Scan, errors: Sequence[ArrayLike], rng: np.random.Generator) -> Records:
    """Simulate one scan for every plant, exactly at the samples, with fresh noise for each."""
    samples, runs, control = len(scan.shapes), len(errors), scan.controller
    factors = 1 + np.asarray(errors, float)
    if np.any(np.diff(scan.nominal.frequencies * factors[:, :, 0]) < 0):
        raise InputError("errors are so large that two modes change places; give smaller ones")
    sampled = [zoh_modes(perturbed(scan.nominal, error), scan.sample_time) for error in errors]
    noise = rng.standard_normal((runs, 3, samples)) * np.array(scan.deviations)[:, None]
    states = np.zeros((runs, samples, len(sampled[0].a)))
    u, y = np.zeros((runs, samples)), np.zeros((runs, samples))
    _scan(
        np.array([m.a for m in sampled]),
        np.array([m.b[:, 0] for m in sampled]),
        scan.shapes * factors[:, None, :, 3],
        contiguous(scan.setpoint.derivatives[0], scan.mass * scan.setpoint.derivatives[2]),
        contiguous(control.a, control.b[:, 0], control.c),
        noise,
        states,
        u,
        y,
    )
    return Records(u[:, None], y[:, None], np.ascontiguousarray(np.swapaxes(states, 1, 2)))


def contiguous(*arrays) -> tuple[np.ndarray, ...]:
    """Arrays as kernels take them."""
    return tuple(np.ascontiguousarray(array) for array in arrays)


@kernel
def _scan(a, b, shapes, given, control, noise, states, u, y):
    (runs, samples, n), (reference, forward), (ca, cb, cc) = states.shape, given, control
    m = ca.shape[0]
    for run in range(runs):
        plant, into, seen = a[run], b[run], shapes[run]
        x, following, z, z_following = np.zeros(n), np.zeros(n), np.zeros(m), np.zeros(m)
        positions = x[::2]
        for k in range(samples):
            copy_vector(x, states[run, k])
            u[run, k] = force = plus_row(forward[k], cc, 0, z)
            y[run, k] = output = plus_row(noise[run, 2, k] - noise[run, 1, k], seen, k, positions)
            advance_state(ca, cb, reference[k] - output, z, z_following)
            advance_state(plant, into, force + noise[run, 0, k], x, following)


@dataclass(frozen=True)
class Errors:
    """Estimation errors over the scanning phase, per run and state (SI units)."""

    rms: Float64[np.ndarray, "runs states"]
    bias: Float64[np.ndarray, "runs states"]  # mean
    drift: Float64[np.ndarray, "runs states"]  # change over the phase, of the straight line through the error
    size: Float64[np.ndarray, "runs states"]  # rms of the true state about its mean, over the same phase
    end: Float64[np.ndarray, "runs states"]  # error at the end of the phase
    accelerating: Float64[np.ndarray, "runs states"]  # rms error outside the phase of constant velocity
    move: Float64[np.ndarray, "runs states"]  # rms error over the whole move ...
    move_size: Float64[np.ndarray, "runs states"]  # ... and rms of the true state

    def flexible(self) -> Float64[np.ndarray, " runs"]:
        """Root mean square over the flexible states of error over true size: what MC and AD live on."""
        return np.sqrt(np.mean((self.rms[:, 2:] / self.size[:, 2:]) ** 2, axis=1))


def judge(scan: Scan, records: Records, estimates: ArrayLike) -> Errors:
    """Errors of the estimates of all runs in the scanning phase."""
    estimates = np.asarray(estimates, float)
    window = scan.setpoint.scanning
    true = records.states[:, :, window]
    whole = records.states - estimates
    error = whole[:, :, window]
    # The snap segments at both ends of the move: everything before the settling and after the scan.
    time = scan.setpoint.time
    moving = (time < scan.setpoint.acceleration_end) | (~window & (time > scan.setpoint.scan[0]))
    line = np.linspace(-1, 1, window.sum())
    return Errors(
        rms(error),
        error.mean(axis=2),
        2 * (error @ line) / (line @ line),
        true.std(axis=2),
        error[:, :, -1],
        rms(whole[:, :, moving]),
        rms(whole),
        rms(records.states),
    )


def rms(signals: np.ndarray) -> np.ndarray:
    """Root mean square along the last axis."""
    return np.sqrt(np.mean(signals**2, axis=-1))
