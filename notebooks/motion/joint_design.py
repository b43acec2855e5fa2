"""Observer and controller of the stage designed together, sampled and with a late force.

The structure is the published one: the PID controller (3.1), the Kalman observer with a noise model, compensation and
damping through one band-pass a mode, as `stillwork.control.machine_loops` runs them on a processor. What sample k
commands acts from `DELAY` samples later on, held for one, and the observer knows the force that acts.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Bool, Complex128, Float64
from numpy.typing import ArrayLike
from scipy import optimize

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
from stillwork.base.checks import InputError
from stillwork.base.toml_files import read_numbers
from stillwork.control.applications import filtered_estimates
from stillwork.control.bandwidth import FUNCTIONS, SIX_DB, Loop, highest_peaks
from stillwork.control.discrete_observer import discrete_kalman_observer
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.control.loops import LoopResponse
from stillwork.control.pid import Pid
from stillwork.estimation.observer import NoiseIntensities, augment_random_walk
from stillwork.estimation.riccati import discrete_gain
from stillwork.lti.delays import split_delay
from stillwork.lti.discretisation import prewarped, tustin, zoh_modes, zoh_response
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel, interconnect, response_between
from workbook import figures, paths, proportion_interval

SAMPLE_TIME, DELAY = 1e-4, 1.5  # s, as in notebook 11; samples from command to force
MEASURED = 4  # mass 5, at which the thesis evaluates a scan
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


_mass, _noise, _deviations = cache(stage_mass), cache(published_noise), cache(published_deviations)


@cache
def _known(mass: int) -> ModalModel:
    """What the observer of a mass (0 to 6) knows: the retained modes of the nominal stage, and what the others add at rest."""
    return truncate(stage().at([0], [mass]), RETAINED, COMPENSATED)


@cache
def _walked(part: float) -> tuple[np.ndarray, np.ndarray]:
    """The observers' A, with a random walk at the input, and B of a force held for a part of a sample."""
    held = zoh_modes(_known(0), part * SAMPLE_TIME)
    a, b, *_ = augment_random_walk(held.a, held.b, held.c, np.eye(1))
    return a, b


@lru_cache(maxsize=64)  # a search moves the other numbers more often
def _estimator(process: float, noise_model: float, mass: int, delay: float) -> StateModel:
    """From (f, y) to y_flex and to the flexible velocities at the moment at which f begins to act."""
    noise = NoiseIntensities(process * _noise().process, _noise().sensor)
    whole, late = split_delay(delay)
    observer = discrete_kalman_observer(_known(mass), noise, SAMPLE_TIME, noise_model, late)
    ahead, pushed = np.eye(len(observer.a)), []  # by f(k-n-1), ... f(k-1), n whole samples of delay
    for part in (late, *[1.0] * whole):
        a, b = _walked(part) if part else (np.eye(len(observer.a)), np.zeros((len(observer.a), 1)))
        ahead, pushed = a @ ahead, [*(a @ each for each in pushed), b]
    rows = observer.read(np.eye(RETAINED - 1), "velocity")
    states = observer.estimator(np.vstack([observer.flexible_outputs, rows @ ahead]), "filter", 0)
    n, past = whole + 1, rows @ np.hstack(pushed[::-1])  # by f(k-1), ...
    now = np.vstack([[[float(not whole)]], np.zeros((len(rows), 1))])
    line = np.vstack([np.eye(n)[whole - 1] * bool(whole), past])  # f(k-n), and what the forces add
    line = StateModel(np.eye(n, k=-1), np.eye(n, 1), line, now, SAMPLE_TIME)
    feedback, outside = np.zeros((3, 8)), np.zeros((3, 2))
    feedback[0, 4] = outside[1, 1] = outside[2, 0] = 1
    read = np.hstack([np.eye(4), np.diag([0.0, 1, 1, 1])])
    return interconnect([states, line], feedback, outside, read)


