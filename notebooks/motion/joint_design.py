"""Observer and controller designed together: what this notebook alone needs."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, lru_cache, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64
from matplotlib.lines import Line2D
from numpy.typing import ArrayLike
from scipy import linalg, optimize

from experiments.motion.designs import COMPENSATED, RETAINED
from experiments.motion.machines import (
    published_deviations,
    published_noise,
    published_setpoint,
    stage,
    stage_mass,
)
from experiments.motion.pictures import add_magnitude, mark_limit, plain
from experiments.motion.uncertainty import detuned, perturbed, sample_errors
from stillwork.base.algebra import squared_size
from stillwork.base.checks import InputError
from stillwork.base.kernels import kernel
from stillwork.base.toml_files import read_numbers
from stillwork.base.validation import checked
from stillwork.control.applications import filtered_estimates
from stillwork.control.bandwidth import SIX_DB
from stillwork.control.crossover import crossover
from stillwork.control.digital import observed_controller
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.control.pid import Pid
from stillwork.estimation.riccati import discrete_gain
from stillwork.lti.delays import delayed
from stillwork.lti.discretisation import prewarped, tustin, zoh_modes, zoh_response
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel
from workbook import figures, paths

# === Joint ========================================================================================================
# Observer and controller of the stage in one optimisation, the first recommendation of chapter 7, as a processor runs it.
#
# The structure is the published one: the PID controller (3.1), the Kalman observer with a noise model, compensation and
# damping through one band-pass a mode. All of it is sampled, and the whole control force is late: what sample k commands
# acts from `delay` samples later on, held for one. The observer has the force that acts at each moment, and predicts the
# velocities that it damps to the moment at which its force begins.


SAMPLE_TIME, DELAY = 1e-4, 1.5  # s, as in notebook 11; samples from command to force
CONTROLLER = ("bandwidth_hz", "integrator", "differentiator", "low_pass", "low_pass_damping")
OBSERVER = ("process", "noise_model", "damping", "selectivity")
NUMBERS = CONTROLLER + OBSERVER


@dataclass(frozen=True)
class JointDesign:
    """All numbers of an observer and its controller; the defaults are the published ones."""

    bandwidth_hz: float = 77.7  # f, design parameter of (3.1): Kp = M (2 pi f)^2/3
    integrator: float = 1.0  # over the 2 pi f / 9 of Table 3.3
    differentiator: float = 1 / 3  # over 2 pi f
    low_pass: float = 3.0  # over 2 pi f
    low_pass_damping: float = 0.7
    process: float = 1.0  # Q over the published one
    noise_model: float = 1e3  # Q_nu, N^2/s
    damping: tuple[float, ...] = (0.035, 0.035, 0.035)  # increase of each mode's ratio
    selectivity: tuple[float, ...] = (2.0, 2.0, 2.0)  # Q of each band-pass

    @property
    def controller(self) -> Pid:
        """The PID controller."""
        w = 2 * np.pi * self.bandwidth_hz
        rates = self.integrator * w / 9, self.differentiator * w, self.low_pass * w
        return Pid(_mass() * w**2 / 3, *rates, self.low_pass_damping)


_mass, _noise = cache(stage_mass), cache(published_noise)  # a search evaluates them thousands of times


class Late(NamedTuple):
    """A model of modes whose force is held and late: x+ = a x + new f(k-n) + old f(k-n-1), n whole samples of delay."""

    a: Float64[np.ndarray, "states states"]
    new: Float64[np.ndarray, " states"]
    old: Float64[np.ndarray, " states"]
    whole: int
    shapes: Float64[np.ndarray, "outputs modes"]


def late(model: ModalModel, delay: float = DELAY) -> Late:
    """Exact sampled modes of a model with one input; the delay in samples need not be whole."""
    whole = int(delay)
    part = delay - whole
    full, rest = zoh_modes(model, SAMPLE_TIME), zoh_modes(model, (1 - part) * SAMPLE_TIME)
    old = rest.a @ zoh_modes(model, part * SAMPLE_TIME).b[:, 0] if part else np.zeros(len(full.a))
    return Late(full.a, rest.b[:, 0], old, whole, model.output_shapes)


def late_response(moved: Late, omega: np.ndarray) -> Complex128[np.ndarray, "outputs frequencies"]:
    """From the command to all outputs at some frequencies (rad/s), mode by mode in closed form."""
    z = np.exp(1j * omega * SAMPLE_TIME)
    rows = np.arange(0, len(moved.a), 2)
    # The trace near 2 and the determinant near 1 cancel at low frequencies: write them as differences from 1.
    first, second = moved.a[rows, rows, None] - 1, moved.a[rows + 1, rows + 1, None] - 1
    cross, lifted = moved.a[rows, rows + 1, None], z - 1
    determinant = lifted**2 - lifted * (first + second) + first * second
    determinant -= cross * moved.a[rows + 1, rows, None]
    force = moved.new[:, None] + moved.old[:, None] / z
    position = ((lifted - second) * force[::2] + cross * force[1::2]) / determinant
    return moved.shapes @ (position / z**moved.whole)


def late_plant(moved: Late, mass: int) -> StateModel:
    """The plant as the processor meets it, measured at one mass: from the command to the position."""
    n, kept = len(moved.a), moved.whole + 1
    forces = np.zeros((n, kept + 1))  # f(k), ... f(k-n-1)
    forces[:, -2], forces[:, -1] = moved.new, moved.old
    a = np.block([[moved.a, forces[:, 1:]], [np.zeros((kept, n)), np.eye(kept, k=-1)]])
    b = np.vstack([forces[:, :1], np.eye(kept, 1)])
    c = np.zeros((1, n + kept))
    c[0, :n:2] = moved.shapes[mass - 1]
    return StateModel(a, b, c, np.zeros((1, 1)), SAMPLE_TIME)


@cache
def _observed() -> ModalModel:
    """The observers' model: the retained modes of the nominal stage, and what the others add at rest."""
    return truncate(stage(), RETAINED, COMPENSATED)


class Estimator(NamedTuple):
    """Observer of one mass, x+ = a x + by y + new f(k-n) + old f(k-n-1); it reads c x + dy y + dold f(k-n-1) + ..."""

    a: np.ndarray
    drive: np.ndarray  # (states, 1 + n + 1): of y, f(k-1), ... f(k-n-1), and of f(k) before them where n = 0
    c: np.ndarray  # (4, states): what the modes put into the measurement, and three velocities ahead
    direct: np.ndarray  # (4, 1 + n + 1)
    modal: tuple[np.ndarray, ...]  # eigenvalues of a, drive and c in its eigenvectors


