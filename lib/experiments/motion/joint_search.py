"""The joint design judged and searched: peaks, scan error and noise of all seven masses on many stages at once.

One grid of frequencies, that of the fast Fourier transform, serves the error of a move, the variance of noise and the
peaks. A search trusts it; a verdict does not: `judge` looks between its points, at the closed loop's poles too.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Complex128, Float64
from scipy import optimize

from experiments.motion.joint import (
    CONTROLLER,
    DELAY,
    NUMBERS,
    OBSERVER,
    SAMPLE_TIME,
    Compensated,
    JointDesign,
    Late,
    closed_poles,
    compensated,
    late,
    late_response,
)
from experiments.motion.machines import published_deviations, published_noise, published_setpoint, stage
from experiments.motion.uncertainty import perturbed, sample_errors
from stillwork.base.algebra import squared_size
from stillwork.base.checks import InputError, require_choice, require_count, require_number
from stillwork.base.front_door import checked
from stillwork.base.kernels import kernel
from stillwork.control.bandwidth import SIX_DB
from stillwork.control.crossover import crossover
from stillwork.estimation.riccati import discrete_gain
from stillwork.lti.discretisation import zoh_modes, zoh_response
from stillwork.lti.modal import ModalModel

_deviations = cache(published_deviations)  # a search asks for them thousands of times

# Of the transform: 2.4 Hz between frequencies and 0.24 s for an error to die out while a search goes on, and four
# times as much of both for a verdict.
SAMPLES, JUDGED = 4096, 16384
PEAKS = ("S_I", "S_O", "r to e", "1 - S_I", "1 - S_O", "r to y")  # all six at most 6 dB
BANDS_HZ = (0.0, 60.0, 150.0, 350.0, 600.0, 1100.0, 5000.0)  # a search follows the largest peak in each
MEASURED = 4  # mass 5, at which the thesis judges a scan

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
AIMS = ("error", "bandwidth")
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


class Served(NamedTuple):
    """A stage on the grid of a transform."""

    model: ModalModel
    plant: Complex128[np.ndarray, "masses frequencies"]  # from the command, late
    pushed: Float64[np.ndarray, "masses frequencies"]  # size of that from a force that is not late


def serve(model: ModalModel, delay: float = DELAY, samples: int = SAMPLES) -> Served:
    """Prepare the responses of a stage."""
    omega = grid(samples)
    pushed = np.abs(zoh_response(model, SAMPLE_TIME, omega)[:, 0])
    return Served(model, late_response(late(model, delay), omega), pushed)


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


class Met(NamedTuple):
    """What a design does on one stage, by the grid; logarithms of magnitudes."""

    tops: Float64[np.ndarray, "masses functions bands"]
    error: float  # m, rms of the true error in the scan, the noise's mean power included
    quiet: float  # m, without noise
    force: float  # N, rms of the whole control force under noise


def meet(design: JointDesign, served: Sequence[Served], delay: float = DELAY) -> list[Met]:
    """Peaks of all masses, scan error and noise at mass 5, on every stage; what is unstable is not noticed here."""
    around = compensated(design, grid(), delay)
    feedback = around.feedback[MEASURED]
    found = []
    for each in served:
        tops = np.empty((len(each.plant), len(PEAKS), len(BANDS_HZ) - 1))
        _tops(each.plant, *around, _ends(), tops)
        found.append(Met(tops, *scanned(feedback, each.plant[MEASURED], each.pushed[MEASURED], delay)))
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


def rough_crossing_hz(design: JointDesign, served: Served) -> Float64[np.ndarray, " masses"]:
    """`crossing_hz` by the grid alone, a straight line between its points in logarithms: 1e-4 off, and quick."""
    gain = np.log(np.abs(_loop(served.plant, compensated(design, grid()))))
    first = np.argmax(gain < 0, axis=1)[:, None]
    if not first.all():
        raise InputError("a loop does not fall through 0 dB within the grid; it has no bandwidth")
    below, above = (np.take_along_axis(gain, first - k, axis=1) for k in (0, 1))
    low, high = (np.log(grid()[first - k]) for k in (1, 0))
    return np.exp(low + (high - low) * above / (above - below))[:, 0] / (2 * np.pi)


def scanned(
    feedback: Complex128[np.ndarray, " frequencies"],
    plant: Complex128[np.ndarray, " frequencies"],
    pushed: Float64[np.ndarray, " frequencies"],
    delay: float,
    samples: int = SAMPLES,
) -> tuple[float, float, float]:
    """Error, quiet and force of `Met` for one mass, its feedforward's four gains fitted in this very loop.

    With the modified feedforward of appendix A the setpoint acts like v and the original feedforward like a force
    that no observer sees: e = S_O (r - P u0).
    """
    steps, ahead, move, scanning = _move(delay, samples)
    sensitivity = 1 / (1 + plant * feedback)
    position = steps / -np.expm1(-1j * grid(samples) * SAMPLE_TIME)
    errors = np.fft.irfft(sensitivity * np.vstack([position, plant * ahead]), samples)[:, move]
    columns = errors[1:] / np.linalg.norm(errors[1:], axis=1)[:, None]
    gains = np.linalg.solve(columns @ columns.T, columns @ errors[0])
    quiet = float(np.sqrt(np.mean((errors[0] - gains @ columns)[scanning] ** 2)))
    noise, s = _deviations(), np.abs(sensitivity) ** 2
    given = noise["w"] ** 2 * pushed**2 + noise["v"] ** 2
    weights = np.full(len(s), 2.0 / samples)  # of both signs of a frequency
    weights[[0, -1]] /= 2
    error = weights @ (s * given + np.abs(1 - sensitivity) ** 2 * noise["d"] ** 2)
    force = weights @ (np.abs(feedback) ** 2 * s * (given + noise["d"] ** 2))
    return float(np.hypot(quiet, np.sqrt(error))), quiet, float(np.sqrt(force))


def noise_floor(model: ModalModel, delay: float = DELAY) -> float:
    """Rms of mass 5's error under the noise of section 3.1 (m) that no controller goes below, whatever it knows.

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

    @property
    def keeps(self) -> Bool[np.ndarray, " plants"]:
        """Where all loops are stable and all six peaks at 6 dB or below."""
        return self.stable & (self.peaks.max(axis=1) <= 20 * np.log10(SIX_DB) + 1e-6)