@lru_cache(maxsize=256)
def _block(process, noise_model, damping, selectivity, mass: int, delay: float) -> StateModel:
    known = _known(mass)
    gain = damping_gain(known, np.array(damping))[:, 2 * known.rigid_modes + 1 :: 2]
    pairs = zip(known.frequencies[known.rigid_modes :], selectivity, strict=True)
    filters = [tustin(band_pass(float(w), q), SAMPLE_TIME, float(w)) for w, q in pairs]
    return filtered_estimates(_estimator(process, noise_model, mass, delay), filters, gain)


def block(design: JointDesign, mass: int, delay: float = DELAY) -> StateModel:
    """From (f, y) to (u_d, y_flex) for one mass (0 to 6), of an observer that knows of a `delay` in samples."""
    return _block(*(getattr(design, name) for name in OBSERVER), mass, delay)


class Grid(NamedTuple):
    """Responses of a stage at some frequencies (rad/s)."""

    omega: Float64[np.ndarray, " frequencies"]
    plant: Complex128[np.ndarray, "masses frequencies"]  # from the command, late
    pushed: Complex128[np.ndarray, "masses frequencies"]  # from a force that is not late


def grid_of(model: ModalModel, omega: np.ndarray, delay: float = DELAY) -> Grid:
    """Responses of a stage, sampled."""
    whole, late = split_delay(delay)
    seen = zoh_response(model, SAMPLE_TIME, omega, late)[:, 0] * np.exp(-1j * omega * SAMPLE_TIME * whole)
    return Grid(omega, seen, zoh_response(model, SAMPLE_TIME, omega)[:, 0])


@lru_cache(maxsize=32)
def _observed(process, noise_model, damping, selectivity, masses, omega: bytes, delay: float) -> np.ndarray:
    blocks = [_block(process, noise_model, damping, selectivity, mass, delay) for mass in masses]
    return np.stack([response_between(each, np.frombuffer(omega)) for each in blocks], axis=2)


def respond(design: JointDesign, grid: Grid, masses: Sequence[int], delay: float = DELAY) -> LoopResponse:
    """Loop functions of some masses; the observer knows of the `delay`."""
    numbers = (getattr(design, name) for name in OBSERVER)
    seen = _observed(*numbers, tuple(masses), grid.omega.tobytes(), delay)
    controller = design.controller.frequency_response(prewarped(grid.omega, SAMPLE_TIME))
    return LoopResponse(grid.plant[list(masses)], seen, controller)


def loops(design: JointDesign, plant: ModalModel, delay: float = DELAY) -> list[Loop]:
    """The loops of all masses on one grid."""
    grid = grid_of(plant, _fine(), delay)
    seen = respond(design, grid, range(7), delay).observer
    return [
        Loop(plant.at([0], [m]), block(design, m, delay), grid.omega, grid.plant[m], seen[:, :, m], SAMPLE_TIME, delay)
        for m in range(7)
    ]  # fmt: skip


# === The scan =====================================================================================================
# The error of a move and the variance of noise, on the frequencies of the fast Fourier transform: 0.6 Hz between them
# and 1.6 s for an error to die out.

SAMPLES = 16384
AHEAD = 10  # samples at rest before a move, in which its feedforward is already under way
LEFT = slice(round(0.1 / SAMPLE_TIME), round(0.2 / SAMPLE_TIME))  # samples after a step


@cache
def transform(samples: int = SAMPLES) -> Float64[np.ndarray, " frequencies"]:
    """Frequencies of the transform, rad/s; the first, at which a rigid body has no response, a little above 0."""
    omega = 2 * np.pi * np.fft.rfftfreq(samples, SAMPLE_TIME)
    omega[0] = 1e-4 * omega[1]
    omega[-1] *= 1 - 1e-9  # at half the rate the controller has no response
    return omega


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