@lru_cache(maxsize=8)  # a search moves the other numbers far more often
def estimators(process: float, noise_model: float, delay: float) -> tuple[Estimator, ...]:
    """The sampled Kalman observers of all seven masses."""
    model = _observed()
    whole, part = int(delay), delay - int(delay)
    modes, moved = zoh_modes(model, SAMPLE_TIME), late(model, delay)
    n = len(modes.a)

    def walked(a, b):  # a constant force, the noise model, pushes along
        return np.block([[a, b], [np.zeros((1, n)), np.ones((1, 1))]])

    a, drive = walked(modes.a, modes.b), linalg.block_diag(modes.b, 1.0)
    ahead = np.eye(n + 1)
    forces = np.zeros((n + 1, whole + 2))  # of f(k), ... f(k-n-1) on the state ahead
    for k in range(whole):
        ahead, forces = a @ ahead, a @ forces
        forces[:n, whole - k] += moved.new
        forces[:n, whole - k + 1] += moved.old
    if part:
        short = zoh_modes(model, part * SAMPLE_TIME)
        tail = walked(short.a, short.b)
        ahead, forces = tail @ ahead, tail @ forces
        forces[:n, 1] += short.b[:, 0]
    rows = np.eye(n + 1)[[3, 5, 7]]
    variances = np.diag([process * _noise().process / SAMPLE_TIME, noise_model * SAMPLE_TIME])
    found = []
    for shape, compliance in zip(model.output_shapes, model.feedthrough[:, 0], strict=True):
        c, flexible = np.zeros((1, n + 1)), np.zeros((1, n + 1))
        c[0, :n:2], flexible[0, 2:n:2] = shape, shape[1:]
        gain = discrete_gain(a, drive, c, variances, _noise().sensor / SAMPLE_TIME).filter_gain
        kept = np.eye(n + 1) - gain @ c
        # The compliance shows the force that acts when the sample is taken, f(k-n-1).
        acts = np.zeros((1, whole + 2))
        acts[0, -1] = compliance
        updated = np.hstack([gain, -gain @ acts])  # of y, f(k), ... f(k-n-1)
        into = a @ updated
        into[:n, 1 + whole] += moved.new
        into[:n, 2 + whole] += moved.old
        direct = np.vstack([flexible @ updated, rows @ ahead @ updated])
        direct[1:, 1:] += rows @ forces
        transition, read = a @ kept, np.vstack([flexible, rows @ ahead]) @ kept
        values, vectors = linalg.eig(transition)
        modal = values, linalg.solve(vectors, into), read @ vectors
        found.append(Estimator(transition, into, read, direct, modal))
    return tuple(found)


def sampled_compensator(design: JointDesign, mass: int, delay: float = DELAY) -> StateModel:
    """The block from (f, y) to (u_d, y_flex), see `stillwork.control.loops.closed_loop`."""
    found = estimators(design.process, design.noise_model, delay)[mass - 1]
    n, kept = len(found.a), int(delay) + 1
    a = np.block([[found.a, found.drive[:, 2:]], [np.zeros((kept, n)), np.eye(kept, k=-1)]])
    b = np.zeros((n + kept, 2))
    b[:n], b[n, 0] = found.drive[:, 1::-1], 1.0
    c, d = np.hstack([found.c, found.direct[:, 2:]]), found.direct[:, 1::-1]
    estimator, gain = StateModel(a, b, c, d, SAMPLE_TIME), _unit_gain() * design.damping
    centres = _observed().frequencies[1:].tolist()
    filters = [
        tustin(band_pass(w, q), SAMPLE_TIME, w) for w, q in zip(centres, design.selectivity, strict=True)
    ]
    return filtered_estimates(estimator, filters, gain[None])


@cache
def _unit_gain() -> np.ndarray:
    return damping_gain(_observed(), np.ones(RETAINED - 1))[0, 3::2]


def closed_poles(
    design: JointDesign,
    plants: Sequence[ModalModel],
    delay: float = DELAY,
    alone: int = 0,
    modelled: float | None = None,
) -> Complex128[np.ndarray, "plants masses states"]:
    """Poles z of the loops of all masses on every plant, by the eigenvalues of plant and controller together.

    `alone` (samples) delays the controller's output by itself, before the damping force is added; `modelled` is the
    delay in the observer, by default `delay`.
    """
    modelled = delay if modelled is None else modelled
    controller, found = delayed(tustin(design.controller.state_space(), SAMPLE_TIME), alone), []
    moved = [late(plant, delay) for plant in plants]
    for mass in range(1, 8):
        seen = observed_controller(controller, sampled_compensator(design, mass, modelled))  # from r, y and f
        into, direct = seen.b[:, 2:], seen.d[:, 1:2]
        a, b = seen.a + into @ seen.c, seen.b[:, 1:2] + into @ direct
        met = [late_plant(each, mass) for each in moved]
        found.append([np.block([[p.a + p.b @ direct @ p.c, p.b @ seen.c], [b @ p.c, a]]) for p in met])
    return np.swapaxes(np.linalg.eigvals(np.array(found)), 0, 1).astype(complex)


class Compensated(NamedTuple):
    """What a design puts around any plant, the masses and frequencies last."""

    feedback: Complex128[np.ndarray, "masses frequencies"]  # C_y, from -y to f
    reference: Complex128[np.ndarray, "masses frequencies"]  # C_r, from r to f
    share: Complex128[np.ndarray, "masses frequencies"]  # S_I is (share - seen P) S_O
    seen: Complex128[np.ndarray, "masses frequencies"]


def compensated(
    design: JointDesign, omega: np.ndarray, delay: float = DELAY, alone: int = 0, masses: slice = slice(None)
) -> Compensated:
    """The design's responses at some frequencies (rad/s), with an observer that includes `delay`."""
    z = np.exp(1j * omega * SAMPLE_TIME)
    estimates = _estimates(design.process, design.noise_model, delay, omega.tobytes())[:, masses]
    s = prewarped(omega, SAMPLE_TIME)
    w, q = _observed().frequencies[1:, None], np.array(design.selectivity)[:, None]
    warped = 1j * s * w * SAMPLE_TIME / 2 / np.tan(w * SAMPLE_TIME / 2)
    band = (_unit_gain() * design.damping)[:, None] * (w / q) * warped / (warped**2 + (w / q) * warped + w**2)
    (o_yy, o_yu) = estimates[:, :, 0]
    o_uy, o_uu = np.einsum("impf,pf->imf", estimates[:, :, 1:], band)
    pid = design.controller.frequency_response(s) / z**alone
    turn = 1 - pid * o_yu - o_uu
    return Compensated((pid * (1 - o_yy) - o_uy) / turn, pid / turn, (1 - o_uu) / turn, o_uy / turn)


@lru_cache(maxsize=8)
def _estimates(process: float, noise_model: float, delay: float, omega: bytes) -> np.ndarray:
    """From y and from f: y_flex and the velocities ahead, (2, masses, 4, frequencies), by the observers' eigenvectors."""
    z = np.exp(1j * np.frombuffer(omega) * SAMPLE_TIME)
    past = z ** -np.arange(int(delay) + 2)[:, None]
    out = []
    for each in estimators(process, noise_model, delay):
        values, drive, read = each.modal
        turn = 1 / (z - values[:, None])
        by_output = read @ (turn * drive[:, :1]) + each.direct[:, :1]
        by_force = read @ (turn * (drive[:, 1:] @ past)) + each.direct[:, 1:] @ past
        out.append((by_output, by_force))
    return np.swapaxes(np.array(out), 0, 1)


# === Joint search =================================================================================================
# The joint design judged and searched: peaks, scan error and noise of all seven masses on many stages at once.
#
# One grid of frequencies, that of the fast Fourier transform, serves the error of a move, the variance of noise and the
# peaks. A search trusts it; a verdict does not: `judge` looks between its points, at the closed loop's poles too.


_deviations = cache(published_deviations)  # a search evaluates them thousands of times

# Of the transform: 2.4 Hz between frequencies and 0.24 s for an error to die out while a search goes on, and four
# times as much of both for a verdict.
SAMPLES, JUDGED = 4096, 16384
PEAKS = ("S_I", "S_O", "r to e", "1 - S_I", "1 - S_O", "r to y")  # all six at most 6 dB
BANDS_HZ = (0.0, 60.0, 150.0, 350.0, 600.0, 1100.0, 5000.0)  # a search follows the largest peak in each
MEASURED = 4  # mass 5, at which the thesis evaluates a scan