@checked
def stable_on(design: JointDesign, plants: Sequence[ModalModel]) -> Bool[np.ndarray, " plants"]:
    """Whether the loops of all masses are stable on every plant."""
    return np.all(np.abs(closed_poles(design, plants)) < 1, axis=(1, 2))


def judge(design: JointDesign, plants: Sequence[ModalModel], delay: float = DELAY) -> Judged:
    """What a design does on every plant, see `judge_all`."""
    return judge_all({"": design}, plants, delay)[""]


@checked(infinite=True)
def judge_all(
    designs: Mapping[str, JointDesign],
    plants: Sequence[ModalModel],
    delay: float = DELAY,
    alone: int = 0,
    told: float | None = None,
) -> dict[str, Judged]:
    """Stability by eigenvalues, peaks looked for between grid points and at closed-loop poles, the scan's error.

    `delay` is that of the whole control force in samples, of which the observer is `told` all if nothing else is said;
    `alone` one more of the controller's output by itself. The plants' responses are computed once for all designs.
    """
    moved = [late(plant, delay) for plant in plants]
    coarse = [late_response(each, grid()) for each in moved]
    scanning = [serve(plant.at([0], [MEASURED]), delay, JUDGED) for plant in plants]
    told, judged = delay if told is None else told, {}
    for name, design in designs.items():
        poles = closed_poles(design, plants, delay, alone, told)
        stable = np.all(np.abs(poles) < 1, axis=(1, 2))
        around = partial(compensated, design, delay=told, alone=alone)
        on_grid = around(grid())
        feedback = around(grid(JUDGED), masses=slice(MEASURED, MEASURED + 1)).feedback[0]
        peaks, scans = np.full((len(plants), len(PEAKS)), np.inf), np.full((3, len(plants)), np.inf)
        for k in np.flatnonzero(stable):
            peaks[k] = 20 * np.log10(_highest(around, moved[k], six(coarse[k], on_grid), poles[k]))
            _, (response,), (pushed,) = scanning[k]
            scans[:, k] = scanned(feedback, response, pushed, delay, JUDGED)
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