class Scan(NamedTuple):
    """A scan at mass 5; errors are of the true position."""

    errors: Float64[
        np.ndarray, "5 move"
    ]  # m, without feedforward, and what a unit of each of its gains takes off
    noise: float  # m, rms by noise
    force: float  # N, rms of the whole control force under noise
    step: Float64[np.ndarray, " samples"]  # m/N, after a disturbing force begins and stays
    scanning: np.ndarray

    def error(self, gains: ArrayLike | None = None) -> float:
        """Rms in the scan (m), noise included; without `gains` the feedforward is fitted in this very loop."""
        gains = self.fitted if gains is None else np.asarray(gains)
        return float(np.hypot(rms((self.errors[0] - gains @ self.errors[1:])[self.scanning]), self.noise))

    @property
    def fitted(self) -> Float64[np.ndarray, "4"]:
        """Gains (of velocity, acceleration, jerk and snap) of least error over the whole move."""
        size = np.linalg.norm(self.errors[1:], axis=1)
        columns = self.errors[1:] / size[:, None]
        return np.linalg.solve(columns @ columns.T, columns @ self.errors[0]) / size

    @property
    def left(self) -> float:
        """Rms between 100 and 200 ms after a step of the disturbing force, m/N."""
        return rms(self.step[LEFT])


def rms(signal: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(signal**2)))


def scan(design: JointDesign, grid: Grid, delay: float = DELAY) -> Scan:
    """The published move under a design, on the frequencies of a `transform`.

    With the modified feedforward of appendix A the setpoint acts like v and the original feedforward like a force
    that no observer sees: e = S_O (r - P u0).
    """
    samples = 2 * (len(grid.omega) - 1)
    found = respond(design, grid, [MEASURED], delay)
    (plant,), (s,), (feedback,) = found.plant, found.output_sensitivity, found.output_controller
    pushed = grid.pushed[MEASURED]
    steps, ahead, move, scanning = _move(delay, samples)
    begin = 1 / -np.expm1(-1j * grid.omega * SAMPLE_TIME)
    errors = np.fft.irfft(s * np.vstack([steps * begin, plant * ahead]), samples)[:, move]
    sizes, weights = _deviations(), np.full(len(s), 2.0 / samples)  # of both signs of a frequency
    weights[[0, -1]] /= 2
    given = sizes["w"] ** 2 * np.abs(pushed) ** 2 + sizes["v"] ** 2
    error = weights @ (np.abs(s) ** 2 * given + np.abs(1 - s) ** 2 * sizes["d"] ** 2)
    force = weights @ (np.abs(feedback * s) ** 2 * (given + sizes["d"] ** 2))
    step = np.fft.irfft(-begin * pushed * s, samples)
    return Scan(errors, float(np.sqrt(error)), float(np.sqrt(force)), step, scanning)


def errors_of_nominal_gains(
    design: JointDesign, plants: Sequence[ModalModel]
) -> Float64[np.ndarray, " plants"]:
    """Scan error of every stage (m) with the feedforward that was fitted on the nominal one."""
    gains = scan(design, grid_of(stage(), transform())).fitted
    return np.array([scan(design, grid_of(each, transform())).error(gains) for each in plants])


def noise_floor(model: ModalModel) -> float:
    """Rms of mass 5's error under the noise of section 3.1 (m) that no controller goes below.

    The first position that a command moves is that of sample `1 + int(DELAY)` from it; what the measurements up to the
    command leave unknown of that position no command takes away.
    """
    plant, noise = zoh_modes(model.at([0], [MEASURED]), SAMPLE_TIME), published_noise()
    unknown = discrete_gain(plant.a, plant.b, plant.c, noise.process, noise.sensor).covariance
    for _ in range(int(DELAY)):
        unknown = plant.a @ unknown @ plant.a.T + noise.process * plant.b @ plant.b.T
    return float(np.sqrt((plant.c @ unknown @ plant.c.T)[0, 0] + published_deviations()["v"] ** 2))


# === A verdict ====================================================================================================


@cache
def _fine() -> np.ndarray:
    """Frequencies (rad/s) on which peaks are first looked for."""
    even = 2 * np.pi * np.arange(20.0, 1600.0, 2.5)
    return np.union1d(resonance_grid(stage().poles, 5.0, 0.499 / SAMPLE_TIME, 120, 8), even)


