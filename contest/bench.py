r"""The test bench: a machine moves along a scan under its controller, with or without an observer in the loop.

At sample k the observer is given the force that was held since the last sample, and the measurement, NaN where it
was lost; it answers with the modal states of the nominal model, :math:`(\eta_1, \dot\eta_1, \eta_2, \ldots)`.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from contest.plants import ContestPlant
from contest.uncertainties import Truth
from stillwork.base.algebra import add_product, add_scaled, copy_vector, minus_row, plus_row
from stillwork.base.kernels import kernel, pasted_kernel
from stillwork.control.pid import PidFamily
from stillwork.lti.discretisation import zoh

SAMPLES = 1200  # of a record
JUDGED = slice(480, None)  # the machine scans with constant velocity
BANDWIDTH_RATIO_LOW, BANDWIDTH_RATIO_HIGH = (
    1 / 16,
    1 / 2.5,
)  # bandwidth over the first flexible frequency: without and with an observer
DIVERGENCE_LIMIT = 0.1  # error over the stroke, at which a loop is switched off
ADDED = 0.05  # damping ratio that active damping is to add to every flexible mode


@dataclass(frozen=True)
class Bench:
    """What a bench runs: the true machine, the controller, and how estimates act on the loop."""

    truth: Truth
    control: tuple  # sampled controller of one rigid-body coordinate: A, B, C
    directions: tuple  # a row each: rigid-body coordinates of a measurement, forces of their commands
    setpoint: Float64[np.ndarray, "samples 2"]  # position and acceleration of the first coordinate
    compensation: Float64[np.ndarray, "outputs states"]  # what the flexible modes put into the measurements
    damping: Float64[np.ndarray, "inputs states"]

    @property
    def system(self) -> tuple:
        """All of it as the kernels take it."""
        t = self.truth
        known = (*self.control, *self.directions, self.setpoint, self.compensation, self.damping)
        return tuple(map(np.ascontiguousarray, (t.a, t.b, t.c, t.process, t.sensor, t.lost, *known)))

    def memory(self) -> tuple:
        """States of machine and controllers, the last measurement and force, all outputs so far."""
        t, controllers = self.truth, (len(self.directions[0]), len(self.control[0]))
        sizes = (t.a.shape[1], controllers, t.sensor.shape[1], t.b.shape[2], t.sensor.shape)
        return tuple(np.zeros(size) for size in sizes)


def assemble(plant: ContestPlant, truth: Truth, ratio: float, estimated: bool) -> Bench:
    """The loop at a bandwidth of `ratio` times the first flexible frequency, open to estimates or not."""
    model, rigid = plant.model, plant.model.rigid_modes
    control = zoh(PidFamily(1.0)(ratio * plant.lowest_hz).state_space(), plant.sample_time)
    states = 2 * len(model.frequencies)
    compensation = np.zeros((len(model.output_shapes), states))
    damping = np.zeros((model.input_shapes.shape[1], states))
    if estimated:
        compensation[:, 2 * rigid :: 2] = model.output_shapes[:, rigid:]
        shapes, omega = model.input_shapes[rigid:], model.frequencies[rigid:]
        gains = 2 * ADDED * omega / np.sum(shapes**2, axis=1).max()
        damping[:, 2 * rigid + 1 :: 2] = shapes.T * gains
    directions = (
        np.linalg.pinv(model.output_shapes[:, :rigid]),
        np.linalg.pinv(model.input_shapes[:rigid]).T,
    )
    controller = control.a, control.b[:, 0], control.c[0]
    setpoint = scan_setpoint(plant, len(truth.sensor))
    return Bench(truth, controller, directions, setpoint, compensation, damping)


def scan_setpoint(plant: ContestPlant, samples: int) -> Float64[np.ndarray, "samples 2"]:
    """A raised cosine of acceleration from a twentieth to three tenths of the record, then constant velocity."""
    phase = np.clip((np.arange(samples) / samples - 0.05) / 0.25, 0, 1)
    acceleration = plant.acceleration * (1 - np.cos(2 * np.pi * phase)) / 2
    velocity = np.cumsum(acceleration) * plant.sample_time
    return np.stack([np.cumsum(velocity) * plant.sample_time, acceleration], axis=1)


@pasted_kernel
def _observe(k, system, delay, memory, measured):
    # The measurement of sample k, NaN where it is lost; the controller keeps the last one.
    c, sensor, lost = system[2], system[4], system[5]
    x, held, seen = memory[0], memory[2], memory[4]
    copy_vector(sensor[k], seen[k])
    add_product(c, x, seen[k])
    for o in range(c.shape[0]):
        measured[o] = np.nan if lost[k] else seen[max(k - delay, 0), o]
        if not lost[k]:
            held[o] = measured[o]


@kernel
def _actuate(k, system, memory, estimate):
    # Controller, feedforward and what the estimate adds; then the machine goes on to sample k + 1.
    a, b, process = system[0], system[1], system[3]
    ca, cb, cc, to_rigid, to_force, setpoint, compensation, damping = system[6:]
    x, z, held, force = memory[0], memory[1], memory[2], memory[3]
    piece = k * a.shape[0] // process.shape[0]
    compensated = held - compensation @ estimate
    copy_vector(-(damping @ estimate), force)
    for r in range(to_rigid.shape[0]):
        position, acceleration = (setpoint[k, 0], setpoint[k, 1]) if r == 0 else (0.0, 0.0)
        error = minus_row(position, to_rigid, r, compensated)
        command = plus_row(acceleration, z, r, cc)
        copy_vector(ca @ z[r] + cb * error, z[r])
        add_scaled(command, to_force[r], force)
    copy_vector(a[piece] @ x + b[piece] @ (force + process[k]), x)


@kernel
def _record(system, delay, memory, inputs, measurements, states):
    still = np.zeros(system[12].shape[1])
    for k in range(len(states)):
        copy_vector(memory[3], inputs[k])
        copy_vector(memory[0], states[k])
        _observe(k, system, delay, memory, measurements[k])
        _actuate(k, system, memory, still)


@dataclass(frozen=True)
class ScanRecord:
    """A scan: what the observer is given, and what it is to find."""

    inputs: Float64[np.ndarray, "samples inputs"]  # held until the sample
    measurements: Float64[np.ndarray, "samples outputs"]
    states: Float64[np.ndarray, "samples states"]  # true, of the modes that the observer knows of first


def record(machine: Bench) -> ScanRecord:
    """Run the loop without an observer."""
    t = machine.truth
    samples, outputs = t.sensor.shape
    arrays = (np.zeros((samples, n)) for n in (t.b.shape[2], outputs, t.a.shape[1]))
    done = ScanRecord(*arrays)
    _record(machine.system, t.delay, machine.memory(), done.inputs, done.measurements, done.states)
    return done


def tracking_errors(machine: Bench, states: np.ndarray) -> Float64[np.ndarray, "2"]:
    """Root mean square and peak over the scan of the first rigid-body coordinate's error, as the true outputs show it."""
    if not np.isfinite(states).all():
        return np.full(2, np.inf)
    error = machine.setpoint[JUDGED, 0] - states[JUDGED] @ machine.truth.c.T @ machine.directions[0][0]
    return np.array([np.sqrt(np.mean(error**2)), np.abs(error).max()])