# What may be free beside the controller's bandwidth, and where the numbers may stand.
FREE = {
    "rule": ("bandwidth_hz",),
    "controller": CONTROLLER,
    "observer": ("bandwidth_hz", *OBSERVER),
    "joint": NUMBERS,
}
LIMITS = {
    "bandwidth_hz": (15.0, 250.0),
    "integrator": (0.03, 4.0),
    "differentiator": (0.1, 1.0),
    "low_pass": (1.0, 30.0),
    "low_pass_damping": (0.4, 3.0),
    "process": (1e-3, 1e3),
    "noise_model": (1e-2, 1e7),
    "damping": (1e-4, 0.5),
    "selectivity": (0.1, 20.0),
}
RADIUS, SMALLEST_RADIUS = 0.2, 2e-3  # of the region in which a linear program is trusted, in logarithms
SMALLEST_GAIN = 5e-4  # of the error, relative; a step that brings less ends the search
PENALTY = 10.0  # a peak 1 % too high costs as much as 10 % of error


@cache
def grid(samples: int = SAMPLES) -> Float64[np.ndarray, " frequencies"]:
    """Frequencies of the transform, rad/s; the first, at which a rigid body has no response, a little above 0."""
    omega = 2 * np.pi * np.fft.rfftfreq(samples, SAMPLE_TIME)
    omega[0] = 1e-4 * omega[1]
    return omega


AHEAD = 10  # samples at rest before a move, in which its feedforward is already under way


@cache
def _move(delay: float, samples: int):
    """Transforms of the setpoint's steps and of what its four derivatives command, the move and the scan in it.

    A force acts for the sample that begins `delay` after its command: it is the mean over that time, which needs the
    setpoint at half samples.
    """
    if delay % 0.5 or not 0 <= delay < AHEAD - 2:
        raise InputError(f"delay is {delay:g}; give a multiple of half a sample, below {AHEAD - 2}")
    setpoint, half = published_setpoint(SAMPLE_TIME), published_setpoint(SAMPLE_TIME / 2).derivatives
    rest = samples - setpoint.derivatives.shape[1] - AHEAD
    steps = np.diff(np.pad(setpoint.derivatives[0], (AHEAD, rest), "edge"), prepend=0.0)
    shift = round(2 * delay)
    rows = np.pad(half[:4], ((0, 0), (2 * AHEAD - shift, 2 * rest + 2 + shift)), "edge")
    commands = np.diff(rows[:, : 2 * samples + 2 : 2], axis=1)[:, :samples] / SAMPLE_TIME
    move = slice(AHEAD, AHEAD + len(setpoint.time))
    return np.fft.rfft(steps), np.fft.rfft(commands, axis=1), move, setpoint.scanning


class StageResponse(NamedTuple):
    """A stage on the grid of a transform."""

    model: ModalModel
    plant: Complex128[np.ndarray, "masses frequencies"]  # from the command, late
    pushed: Complex128[np.ndarray, "masses frequencies"]  # from a force that is not late


def stage_response(model: ModalModel, delay: float = DELAY, samples: int = SAMPLES) -> StageResponse:
    """Prepare the responses of a stage."""
    omega = grid(samples)
    pushed = zoh_response(model, SAMPLE_TIME, omega)[:, 0]
    return StageResponse(model, late_response(late(model, delay), omega), pushed)


@kernel
def _tops(plant, feedback, reference, share, seen, ends, tops):
    """Logarithms of the largest of the six magnitudes in each band, between grid points by a parabola."""
    masses, n = plant.shape
    squares = np.empty((6, n))
    for m in range(masses):
        for k in range(n):
            p = plant[m, k]
            s = 1 / (1 + p * feedback[m, k])
            t = 1 - p * reference[m, k] * s
            i = (share[m, k] - seen[m, k] * p) * s
            for f, value in enumerate((i, s, t)):
                squares[f, k] = squared_size(value)
                squares[f + 3, k] = squares[f, k] - 2 * value.real + 1
        for f in range(6):
            for band in range(len(ends) - 1):
                top = ends[band]
                for k in range(ends[band], ends[band + 1]):
                    if squares[f, k] > squares[f, top]:
                        top = k
                value = 0.5 * np.log(squares[f, top])
                if 0 < top < n - 1:
                    low, high = 0.5 * np.log(squares[f, top - 1]), 0.5 * np.log(squares[f, top + 1])
                    bend = 2 * value - low - high
                    if low <= value and high <= value and bend > 0:
                        value += (high - low) ** 2 / (8 * bend)
                tops[m, f, band] = value


@cache
def _ends() -> np.ndarray:
    return np.searchsorted(grid(), 2 * np.pi * np.array(BANDS_HZ))


class Evaluation(NamedTuple):
    """What a design does on one stage, by the grid; logarithms of magnitudes."""

    tops: Float64[np.ndarray, "masses functions bands"]
    error: float  # m, rms of the true error in the scan, the noise's mean power included
    quiet: float  # m, without noise
    force: float  # N, rms of the whole control force under noise
    left: float  # m/N, rms of the true error between 100 and 200 ms after a step of a disturbing force


def evaluate(design: JointDesign, served: Sequence[StageResponse], delay: float = DELAY) -> list[Evaluation]:
    """Peaks of all masses, scan error and noise at mass 5, on every stage; what is unstable is not noticed here."""
    around = compensated(design, grid(), delay)
    feedback = around.feedback[MEASURED]
    found = []
    for each in served:
        tops = np.empty((len(each.plant), len(PEAKS), len(BANDS_HZ) - 1))
        _tops(each.plant, *around, _ends(), tops)
        seen = feedback, each.plant[MEASURED], each.pushed[MEASURED]
        found.append(Evaluation(tops, *scanned(*seen, delay), left_after_step(*seen)))
    return found


def _loop(plant: np.ndarray, around: Compensated) -> Complex128[np.ndarray, "masses frequencies"]:
    """The loop that the controller sees, 1 / S_I - 1."""
    output = 1 / (1 + plant * around.feedback)
    return 1 / ((around.share - around.seen * plant) * output) - 1


def crossing_hz(design: JointDesign, model: ModalModel) -> Float64[np.ndarray, " masses"]:
    """First 0 dB crossing of the loop that the controller sees, of every mass (Definition 1.2.1)."""
    moved = late(model)

    def loop(omega: np.ndarray) -> np.ndarray:
        return _loop(late_response(moved, omega), compensated(design, omega))

    on_grid = np.abs(loop(grid()))
    found = [
        crossover(lambda omega, mass=mass: loop(omega)[mass], grid(), on_grid[mass])
        for mass in range(len(on_grid))
    ]
    return np.array(found) / (2 * np.pi)


def rough_crossing_hz(design: JointDesign, served: StageResponse) -> Float64[np.ndarray, " masses"]:
    """`crossing_hz` by the grid alone, a straight line between its points in logarithms: 1e-4 off, and quick."""
    gain = np.log(np.abs(_loop(served.plant, compensated(design, grid()))))
    first = np.argmax(gain < 0, axis=1)[:, None]
    if not first.all():
        raise InputError("a loop does not fall through 0 dB within the grid; it has no bandwidth")
    below, above = (np.take_along_axis(gain, first - k, axis=1) for k in (0, 1))
    low, high = (np.log(grid()[first - k]) for k in (1, 0))
    return np.exp(low + (high - low) * above / (above - below))[:, 0] / (2 * np.pi)


def unfed_errors(
    feedback: Complex128[np.ndarray, " frequencies"],
    plant: Complex128[np.ndarray, " frequencies"],
    delay: float,
    samples: int = SAMPLES,
) -> Float64[np.ndarray, "signals move"]:
    """Errors of the move without feedforward, and what a unit of each of its four gains takes off (rows 1 to 4).

    With the modified feedforward of appendix A the setpoint acts like v and the original feedforward like a force
    that no observer sees: e = S_O (r - P u0).
    """
    steps, ahead, move, _ = _move(delay, samples)
    position = steps / -np.expm1(-1j * grid(samples) * SAMPLE_TIME)
    sensitivity = 1 / (1 + plant * feedback)
    return np.fft.irfft(sensitivity * np.vstack([position, plant * ahead]), samples)[:, move]