@dataclass(frozen=True)
class Judged:
    """What a design does on some stages: stable by eigenvalues, peaks refined between the points of a grid."""

    stable: Bool[np.ndarray, " plants"]  # all masses
    peaks: Float64[
        np.ndarray, "plants functions"
    ]  # dB, as in `FUNCTIONS`, of the worst mass; inf if unstable
    error: Float64[np.ndarray, " plants"]  # m, rms in the scan with noise; inf if unstable
    force: Float64[np.ndarray, " plants"]  # N, rms of the control force under noise
    left: Float64[np.ndarray, " plants"]  # m/N, 100 to 200 ms after a step of the disturbing force

    @property
    def feasible(self) -> Bool[np.ndarray, " plants"]:
        """Where all loops are stable and all peaks at 6 dB or below."""
        return self.stable & (self.peaks.max(axis=1) <= 20 * np.log10(SIX_DB) + 1e-3)


def judge(design: JointDesign, plants: Sequence[ModalModel], delay: float = DELAY) -> Judged:
    """What a design does on every plant."""
    rows = []
    for plant in plants:
        found = highest_peaks(loops(design, plant, delay), design.controller, FUNCTIONS)
        peaks = 20 * np.log10([each.magnitude for each in found.values()])
        rows.append([peaks, np.inf, np.inf, np.inf])
        if np.isfinite(peaks).all():
            moved = scan(design, grid_of(plant, transform(), delay), delay)
            rows[-1][1:] = moved.error(), moved.force, moved.left
    peaks, *others = map(np.array, zip(*rows, strict=True))
    return Judged(np.isfinite(peaks).all(axis=1), peaks, *others)


def stable_on(
    design: JointDesign, plants: Sequence[ModalModel], delay: float = DELAY
) -> Bool[np.ndarray, " plants"]:
    """Whether the loops of all masses are stable on every plant."""
    return np.array(
        [all(loop.is_stable(design.controller) for loop in loops(design, p, delay)) for p in plants]
    )


def sample_plants(size: float, count: int, seed: int) -> list[ModalModel]:
    """Stages with random relative errors of `size` on all modal parameters, rigid body included (as in Table 5.2)."""
    rng, nominal = np.random.default_rng(seed), stage()
    return [perturbed(nominal, sample_errors(rng, nominal, size, "ends", True)) for _ in range(count)]


# === The search ===================================================================================================

# What may be free beside the controller's bandwidth, and where the numbers may stand.
FREE = {"controller": CONTROLLER, "observer": ("bandwidth_hz", *OBSERVER), "joint": NUMBERS}
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
BANDS_HZ = (0.0, 60.0, 150.0, 350.0, 600.0, 1100.0)  # a search follows the largest peak in each
SEARCHED = 4096  # samples of the transform
PENALTY = 10.0  # where searches are compared, a peak 1 % too high costs as much as 10 % of error


@dataclass(frozen=True)
class Problem:
    """Logarithms of the scan error and of each constraint over its limit, by the logarithms of the free numbers."""

    start: JointDesign
    names: tuple[str, ...]
    plants: Sequence[ModalModel]
    limit: float = SIX_DB  # of all peaks of all masses
    left: float | None = None  # m/N, of what a step of the disturbing force leaves
    aim: str = (
        "error"  # root mean square over the plants; or "bandwidth", the first crossing of the slowest loop
    )

    @cached_property
    def sizes(self) -> list[int]:
        return [np.size(getattr(self.start, name)) for name in self.names]

    @cached_property
    def bounds(self) -> np.ndarray:
        """(2, numbers)."""
        return np.log(np.repeat([LIMITS[name] for name in self.names], self.sizes, axis=0)).T

    @cached_property
    def grids(self) -> list[tuple[Grid, Grid]]:
        return [(grid_of(p, _fine()), grid_of(p, transform(SEARCHED))) for p in self.plants]

    def numbers(self) -> np.ndarray:
        """Of the start."""
        return np.clip(np.log(np.hstack([getattr(self.start, name) for name in self.names])), *self.bounds)

    def design(self, x: np.ndarray) -> JointDesign:
        parts = np.split(np.exp(x), np.cumsum(self.sizes)[:-1])
        values = (tuple(part.tolist()) if len(part) > 1 else part.item() for part in parts)
        return replace(self.start, **dict(zip(self.names, values, strict=True)))

    def ask(self, design: JointDesign) -> tuple[float, np.ndarray]:
        """What is to become small, and what is to stay below 0."""
        excess, errors, ends = [], [], np.searchsorted(_fine(), 2 * np.pi * np.array(BANDS_HZ))
        for peaks, move in self.grids:
            found = respond(design, peaks, range(7))
            sizes = np.abs([getattr(found, name) for name in FUNCTIONS])
            excess.append(np.log(np.maximum.reduceat(sizes, ends, axis=2) / self.limit).ravel())
            if self.aim == "bandwidth":
                errors.append(1 / _first_crossing(np.abs(found.loop)).min())
                continue
            moved = scan(design, move)
            errors.append(moved.error())
            excess.append([np.log(moved.left / self.left)] if self.left else [])
        return float(np.log(rms(np.array(errors)))), np.concatenate(excess)


