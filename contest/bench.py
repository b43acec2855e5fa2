r"""The test bench: a machine moves along a scan under its controller, with or without an observer in the loop.

At sample k the observer is given the force that was held since the last sample, and the measurement, NaN where it
was lost; it returns the modal states of the nominal model, :math:`(\eta_1, \dot\eta_1, \eta_2, \ldots)`.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace

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
PUSHED = 840  # sample of a loop's scan from which on an unknown force acts
PUSH = 0.02  # that force over the move's largest
LEAD = 5.0  # of the controllers: with the thesis's 3 the rigid body alone has a sensitivity near 6 dB
# Bandwidth over the first flexible frequency: without and with an observer, and those that are tried.
BANDWIDTH_RATIO_LOW, BANDWIDTH_RATIO_HIGH = 1 / 16, 1 / 2.5
BANDWIDTH_RATIOS = 2.0 ** (np.arange(8) / 2) / 8
PEAK = 2.0  # largest sensitivity that is allowed, 6 dB
PERIOD = 1024  # samples of the multisine that measures it, on these lines
LINES = np.unique(np.geomspace(4, 400, 40).astype(int))
DIVERGENCE_LIMIT = 0.1  # error over the stroke, at which a loop is switched off
ADDED = 0.05  # damping ratio that active damping is to add to every flexible mode


@dataclass(frozen=True)
class Bench:
    """What a bench runs: the true machine, the controller, and how estimates act on the loop."""

    truth: Truth
    control: tuple  # sampled controller of one rigid-body coordinate: A, B, C
    directions: tuple  # a row each: rigid-body coordinates of a measurement, forces of their commands
    setpoint: Float64[
        np.ndarray, "samples 3"
    ]  # of the first coordinate: position, acceleration, added to the error
    compensation: Float64[np.ndarray, "outputs states"]  # what the flexible modes put into the measurements
    damping: Float64[np.ndarray, "inputs states"]
    limit: float  # error at which the loop is switched off

    @property
    def system(self) -> tuple:
        """All of it as the kernels take it."""
        t = self.truth
        known = (*self.control, *self.directions, self.setpoint, self.compensation, self.damping)
        return tuple(map(np.ascontiguousarray, (t.a, t.b, t.c, t.process, t.sensor, t.lost, *known)))

    def memory(self) -> tuple:
        """States of machine and controllers, the last measurement and force, all outputs and controlled errors so far."""
        t, controllers = self.truth, (len(self.directions[0]), len(self.control[0]))
        sizes = (t.a.shape[1], controllers, t.sensor.shape[1], t.b.shape[2], t.sensor.shape, len(t.sensor))
        return tuple(np.zeros(size) for size in sizes)


def assemble(plant: ContestPlant, truth: Truth, ratio: float, estimated: bool) -> Bench:
    """The loop at a bandwidth of `ratio` times the first flexible frequency, open to estimates or not."""
    model, rigid = plant.model, plant.model.rigid_modes
    control = zoh(PidFamily(1.0, lead=LEAD)(ratio * plant.lowest_hz).state_space(), plant.sample_time)
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
    limit = DIVERGENCE_LIMIT * float(np.abs(setpoint[:, 0]).max())
    return Bench(truth, controller, directions, setpoint, compensation, damping, limit)


def scan_setpoint(plant: ContestPlant, samples: int) -> Float64[np.ndarray, "samples 3"]:
    """A raised cosine of acceleration from a twentieth to three tenths of the record, then constant velocity."""
    phase = np.clip((np.arange(samples) / samples - 0.05) / 0.25, 0, 1)
    acceleration = plant.acceleration * (1 - np.cos(2 * np.pi * phase)) / 2
    velocity = np.cumsum(acceleration) * plant.sample_time
    return np.stack([np.cumsum(velocity) * plant.sample_time, acceleration, np.zeros_like(velocity)], axis=1)


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
        position, acceleration, added = setpoint[k] if r == 0 else np.zeros(3)
        error = minus_row(position, to_rigid, r, compensated) + added
        if r == 0:
            memory[5][k] = error
        command = plus_row(acceleration, z, r, cc)
        copy_vector(ca @ z[r] + cb * error, z[r])
        add_scaled(command, to_force[r], force)
    copy_vector(a[piece] @ x + b[piece] @ (force + process[k]), x)


@kernel
def _go_on(k, system, delay, memory, estimate, measured):
    # From the estimate of sample k - 1 to the measurement of sample k.
    if k > 0:
        _actuate(k - 1, system, memory, estimate)
    _observe(k, system, delay, memory, measured)


@kernel
def _record(system, delay, memory, inputs, measurements, states):
    still = np.zeros(system[12].shape[1])
    for k in range(len(states)):
        _go_on(k, system, delay, memory, still, measurements[k])
        copy_vector(memory[3], inputs[k])
        copy_vector(memory[0], states[k])


@dataclass(frozen=True)
class ScanRecord:
    """A scan: what the observer is given, and what it is to find."""

    inputs: Float64[np.ndarray, "samples inputs"]  # held until the sample
    measurements: Float64[np.ndarray, "samples outputs"]
    states: Float64[np.ndarray, "samples states"]  # true, those modelled by the observer first


def record(machine: Bench) -> ScanRecord:
    """Run the loop without an observer."""
    t = machine.truth
    samples, outputs = t.sensor.shape
    arrays = (np.zeros((samples, n)) for n in (t.b.shape[2], outputs, t.a.shape[1]))
    done = ScanRecord(*arrays)
    _record(machine.system, t.delay, machine.memory(), done.inputs, done.measurements, done.states)
    return done


def loop_errors(machine: Bench, states: np.ndarray) -> Float64[np.ndarray, "2"]:
    """Root mean square error of the first rigid-body coordinate, as the true outputs show it.

    First of the scan, then from the sample on at which `push` acts. Infinite where the loop has run away before its end.
    """
    with np.errstate(invalid="ignore"):  # infinite states
        error = machine.setpoint[:, 0] - states @ machine.truth.c.T @ machine.directions[0][0]
    parts = error[JUDGED.start : PUSHED], error[PUSHED:]
    return np.array([np.sqrt(np.mean(part**2)) if np.isfinite(part).all() else np.inf for part in parts])


def push(plant: ContestPlant, truth: Truth) -> Truth:
    """The same with an unknown force along the first rigid-body coordinate in the scan's last part."""
    process, shapes = truth.process.copy(), plant.model.input_shapes[: plant.model.rigid_modes]
    process[PUSHED:] += PUSH * plant.acceleration * np.linalg.pinv(shapes).T[0]
    return replace(truth, process=process)