def fitted_gains(
    errors: Float64[np.ndarray, "signals move"],
    free: Sequence[int] = range(4),
    kept: ArrayLike = (0, 0, 0, 0),
) -> Float64[np.ndarray, " gains"]:
    """Gains (of velocity, acceleration, jerk and snap) of least error over the whole move; those not `free` are `kept`."""
    gains, free = np.array(kept, dtype=float), list(free)
    size = np.linalg.norm(errors[1:], axis=1)
    columns = (errors[1:] / size[:, None])[free]
    others = np.delete(np.arange(4), free)
    target = errors[0] - gains[others] @ errors[1 + others]
    gains[free] = np.linalg.solve(columns @ columns.T, columns @ target) / size[free]
    return gains


def scanned(
    feedback: Complex128[np.ndarray, " frequencies"],
    plant: Complex128[np.ndarray, " frequencies"],
    pushed: Complex128[np.ndarray, " frequencies"],
    delay: float,
    samples: int = SAMPLES,
    gains: ArrayLike | None = None,
) -> tuple[float, float, float]:
    """Error, quiet and force of `Evaluation` for one mass; without `gains` the feedforward is fitted in this very loop."""
    errors, scanning = unfed_errors(feedback, plant, delay, samples), _move(delay, samples)[3]
    gains = fitted_gains(errors) if gains is None else np.asarray(gains)
    quiet = float(np.sqrt(np.mean((errors[0] - gains @ errors[1:])[scanning] ** 2)))
    sensitivity = 1 / (1 + plant * feedback)
    noise, s = _deviations(), np.abs(sensitivity) ** 2
    given = noise["w"] ** 2 * np.abs(pushed) ** 2 + noise["v"] ** 2
    weights = np.full(len(s), 2.0 / samples)  # of both signs of a frequency
    weights[[0, -1]] /= 2
    error = weights @ (s * given + np.abs(1 - sensitivity) ** 2 * noise["d"] ** 2)
    force = weights @ (np.abs(feedback) ** 2 * s * (given + noise["d"] ** 2))
    return float(np.hypot(quiet, np.sqrt(error))), quiet, float(np.sqrt(force))


def step_response(
    feedback: Complex128[np.ndarray, " frequencies"],
    plant: Complex128[np.ndarray, " frequencies"],
    pushed: Complex128[np.ndarray, " frequencies"],
    samples: int = SAMPLES,
) -> Float64[np.ndarray, " samples"]:
    """True error (m) after a disturbing force of 1 N begins and stays; what outlasts the transform comes round again."""
    step = 1 / -np.expm1(-1j * grid(samples) * SAMPLE_TIME)
    return np.fft.irfft(-step * pushed / (1 + plant * feedback), samples)


LEFT = slice(round(0.1 / SAMPLE_TIME), round(0.2 / SAMPLE_TIME))  # samples after a step


def left_after_step(feedback, plant, pushed, samples: int = SAMPLES) -> float:
    """Rms of the true error between 100 and 200 ms after a step of the disturbing force, m/N."""
    return float(np.sqrt(np.mean(step_response(feedback, plant, pushed, samples)[LEFT] ** 2)))


def noise_floor(model: ModalModel, delay: float = DELAY) -> float:
    """Rms of mass 5's error under the noise of section 3.1 (m) that no controller goes below.

    The first position that a command moves is that of sample `1 + int(delay)` from it; what the measurements up to the
    command leave unknown of that position no command takes away.
    """
    plant, noise = zoh_modes(model.at([0], [MEASURED]), SAMPLE_TIME), published_noise()
    unknown = discrete_gain(plant.a, plant.b, plant.c, noise.process, noise.sensor).covariance
    for _ in range(int(delay)):
        unknown = plant.a @ unknown @ plant.a.T + noise.process * plant.b @ plant.b.T
    return float(np.sqrt((plant.c @ unknown @ plant.c.T)[0, 0] + published_deviations()["v"] ** 2))


@dataclass(frozen=True)
class Judged:
    """What a design does on some stages; nothing here trusts a grid."""

    stable: Bool[np.ndarray, " plants"]  # by eigenvalues, all masses
    # dB, in the order of `PEAKS`, of the worst mass; inf if unstable
    peaks: Float64[np.ndarray, "plants functions"]
    error: Float64[np.ndarray, " plants"]  # m, rms in the scan with noise; inf if unstable
    quiet: Float64[np.ndarray, " plants"]  # m, without noise
    force: Float64[np.ndarray, " plants"]  # N, rms of the control force under noise
    left: Float64[
        np.ndarray, " plants"
    ]  # m/N, rms between 100 and 200 ms after a step of the disturbing force
    slowest: Float64[
        np.ndarray, " plants"
    ]  # s, time constant of the slowest pole over all masses; inf if unstable

    @property
    def feasible(self) -> Bool[np.ndarray, " plants"]:
        """Where all loops are stable and all six peaks at 6 dB or below."""
        return self.stable & (self.peaks.max(axis=1) <= 20 * np.log10(SIX_DB) + 1e-6)


@checked
def stable_on(design: JointDesign, plants: Sequence[ModalModel]) -> Bool[np.ndarray, " plants"]:
    """Whether the loops of all masses are stable on every plant."""
    return np.all(np.abs(closed_poles(design, plants)) < 1, axis=(1, 2))


def judge(design: JointDesign, plants: Sequence[ModalModel], delay: float = DELAY) -> Judged:
    """What a design does on every plant, see `verify_designs`."""
    return verify_designs({"": design}, plants, delay)[""]


@checked(infinite=True)
def verify_designs(
    designs: Mapping[str, JointDesign],
    plants: Sequence[ModalModel],
    delay: float = DELAY,
    alone: int = 0,
    modelled: float | None = None,
) -> dict[str, Judged]:
    """Stability by eigenvalues, peaks looked for between grid points and at closed-loop poles, the scan's error.

    `delay` is that of the whole control force in samples, `modelled` the one in the observer, by default the same;
    `alone` one more of the controller's output by itself. The plants' responses are computed once for all designs.
    """
    moved = [late(plant, delay) for plant in plants]
    coarse = [late_response(each, grid()) for each in moved]
    scanning = [stage_response(plant.at([0], [MEASURED]), delay, JUDGED) for plant in plants]
    modelled, judged = delay if modelled is None else modelled, {}
    for name, design in designs.items():
        poles = closed_poles(design, plants, delay, alone, modelled)
        stable = np.all(np.abs(poles) < 1, axis=(1, 2))
        around = partial(compensated, design, delay=modelled, alone=alone)
        on_grid = around(grid())
        feedback = around(grid(JUDGED), masses=slice(MEASURED, MEASURED + 1)).feedback[0]
        peaks, scans = np.full((len(plants), len(PEAKS)), np.inf), np.full((5, len(plants)), np.inf)
        for k in np.flatnonzero(stable):
            peaks[k] = 20 * np.log10(_highest(around, moved[k], six(coarse[k], on_grid), poles[k]))
            _, (response,), (pushed,) = scanning[k]
            scans[:3, k] = scanned(feedback, response, pushed, delay, JUDGED)
            scans[3, k] = left_after_step(feedback, response, pushed, JUDGED)
            scans[4, k] = -SAMPLE_TIME / np.log(np.abs(poles[k]).max())
        judged[name] = Judged(stable, peaks, *scans)
    return judged