def _first_crossing(gain: np.ndarray) -> np.ndarray:
    """Where the gain of each mass first falls below 1 (rad/s), on a line between points in logarithms."""
    first = np.argmax(gain < 1, axis=1)
    below, above = (np.log(gain[np.arange(len(gain)), first - k]) for k in (0, 1))
    low, high = np.log(_fine()[first - 1]), np.log(_fine()[first])
    return np.exp(low + (high - low) * above / (above - below))


class Found(NamedTuple):
    """Where a search ended."""

    design: JointDesign
    error: float  # m, rms in the scan, root mean square over the stages
    excess: float  # logarithm by which the worst constraint is exceeded; not positive where all are kept

    @property
    def cost(self) -> float:
        """By which searches are compared."""
        return float(np.log(self.error)) + PENALTY * max(self.excess, 0.0)


def search(problem: Problem, steps: int = 100) -> Found:
    """Least error from one start, which is stable but may exceed the limits: sequential quadratic programs of SciPy (SLSQP).

    The limits do not see whether a loop is stable: a search that ends at an unstable one gives its start.
    """
    if not stable_on(problem.start, problem.plants).all():
        raise InputError("start has an unstable loop; lower its bandwidth_hz")

    @lru_cache(maxsize=64)  # differences of error and limits are taken at the same points
    def asked(x: bytes) -> tuple[float, np.ndarray]:
        return problem.ask(problem.design(np.frombuffer(x)))

    ended = optimize.minimize(
        lambda x: asked(x.tobytes())[0],
        problem.numbers(),
        method="SLSQP",
        bounds=problem.bounds.T,
        constraints={"type": "ineq", "fun": lambda x: -asked(x.tobytes())[1]},
        options={"maxiter": steps, "ftol": 1e-5, "eps": 1e-4},
    )
    design = problem.design(ended.x)
    if not stable_on(design, problem.plants).all():
        design = problem.start
    error, others = replace(problem, aim="error").ask(design)
    return Found(design, float(np.exp(error)), float(others.max()))


# === Designs ======================================================================================================
# What searches found, in ``data/motion/joint.toml``; ``python -m notebooks.motion.joint_design`` searches anew (some twenty
# minutes of CPU) and prints such a file. Where a search ends can depend on the rounding of a machine, so it is stored.

SIZES = (0.0, 0.02, 0.05)  # relative errors of the modal parameters that the designs serve
POOL, POOL_SEED, SERVED = (
    40,
    7,
    4,
)  # perturbed stages that a search may look at, and those that it begins with
ASKED = 10 ** (5.6 / 20)  # of these stages, to leave room for others
# m/N, left between 100 and 200 ms after a step of the disturbing force: a lasting 10 mN, the deviation of w, is then
# worth 0.1 nm, a tenth of what noise leaves to any controller
LEFT_LIMIT = 1e-8
KEPT = 1e-3  # logarithm by which a search may end above its limit


@dataclass(frozen=True)
class Stored:
    """A design, and where each search for it ended."""

    design: JointDesign
    size: float  # of the errors that it serves
    left: float  # m/N, allowed between 100 and 200 ms after a step of the disturbing force; 0: any
    ends: tuple[float, ...]  # m, scan errors at which the searches ended that kept every limit
    started: int  # how many there were