Scan = Generator[tuple[np.ndarray, np.ndarray, np.ndarray], np.ndarray, np.ndarray]


def loop_scan(machine: Bench, memory: tuple | None = None) -> Scan:
    """A scan with the observer in the loop, sample by sample: input, measurement and true state for an estimate each.

    Returns the true states, infinite once the loop has run away.
    """
    t, memory = machine.truth, memory or machine.memory()
    system, measured = machine.system, np.zeros(t.sensor.shape[1])
    states = np.full((len(t.sensor), t.a.shape[1]), np.inf)
    estimate = np.zeros(machine.damping.shape[1])
    for k in range(len(states)):
        _go_on(k, system, t.delay, memory, estimate, measured)
        if not abs(machine.directions[0][0] @ memory[2] - machine.setpoint[k, 0]) < machine.limit:
            break
        states[k] = memory[0]
        estimate = yield memory[3].copy(), measured.copy(), memory[0]
    return states


def run_scan(scan: Scan, step: Callable) -> np.ndarray:
    """Run a scan: ``step(input, measurement, true state)`` estimates each sample."""
    given = next(scan)
    while True:
        try:
            given = scan.send(step(*given))
        except StopIteration as end:
            return end.value


def sensitivity_peak(plant: ContestPlant, truth: Truth, ratio: float, run: Callable) -> float:
    """Largest sensitivity at the first controller's input with the observer in the loop; infinite where that runs away.

    A multisine is added to the error, a period to settle and one that is measured; ``run(scan)`` runs an observer.
    """
    machine = assemble(plant, truth, ratio, estimated=True)
    phases = np.pi * np.arange(len(LINES)) ** 2 / len(LINES)  # Schroeder's, for a low crest
    turns = 2 * np.pi * np.outer(np.arange(len(truth.sensor)), LINES) / PERIOD
    size = 300 * truth.sensor.std() / np.linalg.norm(plant.model.output_shapes[:, 0])
    added = size * np.cos(turns + phases).sum(axis=1) / np.sqrt(len(LINES) / 2)
    setpoint = np.zeros_like(machine.setpoint)
    setpoint[:, 2] = added
    machine = replace(machine, setpoint=setpoint, limit=100 * size)
    memory = machine.memory()
    if not np.isfinite(run(loop_scan(machine, memory))).all():
        return np.inf
    errors, added = (np.fft.rfft(each[-PERIOD - 1 : -1])[LINES] for each in (memory[5], added))
    return float(np.abs(errors / added).max())


def allowed_bandwidth(plant: ContestPlant, truth: Truth, run: Callable) -> float:
    """Largest bandwidth over the first flexible frequency, of those tried by bisection, with sensitivity up to `PEAK`."""
    low, high = 0, len(BANDWIDTH_RATIOS)  # so many are allowed at least, and at most
    while low < high:
        middle = (low + high + 1) // 2
        if sensitivity_peak(plant, truth, BANDWIDTH_RATIOS[middle - 1], run) <= PEAK:
            low = middle
        else:
            high = middle - 1
    return float(BANDWIDTH_RATIOS[low - 1]) if low else 0.0


def state_errors(record: ScanRecord, estimates: np.ndarray, rigid: int) -> tuple[float, float]:
    """Errors of the rigid-body and the flexible states over the scan, relative to those of the estimate zero.

    Each state counts alike: root mean square over the states of the ratios of root mean squares. Infinite of
    estimates that are not finite.
    """
    if not np.isfinite(estimates[JUDGED]).all():
        return np.inf, np.inf
    true = record.states[JUDGED, : estimates.shape[1]]
    with np.errstate(over="ignore"):  # beyond all numbers is infinite
        ratios = np.mean((true - estimates[JUDGED]) ** 2, axis=0) / np.mean(true**2, axis=0)
    return float(np.sqrt(ratios[: 2 * rigid].mean())), float(np.sqrt(ratios[2 * rigid :].mean()))