def sample_plants(size: float, count: int, seed: int, law: str = "ends") -> list[ModalModel]:
    """Stages with random relative errors of `size` on all modal parameters, rigid body included (as in Table 5.2)."""
    rng, nominal = np.random.default_rng(seed), stage()
    return [perturbed(nominal, sample_errors(rng, nominal, size, law, True)) for _ in range(count)]


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
    served: Sequence[Served],
    limit: float = SIX_DB,
    force: float | None = None,
    steps: int = 40,
    counted: int | None = None,
    aim: str = "error",
) -> Found:
    """Least mean square of the scan error over some stages, all six peaks of all masses below `limit`, from one start.

    Every step linearises the logarithms of error, peaks and noise in the logarithms of the `free` numbers and solves a
    linear program within a trusted region; it is taken when it lowers an exact penalty and leaves all loops stable. The
    start is stable, but its peaks may exceed the limit. `force` limits the rms of the control force under noise (N). The
    first `counted` stages count in the error; the others must keep the limits only. The `aim` ``bandwidth`` seeks the
    latest crossing of the slowest loop, and of the error nothing.
    """
    names = FREE[require_choice("free", free, FREE)]
    require_choice("aim", aim, AIMS)
    require_number("limit", limit, above=1.0)
    if force is not None:
        require_number("force", force, above=0.0)
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
        met = meet(design, served)
        if aim == "bandwidth":
            wanted = 1 / min(rough_crossing_hz(design, each).min() for each in served[:counted])
        else:
            wanted = _mean_error(met[:counted])
        return float(np.log(wanted)), _excesses(met, limit, force)

    error, others = ask(x)
    radius, meetings = RADIUS, len(served)
    for _ in range(require_count("steps", steps)):
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
    ended = _mean_error(meet(at(x), served[:counted]))
    return Found(at(x), ended, float(others.max()), meetings)


def _merit(error: float, others: np.ndarray) -> float:
    return error + PENALTY * max(float(others.max()), 0.0)


def _program(cost, others, slopes, low, high) -> tuple[np.ndarray, float]:
    """Step that the linear program takes, and how much of the merit it promises."""
    bounds = [*zip(low, high, strict=True), (0.0, None)]  # the last one: the largest excess
    columns = np.hstack([slopes, -np.ones((len(slopes), 1))])
    found = optimize.linprog(np.r_[cost, PENALTY], columns, -others, bounds=bounds, method="highs")
    return found.x[:-1], PENALTY * max(float(others.max()), 0.0) - found.fun


def _mean_error(met: Sequence[Met]) -> float:
    return float(np.sqrt(np.mean(np.square([each.error for each in met]))))


def _excesses(met: Sequence[Met], limit: float, force: float | None) -> np.ndarray:
    """Logarithms of peaks over their limit, and of the force over its; what keeps them is not positive."""
    tops = np.array([each.tops for each in met]) - np.log(limit)
    return np.concatenate([tops.ravel(), np.log([each.force / force for each in met]) if force else []])


def starts(count: int, seed: int) -> list[JointDesign]:
    """Where searches begin: the published design at half its bandwidth, then random ones around it that are stable."""
    rng = np.random.default_rng(seed)
    published = JointDesign()
    found = [replace(published, bandwidth_hz=published.bandwidth_hz / 2)]
    while len(found) < require_count("count", count):
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
    pool: Sequence[Served],
    limit: float = SIX_DB,
    force: float | None = None,
    counted: int = 6,
    turns: int = 5,
    steps: int = 12,
) -> Found:
    """Search for many stages: the error of the first ones counts, those that break a limit most are taken in by turns.

    Judge the design on others. A start that is unstable on some is slowed down until it is not.
    """
    while not np.all(stable_on(start, [each.model for each in pool])):
        if start.bandwidth_hz < 2 * LIMITS["bandwidth_hz"][0]:
            raise InputError("start has an unstable loop on some stage at every bandwidth; give another")
        start = replace(start, bandwidth_hz=0.8 * start.bandwidth_hz)
    served, meetings, best = list(range(min(counted, len(pool)))), 0, None
    for _ in range(require_count("turns", turns)):
        found = search(start, free, [pool[k] for k in served], limit, force, steps, counted)
        met = meet(found.design, pool)
        meetings += found.meetings + len(pool)
        over = np.array([_excesses([each], limit, force).max() for each in met])
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