def stored_designs() -> dict[str, Stored]:
    """All stored designs by name, as they were found: rounded to six digits."""
    tree, found = read_numbers(paths.data("motion", "joint.toml")), {}
    for name in tree:
        numbers = {k: tuple(v) if isinstance(v, list) else v for k, v in tree.table(name).items()}
        design = JointDesign(**{k: numbers.pop(k) for k in NUMBERS})
        found[name] = Stored(design, **numbers)
    return found


def starts(count: int, seed: int) -> list[JointDesign]:
    """Where searches begin: the published design at half its bandwidth, then random ones around it that are stable."""
    rng, found = np.random.default_rng(seed), [JointDesign(bandwidth_hz=JointDesign.bandwidth_hz / 2)]
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


def search_pool(
    start: JointDesign, free: str, pool: Sequence[ModalModel], left: float | None = None, aim: str = "error"
) -> Found:
    """Search for all stages of a pool: those that break a limit most are taken in by turns, all are judged.

    A start that is unstable on some is slowed down until it is not. Where the grid missed a peak the limit is lowered.
    """
    while not stable_on(start, pool).all():
        if start.bandwidth_hz < 2 * LIMITS["bandwidth_hz"][0]:
            raise InputError("start has an unstable loop on some stage at every bandwidth; give another")
        start = replace(start, bandwidth_hz=0.8 * start.bandwidth_hz)
    asked = limit = SIX_DB if len(pool) == 1 else ASKED
    served, best = list(range(min(SERVED, len(pool)))), None
    for _ in range(5):
        problem = Problem(start, FREE[free], [pool[k] for k in served], limit, left, aim)
        start = search(problem, 100 if len(pool) == 1 else 15).design
        judged = judge(start, pool)
        over = np.log(10 ** (judged.peaks.max(axis=1) / 20) / asked)
        if left:
            over = np.maximum(over, np.log(judged.left / left))
        found = Found(start, rms(judged.error), float(over.max()))
        best = found if best is None or found.cost < best.cost else best
        more = [int(k) for k in np.argsort(-over)[:3] if k not in served and over[k] > 0]
        if not more and found.excess < KEPT / 2:
            break
        served, limit = served + more, limit if more else limit * np.exp(-found.excess)
    return best


def searched_designs() -> Iterator[tuple[str, Stored]]:
    """Every search again, one after the other."""
    begin, nominal = starts(3, 1), [stage()]
    fast = [search_pool(each, "joint", nominal, aim="bandwidth") for each in begin]
    fast.sort(
        key=lambda each: (
            -min(loop.crossing_hz(each.design.controller) for loop in loops(each.design, stage()))
        )
    )
    yield "largest bandwidth, for 0 %", _stored(fast, 0.0)
    published, ended, joint = JointDesign(), [], {}
    pools = {size: nominal + sample_plants(size, POOL if size else 0, POOL_SEED) for size in SIZES}
    for size, pool in pools.items():
        observer = search_pool(_with(begin[0], published, OBSERVER), "observer", pool).design
        second = [search_pool(_with(each, observer, OBSERVER), "controller", pool) for each in begin[:2]]
        yield f"two steps, for {100 * size:.0f} %", _stored(sorted(second, key=lambda each: each.cost), size)
        joint[size] = [
            search_pool(each, "joint", pool) for each in (begin if not size else begin[:1]) + ended
        ]
        ended.append(min(joint[size], key=lambda each: each.cost).design)
    joint[0.0] += [search_pool(each, "joint", nominal) for each in ended[1:]]
    for size, pool in pools.items():
        found = sorted(joint[size], key=lambda each: each.cost)
        yield f"joint, for {100 * size:.0f} %", _stored(found, size)
        calm = search_pool(replace(found[0].design, integrator=1.0), "joint", pool, LEFT_LIMIT)
        yield f"joint, for {100 * size:.0f} %, {1e9 * LEFT_LIMIT:g} nm/N", _stored([calm], size, LEFT_LIMIT)


def _with(design: JointDesign, other: JointDesign, names: tuple[str, ...]) -> JointDesign:
    """The design with some numbers of another one."""
    return replace(design, **{name: getattr(other, name) for name in names})