Scan = Generator[tuple[np.ndarray, np.ndarray], np.ndarray, np.ndarray]


def open_scan(done: ScanRecord, states: int) -> Scan:
    """Give out what was recorded, sample by sample, for an estimate each; returns the estimates."""
    estimates = np.empty((len(done.inputs), states))
    for k in range(len(estimates)):
        estimates[k] = yield done.inputs[k].copy(), done.measurements[k].copy()
    return estimates


def loop_scan(machine: Bench) -> Scan:
    """The same of a scan with the observer in the loop; returns the true states, infinite once the loop has run away."""
    t, memory = machine.truth, machine.memory()
    system, measured = machine.system, np.zeros(t.sensor.shape[1])
    states = np.full((len(t.sensor), t.a.shape[1]), np.inf)
    limit = DIVERGENCE_LIMIT * np.abs(machine.setpoint[:, 0]).max()
    for k in range(len(states)):
        _observe(k, system, t.delay, memory, measured)
        if not np.abs(machine.directions[0][0] @ memory[2] - machine.setpoint[k, 0]) < limit:
            break
        states[k] = memory[0]
        _actuate(k, system, memory, (yield memory[3].copy(), measured.copy()))
    return states


def run_scans(scans: Sequence[Scan], step: Callable) -> list[np.ndarray]:
    """Run scans side by side: ``step(numbers, inputs, measurements)`` estimates one sample of each that still goes on."""
    waiting = {number: next(scan) for number, scan in enumerate(scans)}
    results: dict[int, np.ndarray] = {}
    while waiting:
        inputs, measurements = (np.array(each) for each in zip(*waiting.values(), strict=True))
        for number, estimate in zip(list(waiting), step(list(waiting), inputs, measurements), strict=True):
            try:
                waiting[number] = scans[number].send(estimate)
            except StopIteration as end:
                results[number] = end.value
                del waiting[number]
    return [results[number] for number in range(len(scans))]


def state_errors(record: ScanRecord, estimates: np.ndarray, rigid: int) -> tuple[float, float]:
    """Errors of the rigid-body and the flexible states over the scan, relative to those of the estimate zero.

    Each state counts alike: root mean square over the states of the ratios of root mean squares. Infinite of
    estimates that are not finite.
    """
    if not np.isfinite(estimates[JUDGED]).all():
        return np.inf, np.inf
    true = record.states[JUDGED, : estimates.shape[1]]
    ratios = np.mean((true - estimates[JUDGED]) ** 2, axis=0) / np.mean(true**2, axis=0)
    return float(np.sqrt(ratios[: 2 * rigid].mean())), float(np.sqrt(ratios[2 * rigid :].mean()))