def _highest(around: Callable, moved: Late, first: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """The largest magnitude of each of the six functions over all masses; `first` is what the grid shows."""
    angles = np.abs(np.angle(poles[np.abs(poles) > 0.5])) / SAMPLE_TIME
    omega = _apart(np.union1d(_between(grid(), first, 3), angles[angles > 1.0]))
    for _ in range(5):
        values = six(late_response(moved, omega), around(omega))
        omega = _between(omega, values, 9)
    return values.max(axis=(1, 2))


def _between(omega: np.ndarray, values: np.ndarray, points: int) -> np.ndarray:
    """All tops within a twentieth of the largest of their function, and frequencies around them."""
    padded = np.pad(values, ((0, 0), (0, 0), (1, 1)))
    high = values >= 0.95 * values.max(axis=(1, 2))[:, None, None]
    high &= (values >= padded[..., :-2]) & (values >= padded[..., 2:])
    tops = np.flatnonzero(high.any(axis=(0, 1)))
    ends = omega[np.maximum(tops - 1, 0)], omega[np.minimum(tops + 1, len(omega) - 1)]
    return _apart(np.union1d(np.linspace(*ends, points), omega[tops]))


def _apart(omega: np.ndarray) -> np.ndarray:
    """Sorted frequencies without those that all but repeat the one before: of two such, rounding chooses the top."""
    return omega[np.diff(omega, prepend=0.0) > 1e-7 * omega]


def six(plant: np.ndarray, around: Compensated) -> np.ndarray:
    """Magnitudes in the order of `PEAKS`, (functions, masses, frequencies)."""
    output = 1 / (1 + plant * around.feedback)
    tracking = 1 - plant * around.reference * output
    given = (around.share - around.seen * plant) * output
    three = np.array([given, output, tracking])
    return np.abs(np.concatenate([three, 1 - three]))


def sample_plants(
    size: float, count: int, seed: int, law: str = "ends", rigid: bool = True
) -> list[ModalModel]:
    """Stages with random relative errors of `size` on all modal parameters, `rigid` body included (as in Table 5.2)."""
    rng, nominal = np.random.default_rng(seed), stage()
    return [perturbed(nominal, sample_errors(rng, nominal, size, law, rigid)) for _ in range(count)]


@dataclass(frozen=True)
class Found:
    """Where a search ended."""

    design: JointDesign
    error: float  # m, root mean square over the stages whose error counts
    excess: float  # logarithm by which the worst constraint is exceeded; not positive where all are kept
    meetings: int  # of a design with a stage, which is what a search costs


def search(
    start: JointDesign,
    free: str,
    served: Sequence[StageResponse],
    limit: float = SIX_DB,
    force: float | None = None,
    steps: int = 40,
    counted: int | None = None,
    aim: str = "error",
    left: float | None = None,
) -> Found:
    """Least mean square of the scan error over some stages, all six peaks of all masses below `limit`, from one start.

    Every step linearises the logarithms of error, peaks and noise in the logarithms of the `free` numbers and solves a
    linear program within a trusted region; it is taken when it lowers an exact penalty and leaves all loops stable. The
    start is stable, but its peaks may exceed the limit. `force` limits the rms of the control force under noise (N),
    `left` what a step of the disturbing force leaves between 100 and 200 ms (m/N). The
    first `counted` stages count in the error; the others must keep the limits only. The `aim` ``bandwidth`` seeks the
    latest crossing of the slowest loop, and of the error nothing.
    """
    names = FREE[free]
    plants = [each.model for each in served]
    if not np.all(stable_on(start, plants)):
        raise InputError("start has an unstable loop; lower its bandwidth_hz")
    sizes = [np.size(getattr(start, name)) for name in names]
    low, high = np.log(np.repeat([LIMITS[name] for name in names], sizes, axis=0)).T
    x = np.clip(np.log(np.hstack([getattr(start, name) for name in names])), low, high)

    def at(x: np.ndarray) -> JointDesign:
        parts = np.split(np.exp(x), np.cumsum(sizes)[:-1])
        values = (tuple(part.tolist()) if len(part) > 1 else part.item() for part in parts)
        return replace(start, **dict(zip(names, values, strict=True)))

    def ask(x: np.ndarray) -> tuple[float, np.ndarray]:
        """Logarithm of what is to become small, and `_excesses`."""
        design = at(x)
        met = evaluate(design, served)
        if aim == "bandwidth":
            wanted = 1 / min(rough_crossing_hz(design, each).min() for each in served[:counted])
        else:
            wanted = _mean_error(met[:counted])
        return float(np.log(wanted)), _excesses(met, limit, force, left)

    error, others = ask(x)
    radius, meetings = RADIUS, len(served)
    for _ in range(steps):
        near = others > max(float(others.max()), 0.0) - 0.4
        cost, slopes = np.empty(len(x)), np.empty((int(near.sum()), len(x)))
        for k in range(len(x)):
            moved = x.copy()
            moved[k] += 1e-4 if x[k] + 1e-4 < high[k] else -1e-4
            e, o = ask(moved)
            cost[k] = (e - error) / (moved[k] - x[k])
            slopes[:, k] = (o - others)[near] / (moved[k] - x[k])
        meetings += len(x) * len(served)
        while radius > SMALLEST_RADIUS:
            region = np.maximum(low - x, -radius), np.minimum(high - x, radius)
            step, foreseen = _program(cost, others[near], slopes, *region)
            e, o = ask(x + step)
            meetings += len(served)
            gained = _merit(error, others) - _merit(e, o)
            if gained > 0.1 * foreseen and np.all(stable_on(at(x + step), plants)):
                break
            radius /= 3
        else:
            break
        x, error, others = x + step, e, o
        if gained > 0.7 * foreseen:
            radius = min(2 * radius, 0.7)
        if gained < SMALLEST_GAIN:
            break
    ended = _mean_error(evaluate(at(x), served[:counted]))
    return Found(at(x), ended, float(others.max()), meetings)


def _merit(error: float, others: np.ndarray) -> float:
    return error + PENALTY * max(float(others.max()), 0.0)


def _program(cost, others, slopes, low, high) -> tuple[np.ndarray, float]:
    """Step that the linear program takes, and how much of the merit it promises."""
    bounds = [*zip(low, high, strict=True), (0.0, None)]  # the last one: the largest excess
    columns = np.hstack([slopes, -np.ones((len(slopes), 1))])
    found = optimize.linprog(np.r_[cost, PENALTY], columns, -others, bounds=bounds, method="highs")
    return found.x[:-1], PENALTY * max(float(others.max()), 0.0) - found.fun


def _mean_error(met: Sequence[Evaluation]) -> float:
    return float(np.sqrt(np.mean(np.square([each.error for each in met]))))


def _excesses(met: Sequence[Evaluation], limit: float, force: float | None, left: float | None) -> np.ndarray:
    """Logarithms of peaks, of the force and of what a step leaves, each over its limit; not positive where it is kept."""
    tops = np.array([each.tops for each in met]) - np.log(limit)
    forces = np.log([each.force / force for each in met]) if force else []
    steps = np.log([each.left / left for each in met]) if left else []
    return np.concatenate([tops.ravel(), forces, steps])


def starts(count: int, seed: int) -> list[JointDesign]:
    """Where searches begin: the published design at half its bandwidth, then random ones around it that are stable."""
    rng = np.random.default_rng(seed)
    published = JointDesign()
    found = [replace(published, bandwidth_hz=published.bandwidth_hz / 2)]
    while len(found) < count:
        moved = {name: getattr(found[0], name) * np.exp(rng.normal(0.0, 0.5)) for name in CONTROLLER}
        tried = replace(
            found[0],
            **{name: float(np.clip(value, *LIMITS[name])) for name, value in moved.items()},
            process=float(np.exp(rng.normal(0.0, 1.5))),
            noise_model=float(10 ** rng.uniform(1.0, 6.0)),
            damping=tuple((0.035 * np.exp(rng.normal(0.0, 0.7, 3))).tolist()),
            selectivity=tuple((2.0 * np.exp(rng.normal(0.0, 0.7, 3))).tolist()),
        )
        if stable_on(tried, [stage()])[0]:
            found.append(tried)
    return found


def robust_search(
    start: JointDesign,
    free: str,
    pool: Sequence[StageResponse],
    limit: float = SIX_DB,
    force: float | None = None,
    counted: int = 6,
    turns: int = 5,
    steps: int = 12,
    left: float | None = None,
) -> Found:
    """Search for many stages: the error of the first ones counts, those that break a limit most are taken in by turns.

    Judge the design on others. A start that is unstable on some is slowed down until it is not.
    """
    while not np.all(stable_on(start, [each.model for each in pool])):
        if start.bandwidth_hz < 2 * LIMITS["bandwidth_hz"][0]:
            raise InputError("start has an unstable loop on some stage at every bandwidth; give another")
        start = replace(start, bandwidth_hz=0.8 * start.bandwidth_hz)
    served, meetings, best = list(range(min(counted, len(pool)))), 0, None
    for _ in range(turns):
        found = search(start, free, [pool[k] for k in served], limit, force, steps, counted, left=left)
        met = evaluate(found.design, pool)
        meetings += found.meetings + len(pool)
        over = np.array([_excesses([each], limit, force, left).max() for each in met])
        whole = Found(found.design, _mean_error(met), float(over.max()), 0)
        if best is None or cost(whole) < cost(best):
            best = whole
        more = [int(k) for k in np.argsort(-over)[:3] if k not in served and over[k] > 0]
        if not more:
            break
        served, start = served + more, found.design
    return replace(best, meetings=meetings)


def cost(found: Found) -> float:
    """By which searches are compared: the logarithm of the error, and a penalty on what breaks a limit."""
    return float(np.log(found.error)) + PENALTY * max(found.excess, 0.0)


# === Feedforward gains ============================================================================================
# The true stage is not the nominal one: which gains the feedforward has there, and how it comes to the one that counts.


ACCELERATION, SNAP = 1, 3  # of the four gains: the mass, and the compliance
GAINS = {  # which of the four gains are fitted on the true stage
    "four refitted": (0, 1, 2, 3),
    "mass and snap refitted": (ACCELERATION, SNAP),
    "mass refitted": (ACCELERATION,),
    "nominal": (),
}


def steps_of(design: JointDesign, delay: float = DELAY) -> Float64[np.ndarray, " samples"]:
    """True error of the nominal stage at mass 5 after a force of 1 N begins (m)."""
    feedback = compensated(design, grid(JUDGED), delay, masses=slice(MEASURED, MEASURED + 1)).feedback[0]
    _, (response,), (pushed,) = stage_response(stage().at([0], [MEASURED]), delay, JUDGED)
    return step_response(feedback, response, pushed, JUDGED)


class Move(NamedTuple):
    """The move on one stage in the loop of one design, at mass 5."""

    errors: Float64[np.ndarray, "signals move"]  # see `unfed_errors`
    noise: Float64[np.ndarray, " frequencies"]  # root of the power of the measured error's noise
    hidden: float  # m, rms of the true error that noise makes
    scanning: np.ndarray


def moves(design: JointDesign, plants: Sequence[ModalModel], delay: float = DELAY) -> list[Move]:
    """The move of every stage."""
    around = compensated(design, grid(JUDGED), delay, masses=slice(MEASURED, MEASURED + 1))
    feedback, deviations, found = around.feedback[0], _deviations(), []
    for plant in plants:
        _, (response,), (pushed,) = stage_response(plant.at([0], [MEASURED]), delay, JUDGED)
        error, quiet, _ = scanned(feedback, response, pushed, delay, JUDGED)
        force = deviations["w"] * np.abs(pushed)
        noise = np.hypot(np.hypot(force, deviations["v"]), deviations["d"]) / np.abs(1 + response * feedback)
        errors = unfed_errors(feedback, response, delay, JUDGED)
        found.append(Move(errors, noise, np.sqrt(error**2 - quiet**2), _move(delay, JUDGED)[3]))
    return found


def scan_error(move: Move, gains: ArrayLike) -> float:
    """Rms of the true error in the scan (m), noise included, with these four gains."""
    quiet = (move.errors[0] - np.asarray(gains) @ move.errors[1:])[move.scanning]
    return float(np.hypot(np.sqrt(np.mean(quiet**2)), move.hidden))


def errors_by_gains(
    design: JointDesign, plants: Sequence[ModalModel]
) -> dict[str, Float64[np.ndarray, " plants"]]:
    """Scan error of every stage (m) with some gains fitted there without noise and the others of the nominal stage."""
    (nominal,) = moves(design, [stage()])
    known, there = fitted_gains(nominal.errors), moves(design, plants)
    return {
        name: np.array(
            [scan_error(each, fitted_gains(each.errors, free, known) if free else known) for each in there]
        )
        for name, free in GAINS.items()
    }


def learn_gains(
    design: JointDesign,
    plants: Sequence[ModalModel],
    scans: int,
    seed: int,
    free: Sequence[int] = (ACCELERATION, SNAP),
) -> Float64[np.ndarray, "scans plants"]:
    """Scan error (m) before any scan and after each: every scan corrects the `free` gains by the error that it measured.

    The correction is the least-squares one of the *nominal* loop, so it needs nothing of the true stage but its noisy
    measured error over one move.
    """
    (nominal,) = moves(design, [stage()])
    free = list(free)
    start, columns = fitted_gains(nominal.errors), nominal.errors[1:][free]
    size = np.linalg.norm(columns, axis=1)
    columns = columns / size[:, None]
    rng, found = np.random.default_rng(seed), []
    for move in moves(design, plants):
        gains, errors = start.copy(), []
        for _ in range(scans):
            errors.append(scan_error(move, gains))
            noise = np.fft.irfft(move.noise * np.fft.rfft(rng.standard_normal(JUDGED)), JUDGED)
            measured = move.errors[0] - gains @ move.errors[1:] + noise[: columns.shape[1]]
            gains[free] += np.linalg.solve(columns @ columns.T, columns @ measured) / size
        found.append([*errors, scan_error(move, gains)])
    return np.array(found).T


# === Joint designs ================================================================================================
# The designs that the searches found, in ``data/motion/joint.toml``.
#
# ``python -m notebooks.motion.joint_design`` searches anew (some minutes) and prints that file. Where a search ends
# can depend on the rounding of a machine, so results are stored, and every statement on them is computed from there.


STARTS, SEED = 5, 1  # of every search: the published design and random ones around it
SIZES = (0.0, 0.02, 0.05)  # relative errors of the modal parameters that the designs serve
POOL, POOL_SEED = 60, 7  # perturbed stages that a search may look at, beside the nominal one
ASKED = 10 ** (5.6 / 20)  # of these stages, to leave room for others
NOMINAL = 0.999 * SIX_DB  # required of the nominal stage, for peaks between the grid's points
# N, rms of the control force under noise, for the front; the published design has 0.0048
FORCES = (0.005, 0.01)
# m/N, left between 100 and 200 ms after a step of the disturbing force: a lasting 10 mN, the deviation of w, is then
# worth 0.1 nm, a tenth of what noise leaves to any controller
LEFT_LIMIT = 1e-8
KEPT = 1e-3  # logarithm by which a search may end above its limit


@dataclass(frozen=True)
class Stored:
    """A design with what its search was, and where each of its starts ended."""

    design: JointDesign
    size: float  # of the errors that it serves
    force: float  # N, allowed; 0: any
    ends: tuple[float, ...]  # m, scan errors at which the starts ended that kept every limit
    started: int  # how many there were
    meetings: int  # of a design with a stage, in all
    left: float = 0.0  # m/N, allowed between 100 and 200 ms after a step of the disturbing force; 0: any
    fair: tuple[float, ...] = ()  # of the ends, those of starts that are no other search's result


def stored_designs() -> dict[str, Stored]:
    """All stored designs by name, as they were found: rounded to six digits."""
    tree = read_numbers(paths.data("motion", "joint.toml"))
    found = {}
    for name in tree:
        numbers = {k: tuple(v) if isinstance(v, list) else v for k, v in tree.table(name).items()}
        design = JointDesign(**{k: numbers.pop(k) for k in NUMBERS})
        found[name] = Stored(design, **numbers)
    return found


def searched_designs() -> Iterator[tuple[str, Stored]]:
    """Every search again, one after the other."""
    begin = starts(STARTS, SEED)
    nominal = stage_response(stage())
    pools = {
        size: [
            nominal,
            *(stage_response(plant) for plant in sample_plants(size, POOL if size else 0, POOL_SEED)),
        ]
        for size in SIZES
    }
    fast = [_search(each, "joint", [nominal], aim="bandwidth") for each in begin]
    fast.sort(key=lambda each: -crossing_hz(each.design, nominal.model).min())
    yield "largest bandwidth, for 0%", _stored(fast, 0.0)
    for size, pool in pools.items():
        for free, kept in (("controller", OBSERVER), ("observer", CONTROLLER[1:])):
            found = _from_all([_with(each, JointDesign(), kept) for each in begin], free, pool)
            yield f"{free} free, for {size:.0%}", _stored(found, size)
        second = _from_all([_with(each, found[0].design, OBSERVER) for each in begin], "controller", pool)
        yield f"two steps, for {size:.0%}", _stored(second, size)
    # The joint searches begin where those for smaller errors ended, too, and the nominal one where the others did.
    ended: list[JointDesign] = []
    joint = {}
    for size, pool in pools.items():
        joint[size] = _from_all(begin + ended, "joint", pool)
        ended.append(joint[size][0].design)
    fair = _from_all(begin + starts(STARTS, SEED + 1), "joint", pools[0.0])
    joint[0.0] = sorted(joint[0.0] + _from_all(ended[1:], "joint", pools[0.0]), key=cost)
    for size, pool in pools.items():
        found = _stored(joint[size], size)
        yield f"joint, for {size:.0%}", found if size else replace(found, fair=_kept_ends(fair))
        for force in FORCES:
            quieter = _search(joint[size][0].design, "joint", pool, force)
            yield f"joint, for {size:.0%}, {1e3 * force:g} mN", _stored([quieter], size, force)
        yield (
            f"joint, for {size:.0%}, {1e9 * LEFT_LIMIT:g} nm/N",
            forgetting(size, joint[size][0].design, pool),
        )


def forgetting(size: float, joint: JointDesign, pool: list[StageResponse]) -> Stored:
    """The joint search that must forget a lasting force, from the joint design with its integrator as found and as published."""
    begin = [rounded(joint), replace(rounded(joint), integrator=1.0)]
    return _stored(_from_all(begin, "joint", pool, LEFT_LIMIT), size, left=LEFT_LIMIT)


def _with(design: JointDesign, other: JointDesign, names: tuple[str, ...]) -> JointDesign:
    """The design with some numbers of another one."""
    return replace(design, **{name: getattr(other, name) for name in names})


def _search(
    start: JointDesign,
    free: str,
    pool: list[StageResponse],
    force: float | None = None,
    aim: str = "error",
    left: float | None = None,
) -> Found:
    if len(pool) > 1:
        return robust_search(start, free, pool, ASKED, force, left=left)
    limit, meetings = NOMINAL, 0
    for _ in range(4):  # where the grid has missed a peak, again with a lower limit
        found = search(start, free, pool, limit, force, aim=aim, left=left)
        meetings += found.meetings
        over = 10 ** (judge(found.design, [pool[0].model]).peaks.max() / 20) / NOMINAL
        if found.excess > KEPT or over <= 1.0005:
            break
        start, limit = found.design, limit / over
    return replace(found, meetings=meetings)


def _from_all(
    begin: list[JointDesign], free: str, pool: list[StageResponse], left: float | None = None
) -> list[Found]:
    """Where the starts ended, the best first."""
    found = []
    for start in begin:
        try:
            found.append(_search(start, free, pool, left=left))
        except InputError:  # no bandwidth at which this start is stable on every stage
            continue
    return sorted(found, key=cost)


def _stored(found: list[Found], size: float, force: float = 0.0, left: float = 0.0) -> Stored:
    """The first of the designs that were found, and where each start ended."""
    meetings = sum(each.meetings for each in found)
    return Stored(rounded(found[0].design), size, force, _kept_ends(found), len(found), meetings, left)


def _kept_ends(found: list[Found]) -> tuple[float, ...]:
    return tuple(sorted(_six(each.error) for each in found if each.excess <= KEPT))


def _six(value):
    return tuple(map(_six, value)) if isinstance(value, tuple) else float(f"{value:.5e}")


def rounded(design: JointDesign) -> JointDesign:
    """The design with six significant digits."""
    return replace(design, **{name: _six(getattr(design, name)) for name in NUMBERS})


def at_bounds(design: JointDesign) -> list[str]:
    """Numbers that stand at an end of the range that a search allows them, those of a mode with its number."""
    found = []
    for name, bounds in LIMITS.items():
        for mode, value in enumerate(np.atleast_1d(getattr(design, name)), 1):
            if np.any(np.isclose(value, bounds, rtol=1e-3)):
                found.append(f"{name} of mode {mode}" if name in ("damping", "selectivity") else name)
    return found


def as_toml(name: str, stored: Stored) -> str:
    """One table of ``joint.toml``."""
    values = asdict(stored)
    values = values.pop("design") | values
    lines = (f"{key} = {list(value) if isinstance(value, tuple) else value}" for key, value in values.items())
    return "\n".join([f"[{name!r}]", *lines])


if __name__ == "__main__":
    print(
        "# Observers and controllers of the stage that were searched together, and their rivals; numbers as in"
    )
    print("# notebooks.motion.joint_design.JointDesign and Stored. Made by")
    print("# `python -m notebooks.motion.joint_design`.")
    for found_name, found_stored in searched_designs():
        print(f"\n{as_toml(found_name, found_stored)}", flush=True)


# === Joint pictures ===============================================================================================
# Figures of the joint design.


SIZE_COLOURS = {
    0.0: figures.RED,
    0.02: figures.BLUE,
    0.05: figures.GREEN,
}  # of the errors that a design serves
# of what a search was free to change
MARKS = {
    "joint": "o",
    "two steps": "^",
    "observer free": "D",
    "controller free": "s",
    "largest bandwidth": "v",
}
TOP_DB = 20.0  # where larger peaks are cut


def paint_front(
    designs: Mapping[str, Stored],
    nominal: Mapping[str, Judged],
    unstable: Mapping[str, float],
    published: Judged,
):
    """Scan error over the noise in the control force; marks by what was free, hollow where stages were unstable.

    `unstable` is the share of such stages, written beside the designs that have any.
    """
    designs = {name: each for name, each in designs.items() if not each.left}
    figure, axis = figures.new(1, 1, height=3.4)
    at = {name: (1e3 * nominal[name].force[0], 1e9 * nominal[name].error[0]) for name in designs}
    for size, colour in SIZE_COLOURS.items():
        ours = [name for name, each in designs.items() if each.size == size and name.startswith("joint")]
        points = np.array(sorted(at[name] for name in ours))
        axis.plot(
            *points.T, "-", color=colour, linewidth=1.0, label=f"joint, for errors of {100 * size:.0f} %"
        )
    for name, stored in designs.items():
        free, colour = name.partition(",")[0], SIZE_COLOURS[stored.size]
        fill = "white" if unstable[name] else colour
        axis.plot(*at[name], MARKS[free], color=colour, markerfacecolor=fill, markersize=5, label=name)
        if unstable[name]:
            note = f"{100 * unstable[name]:.0f} % unstable"
            axis.annotate(note, at[name], (5, 3), textcoords="offset points", fontsize=6)
    late = 1e3 * published.force[0], 1e9 * published.error[0]
    axis.plot(*late, "x", color=figures.BLACK, label="as published, with delay")
    axis.set_xscale("log")
    axis.set_xticks([2, 5, 10, 20, 30], ["2", "5", "10", "20", "30"])
    axis.minorticks_off()
    axis.set(xlabel="rms of the control force under noise (mN)", ylabel="rms error in the scan (nm)")
    axis.set(xlim=(2, 36), ylim=(1, 6))
    legend = [line for line in axis.lines if line.get_linestyle() == "-"] + axis.lines[-1:]
    legend += [
        Line2D([], [], linestyle="", marker=MARKS[free], color=figures.GREY, label=free) for free in MARKS
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=3)
    return figure


def paint_three(designs: Mapping[str, Stored], nominal: Mapping[str, Judged], published: Judged):
    """What noise makes of the error, and what is left without it, over what a step of the force leaves; nominal stage."""
    figure, axes = figures.new(1, 2, height=3.0, sharex=True)
    for noise, axis in zip((True, False), axes, strict=True):

        def at(found: Judged, noise: bool = noise) -> tuple[float, float]:
            part = np.sqrt(found.error[0] ** 2 - found.quiet[0] ** 2) if noise else found.quiet[0]
            return 1e9 * found.left[0], 1e9 * float(part)

        for size, colour in SIZE_COLOURS.items():
            ours = [n for n, each in designs.items() if each.size == size and not each.force]
            joint = sorted(at(nominal[name]) for name in ours if name.startswith("joint"))
            label = f"for {100 * size:.0f} %"
            axis.plot(*np.array(joint).T, "o-", color=colour, markersize=4, label=f"joint, {label}")
            two = at(nominal[f"two steps, for {size:.0%}"])
            style = {
                "color": colour,
                "markersize": 8,
                "markerfacecolor": "none",
                "label": f"two steps, {label}",
            }
            axis.plot(*two, "^", **style)
        axis.plot(*at(published), "x", color=figures.BLACK, label="as published, with delay")
        limit = f"limit of a search, {1e9 * LEFT_LIMIT:g} nm/N"
        axis.axvline(1e9 * LEFT_LIMIT, color=figures.BLACK, linestyle=":", linewidth=1.0, label=limit)
        axis.set_xscale("log")
    axes[0].set_ylabel("error from noise (nm)")
    axes[1].set_ylabel("error without noise (nm)")
    figures.label(axes, "left 100 to 200 ms after a step (nm/N)")
    figures.legend_below(axes[0], 4)
    return figure


def paint_learning(errors: Mapping[str, Float64[np.ndarray, "scans plants"]], floor: float):
    """Scan error over the scans from which gains were learnt: medians, quartiles of the stages as bands, the worst thin.

    A panel a design; the names read "design: gains that were learnt".
    """
    designs = list(dict.fromkeys(name.partition(": ")[0] for name in errors))
    colours = {"mass": figures.RED, "mass and snap": figures.BLUE}
    figure, axes = figures.new(1, len(designs), height=3.2, sharey=True)
    for name, each in errors.items():
        design, _, gains = name.partition(": ")
        axis, colour = axes[designs.index(design)], colours[gains]
        low, middle, high, worst = 1e9 * np.quantile(each, [0.25, 0.5, 0.75, 1.0], axis=1)
        scans = np.arange(len(each))
        axis.semilogy(scans, middle, "o-", color=colour, markersize=4, label=f"{gains}: median")
        axis.fill_between(
            scans, low, high, color=colour, alpha=0.2, linewidth=0, label=f"{gains}: quartiles of the stages"
        )
        axis.semilogy(scans, worst, color=colour, linewidth=0.7, label=f"{gains}: worst stage")
        axis.set_title(design.replace("%", " %"))
    for axis in axes:
        axis.axhline(1e9 * floor, color=figures.BLACK, linewidth=0.8, label="least error under this noise")
    figures.label(axes, "scans on the true stage", "rms error in the scan (nm)")
    figures.legend_below(axes[0], 3, fontsize=7)
    return figure


def paint_peaks_over_plants(judged: Mapping[str, Mapping[str, Judged]]):
    """Largest peak of every design on every perturbed plant, by panel; unstable ones lie at the cut."""
    figure, axes = figures.new(1, len(judged), height=3.2, sharey=True, squeeze=False)
    for axis, (title, designs) in zip(axes[0], judged.items(), strict=True):
        for place, (name, found) in enumerate(designs.items()):
            shown = np.minimum(found.peaks.max(axis=1), TOP_DB)
            across = place + np.linspace(-0.3, 0.3, len(shown))
            axis.plot(across, shown, ".", markersize=4, color=figures.BLUE, label=name)
            axis.annotate(
                f"{100 * np.mean(~found.stable):.0f} %\nunstable",
                (place, TOP_DB + 0.8),
                ha="center",
                fontsize=6,
            )
        mark_limit(axis)
        axis.set_xticks(
            range(len(designs)),
            [name.replace(" ", "\n", 1).replace(", ", ",\n").replace("%", " %") for name in designs],
            fontsize=6,
        )
        axis.set(ylim=(0, TOP_DB + 4), title=title.replace("%", " %"), xlabel="design")
    axes[0, 0].set_ylabel(f"largest peak (dB), cut at {TOP_DB:g}")
    dot, limit = axes[0, 0].lines[0], axes[0, 0].lines[-1]
    figure.legend([dot, limit], ["one stage", "limit, 6 dB"], loc="outside lower center", ncols=2)
    return figure


def paint_joint(
    designs: Mapping[str, JointDesign], design: str, frequency_error: float, bandwidth: float, delay: float
):
    """Explorer: the six functions, of the worst mass each, with frequencies, bandwidth (%) and delay (samples) moved."""
    chosen = designs[design]
    chosen = replace(chosen, bandwidth_hz=chosen.bandwidth_hz * bandwidth / 100)
    nominal = stage()
    plant = detuned(nominal, np.full(len(nominal.frequencies) - nominal.rigid_modes, frequency_error / 100))
    judged = judge(chosen, [plant], delay)
    values = six(stage_response(plant, delay).plant, compensated(chosen, grid(), delay)).max(axis=1)
    figure, axis = plain(bottom=0.17)
    for name, magnitude in zip(PEAKS, values, strict=True):
        add_magnitude(axis, grid()[1:-1], magnitude[1:-1], label=name)
    mark_limit(axis)
    verdict = "unstable"
    if judged.stable[0]:
        verdict = f"largest peak {judged.peaks.max():.1f} dB, scan error {1e9 * judged.error[0]:.2f} nm"
    axis.set(title=f"worst of the seven masses: {verdict}", xlabel="frequency (Hz)", ylabel="magnitude (dB)")
    axis.set_ylim(-40, 20)
    axis.legend(loc="lower left", ncols=2)
    return figure