def _stored(found: list[Found], size: float, left: float = 0.0) -> Stored:
    """The first of the designs that were found, with six significant digits, and where each search ended."""

    def six(value):
        return tuple(map(six, value)) if isinstance(value, tuple) else float(f"{value:.5e}")

    design = JointDesign(**{name: six(getattr(found[0].design, name)) for name in NUMBERS})
    ends = sorted(six(each.error) for each in found if each.excess <= KEPT)
    return Stored(design, size, left, tuple(ends), len(found))


def as_toml(name: str, stored: Stored) -> str:
    """One table of ``joint.toml``."""
    values = asdict(stored)
    values = values.pop("design") | values
    lines = (f"{key} = {list(value) if isinstance(value, tuple) else value}" for key, value in values.items())
    return "\n".join([f"[{name!r}]", *lines])


# === Pictures =====================================================================================================

TOP_DB = 20.0  # where larger peaks are cut


def paint_designs(nominal: Mapping[str, Judged], published: Judged, floor: float):
    """Scan error of each design and what a step of the force leaves, a row a design; nominal stage."""
    figure, (left, right) = figures.new(1, 2, height=3.2, sharey=True)
    rows = {"as published": published} | dict(nominal)
    names = sorted(rows, key=lambda name: -rows[name].error[0])
    for axis, numbers in ((left, "error"), (right, "left")):
        values = [1e9 * getattr(rows[name], numbers)[0] for name in names]
        axis.plot(values, range(len(names)), "o", color=figures.BLUE, label="design")
    left.set_yticks(range(len(names)), names, fontsize=7)
    left.axvline(1e9 * floor, color=figures.BLACK, label="noise floor")
    limit = f"limit of the searches named by it, {1e9 * LEFT_LIMIT:g} nm/N"
    right.axvline(1e9 * LEFT_LIMIT, color=figures.BLACK, linestyle=":", label=limit)
    right.set_xscale("log")
    left.set(xlabel="rms error in the scan (nm)", xlim=(0, None))
    right.set(xlabel="left 100 to 200 ms after a step (nm/N)")
    handles = [each for axis in (left, right) for each in axis.lines[axis is right :]]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=7)
    return figure


def paint_peaks_over_plants(judged: Mapping[str, Mapping[str, Judged]]):
    """Largest peak of every design on every perturbed plant, by panel; unstable ones lie at the cut."""
    figure, axes = figures.new(1, len(judged), height=3.2, sharey=True, squeeze=False)
    for axis, (title, designs) in zip(axes[0], judged.items(), strict=True):
        for place, (name, found) in enumerate(designs.items()):
            shown = np.minimum(found.peaks.max(axis=1), TOP_DB)
            across = place + np.linspace(-0.3, 0.3, len(shown))
            axis.plot(across, shown, ".", markersize=4, color=figures.BLUE, label=name)
            note = f"{100 * np.mean(~found.stable):.0f} %\nunstable"
            axis.annotate(note, (place, TOP_DB + 0.8), ha="center", fontsize=6)
        mark_limit(axis)
        names = [name.replace(" ", "\n", 1).replace(", ", ",\n") for name in designs]
        axis.set_xticks(range(len(designs)), names, fontsize=6)
        axis.set(ylim=(0, TOP_DB + 4), title=title, xlabel="design")
    axes[0, 0].set_ylabel(f"largest peak (dB), cut at {TOP_DB:g}")
    dot, limit = axes[0, 0].lines[0], axes[0, 0].lines[-1]
    figure.legend([dot, limit], ["one stage", "limit, 6 dB"], loc="outside lower center", ncols=2)
    return figure


def paint_joint(
    designs: Mapping[str, JointDesign], design: str, frequency_error: float, bandwidth: float, delay: float
):
    """Explorer: the loop functions, of the worst mass each, with frequencies, bandwidth (%) and delay (samples) moved."""
    chosen = designs[design]
    chosen = replace(chosen, bandwidth_hz=chosen.bandwidth_hz * bandwidth / 100)
    nominal = stage()
    plant = detuned(nominal, np.full(len(nominal.frequencies) - nominal.rigid_modes, frequency_error / 100))
    found = respond(chosen, grid_of(plant, _fine(), delay), range(7), delay)
    sizes = {name.replace("_", " "): np.abs(getattr(found, name)).max(axis=0) for name in FUNCTIONS}
    figure, axis = plain(bottom=0.17)
    for label, size in sizes.items():
        add_magnitude(axis, _fine(), size, label=label)
    mark_limit(axis)
    verdict = "unstable"
    if stable_on(chosen, [plant], delay)[0]:
        peak = 20 * np.log10(max(size.max() for size in sizes.values()))
        error = scan(chosen, grid_of(plant, transform(), delay), delay).error()
        verdict = f"largest peak {peak:.1f} dB, scan error {1e9 * error:.2f} nm"
    axis.set(title=f"worst of the seven masses: {verdict}", xlabel="frequency (Hz)", ylabel="magnitude (dB)")
    axis.set_ylim(-40, 20)
    axis.legend(loc="lower left")
    return figure


# === The appendix =================================================================================================


def appendix(
    page, *, stored: Mapping[str, Stored], judges: Mapping[float, list[ModalModel]], fresh: Mapping
) -> None:
    """What the page of motion/27 judges beside its answer."""
    page.text("""## Robust by design

The searches for 2 and 5 % include the nominal stage and those of a pool of perturbed ones that break a limit, with 5.6 dB as a margin. On
the fresh stages, with the gains refitted there and with those of the nominal stage:""")
    robust = {}
    for (size, plants), claim in zip(judges.items(), ("two-percent", "five-percent"), strict=True):
        name, second = f"joint, for {100 * size:.0f} %", stored[f"two steps, for {100 * size:.0f} %"].design
        found, gains = fresh[size][name], 1e9 * errors_of_nominal_gains(stored[name].design, plants)
        low, middle, high = np.quantile(gains, [0.25, 0.5, 0.75])
        error, kept = 1e9 * found.error, int(found.feasible.sum())
        robust[name] = {
            "median, refitted": np.median(error),
            "worst, refitted": error.max(),
            "median, nominal gains": middle,
            "worst peak (dB)": found.peaks.max(),
            "keep all limits": found.feasible.mean(),
            "below two steps": np.mean(found.error < judge(second, plants).error),
        }
        page.check(f"motion.section-7-3.joint-error-{claim}", np.median(error), (error.min(), error.max()))
        interval = proportion_interval(kept, len(plants))
        page.check(f"motion.section-7-3.joint-keeps-{claim}", kept / len(plants), interval)
        page.check(f"motion.section-7-3.nominal-gains-{claim}", middle, (low, high))
    table = pd.DataFrame(robust).T
    page.show(table, float_format="{:.2f}".format)
    page.check("motion.section-7-3.joint-below-two-steps-fresh", table["below two steps"].min())
    floors = np.array([noise_floor(plant) for plant in judges[0.05]])
    page.check("motion.section-7-3.above-floor", np.mean(fresh[0.05]["joint, for 5 %"].error > floors))
    page.conclude(
        "The one for 5 % keeps 6 dB on {kept:.0%} and errs by {error:.2f} nm if the feedforward gains are refitted: with the "
        "nominal ones by {gains:.0f} nm.",
        kept=table["keep all limits"].iloc[-1],
        error=table["median, refitted"].iloc[-1],
        gains=table["median, nominal gains"].iloc[-1],
    )


def crossing_hz(design: JointDesign) -> float:
    """Lowest crossing of the loops of all masses of the nominal stage (Hz)."""
    return min(each.crossing_hz(design.controller) for each in loops(design, stage()))


if __name__ == "__main__":
    print(
        "# Observers and controllers of the stage that were searched together, and their rivals; numbers as in"
    )
    print("# notebooks.motion.joint_design.JointDesign and Stored. Made by")
    print("# `python -m notebooks.motion.joint_design`.")
    for found_name, found_stored in searched_designs():
        print(f"\n{as_toml(found_name, found_stored)}", flush=True)
