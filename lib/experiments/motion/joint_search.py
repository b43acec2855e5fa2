"""Search for the joint design by sequential linear programs, and verification by exact norms and eigenvalues."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float64
from scipy import optimize

from experiments.motion.designs import DAMPING
from experiments.motion.joint import (
    CHANNELS,
    FREE,
    PUBLISHED,
    JointDesign,
    StageResponses,
    published_softness,
)
from experiments.motion.machines import stage
from experiments.motion.uncertainty import perturbed, sample_errors
from stillwork.base.checks import InputError, require_choice, require_count, require_number
from stillwork.control.bandwidth import SIX_DB, Loop
from stillwork.control.crossover import crossover
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import Pid
from stillwork.lti.modal import ModalModel
from stillwork.lti.norms import hinf_norm
from stillwork.lti.peaks import Peak, resonance_grid
from stillwork.lti.state_space import constant

# Where the numbers may stand.
LIMITS = {
    "bandwidth_hz": (10.0, 250.0),
    "gain": (0.2, 4.0),
    "integrator": (0.2, 4.0),
    "differentiator": (0.1, 1.0),
    "low_pass": (1.0, 10.0),
    "low_pass_damping": (0.4, 1.2),
    "process": (1e-3, 1e3),
    "noise_model": (1e-2, 1e6),
    "damping": (1e-4, 0.3),
    "selectivity": (0.3, 20.0),
}

CROSSED = 2 * np.pi * np.geomspace(5, 300, 200)  # rad/s, where the first crossing of a loop is looked for

RADIUS, SMALLEST_RADIUS = 0.1, 1e-4  # of the region in which the linear program is trusted, in logarithms
SMALLEST_GAIN = 1e-5  # of bandwidth, relative; a step that brings less ends the search
CONVERGED = 1e-3  # of bandwidth, relative; a round that brings less, and keeps the limit, ends the search
MARGIN = 5e-4  # by which the search keeps below the limit, for peaks between its grid points
PENALTY = 10.0  # a peak 1 % too high costs as much as 10 % of bandwidth


@dataclass(frozen=True)
class Verified:
    """A design with the exact peaks of its loops; nothing here comes from a grid."""

    design: JointDesign
    peaks: Float64[
        np.ndarray, "functions masses"
    ]  # H-infinity norms, in the order of CHANNELS; inf if unstable
    frequencies: Float64[np.ndarray, "functions masses"]  # where they are, rad/s
    crossing_hz: Float64[np.ndarray, " masses"]  # first 0 dB crossing of every loop
    stable: bool
    evaluations: int = 0  # responses of seven loops that the search computed

    @property
    def worst(self) -> float:
        """The largest peak of all."""
        return float(self.peaks.max())

    def keeps(self, limit: float = SIX_DB) -> bool:
        """Whether every loop is stable and every peak at or below the limit."""
        return self.stable and self.worst <= limit


def verify(design: JointDesign, plant: ModalModel | None = None, evaluations: int = 0) -> Verified:
    """Eigenvalues and H-infinity norms of all loops of a design, on the nominal stage or on another."""
    peaks, crossings, stable = [], [], True
    controller = design.controller
    for loop in design.loops(plant):
        closed = closed_loop(loop.plant, loop.compensator, controller.state_space())
        steady = closed.is_stable
        stable &= steady
        for ends in CHANNELS.values():
            peaks.append(hinf_norm(channel(closed, *ends)) if steady else Peak(np.inf, np.nan))
        gain = partial(_open_loop, loop, controller)
        crossings.append(crossover(gain, CROSSED, np.abs(gain(CROSSED))) / (2 * np.pi))
    found = np.array(peaks).reshape(len(crossings), len(CHANNELS), 2)
    return Verified(design, found[..., 0].T, found[..., 1].T, np.array(crossings), stable, evaluations)


def _open_loop(loop: Loop, controller: Pid, omega: np.ndarray) -> np.ndarray:
    """On the loop's own plant: the responses that it keeps are those of the nominal one."""
    return loop.at(controller, omega).loop


def search_grid(plants: Sequence[ModalModel] = (), points: int = 250, around: int = 10):
    """Frequencies (rad/s) from 5 Hz to 4 kHz, refined around the resonances of every plant."""
    poles = np.concatenate([plant.poles for plant in plants or [stage()]])
    return resonance_grid(poles, 5.0, 4000.0, points, around)


def search(
    start: JointDesign,
    free: str,
    limit: float = SIX_DB,
    plants: Sequence[ModalModel] = (),
    steps: int = 60,
    rounds: int = 20,
    seen: Sequence[float] = (),
) -> Verified:
    """Largest bandwidth with all peaks below `limit` and slow forces rejected as published, from one stable start.

    Every step linearises the logarithms of all constraints in the logarithms of the free numbers and solves a
    linear program within a trusted region; it is taken when it lowers an exact penalty. Every round verifies the
    result and adds the frequencies of the true peaks to the grid, where the grid has missed one; `seen` (rad/s) are
    there from the start. The design serves all `plants`, its peaks are verified on the nominal one.
    """
    names = ("bandwidth_hz", *FREE[require_choice("free", free, FREE)])
    require_number("limit", limit, above=1.0)
    require_count("steps", steps)
    require_count("rounds", rounds)
    if not np.all(stable_on(start, plants or [stage()])):
        raise InputError("start has an unstable loop; lower its bandwidth_hz")
    omega, counted, margin = np.union1d(search_grid(plants), seen), 0, MARGIN
    best, found = None, Verified(start, np.full((1, 1), np.inf), np.empty((1, 1)), np.zeros(1), True)
    for _ in range(rounds):
        before = found.design
        design, used = _climb(StageResponses(omega, plants), before, names, limit * (1 - margin), steps)
        counted += used
        found = verify(design, evaluations=counted)
        if found.keeps(limit):
            if best is None or found.crossing_hz.min() >= best.crossing_hz.min():
                best = found
            if design.bandwidth_hz < before.bandwidth_hz * (1 + CONVERGED):
                break
        elif not found.stable:
            break
        else:
            near = found.frequencies[found.peaks > limit]
            omega = np.unique(np.concatenate([omega, *(near * factor for factor in (0.995, 1.0, 1.005))]))
            margin *= 2
    return replace(best or found, evaluations=counted)


def starts(count: int, seed: int) -> list[JointDesign]:
    """Where the searches begin: the published design, then random ones around it, all at half its bandwidth."""
    rng = np.random.default_rng(seed)
    found = [replace(PUBLISHED, bandwidth_hz=PUBLISHED.bandwidth_hz / 2)]
    while len(found) < require_count("count", count):
        tried = replace(
            found[0],
            process=float(np.exp(rng.normal(0.0, 1.5))),
            noise_model=float(10 ** rng.uniform(0.0, 5.0)),
            damping=tuple((DAMPING * np.exp(rng.normal(0.0, 0.7, 3))).tolist()),
            selectivity=tuple((2.0 * np.exp(rng.normal(0.0, 0.7, 3))).tolist()),
        )
        if np.all(stable_on(tried, [stage()])):
            found.append(tried)
    return found


def sample_plants(size: float, count: int, seed: int) -> list[ModalModel]:
    """Stages with random relative errors of `size` on all modal parameters, rigid body included (as in Table 5.2)."""
    rng, nominal = np.random.default_rng(seed), stage()
    return [perturbed(nominal, sample_errors(rng, nominal, size, "ends", True)) for _ in range(count)]


def plant_peaks(design: JointDesign, plants: Sequence[ModalModel]) -> Float64[np.ndarray, " plants"]:
    """Largest peak over all loops and constraints on every plant; infinite where a loop has an unstable pole.

    The observers stay those of the nominal stage. Stability is that of the eigenvalues; the peaks are those of
    a grid, each looked at again between its neighbours.
    """
    peaks = np.array([_largest(design, plant)[0] for plant in plants])
    return np.where(stable_on(design, plants), peaks, np.inf)


def _largest(design: JointDesign, plant: ModalModel) -> tuple[float, float]:
    """Largest peak on a plant and its frequency (rad/s), stable or not."""
    omega = search_grid([plant], 400, 20)
    for _ in range(3):
        response = StageResponses(omega, [plant]).loops(design).response
        rows = np.abs([getattr(response, name)[0] for name in CHANNELS]).reshape(-1, len(omega))
        tops = np.unique(rows.argmax(axis=1))
        found = float(rows.max()), float(omega[rows.max(axis=0).argmax()])
        ends = omega[np.clip(tops - 1, 0, None)], omega[np.clip(tops + 1, None, len(omega) - 1)]
        omega = np.unique(np.linspace(*ends, 13))
    return found


def robust_search(
    start: JointDesign,
    free: str,
    size: float,
    seed: int,
    pool: int = 60,
    worst: int = 4,
    turns: int = 12,
    **settings,
) -> Verified:
    """Search for a design that keeps the limit on a pool of perturbed plants, taking in the worst ones in turn.

    Judge it on plants of another seed.
    """
    plants, limit = sample_plants(size, pool, seed), settings.get("limit", SIX_DB)
    design, counted, served, missed = start, 0, [], []
    chosen = list(range(worst))
    for _ in range(require_count("turns", turns)):
        served += chosen
        serving = [stage(), *(plants[k] for k in served)]
        found = search(design, free, plants=serving, rounds=1, seen=missed, **settings)
        design, counted = found.design, counted + found.evaluations * len(serving)
        tops = np.array([_largest(design, plant) for plant in plants])
        over = [int(k) for k in np.argsort(-tops[:, 0]) if tops[k, 0] > limit]
        if not over:
            break
        missed += [tops[k, 1] for k in over if k in served]
        chosen = [k for k in over if k not in served][:worst]
    return replace(found, evaluations=counted)


def _climb(responses, start: JointDesign, names, limit: float, steps: int) -> tuple[JointDesign, int]:
    """Sequential linear programs on one grid; returns the design and the number of evaluations."""
    sizes = [np.size(getattr(start, name)) for name in names]
    low, high = np.log(np.repeat([LIMITS[name] for name in names], sizes, axis=0)).T
    x = np.clip(_vector(start, names), low, high)
    values = _constraints(responses, _design(start, names, x), limit)
    frequencies = len(responses.omega)
    others = len(values) - len(CHANNELS) * responses.rows * frequencies
    counted, radius = 1, RADIUS
    for _ in range(steps):
        near = _near(values, others, frequencies)
        slopes = np.empty((int(near.sum()), len(x)))
        for k in range(len(x)):
            moved = x.copy()
            moved[k] += 1e-5
            slopes[:, k] = _constraints(responses, _design(start, names, moved), limit)[near]
        slopes = (slopes - values[near, None]) / 1e-5
        counted += len(x)
        while radius > SMALLEST_RADIUS:
            step, foreseen = _program(
                values[near], slopes, np.maximum(low - x, -radius), np.minimum(high - x, radius)
            )
            tried = _constraints(responses, _design(start, names, x + step), limit)
            counted += 1
            gained = _merit(x, values) - _merit(x + step, tried)
            if gained > 0.1 * foreseen:
                break
            radius /= 3
        else:
            break
        x, values = x + step, tried
        if gained > 0.7 * foreseen:
            radius = min(2 * radius, 0.5)
        if gained < SMALLEST_GAIN:
            break
    return _design(start, names, x), counted


def _merit(x: np.ndarray, values: np.ndarray) -> float:
    return -x[0] + PENALTY * max(float(values.max()), 0.0)


def _program(values, slopes, low, high) -> tuple[np.ndarray, float]:
    """Step that the linear program takes, and how much of the merit it promises."""
    n = slopes.shape[1]
    cost = np.zeros(n + 1)
    cost[0], cost[-1] = -1.0, PENALTY
    rows = np.hstack([slopes, -np.ones((len(slopes), 1))])
    bounds = [*zip(low, high, strict=True), (0.0, None)]
    found = optimize.linprog(cost, rows, -values, bounds=bounds, method="highs")
    return found.x[:n], PENALTY * max(float(values.max()), 0.0) - found.fun


def _constraints(responses: StageResponses, design: JointDesign, limit: float) -> np.ndarray:
    """Logarithms that must not be positive: every peak over the limit, and 1 over the loop gain at f."""
    found = responses.loops(design)
    peaks = [np.log(np.abs(getattr(found.response, name)) / limit).ravel() for name in CHANNELS]
    soft = np.log(found.softness / published_softness()).ravel()
    return np.concatenate([-np.log(found.gain).ravel(), soft, *peaks])


def _near(values: np.ndarray, others: int, frequencies: int) -> np.ndarray:
    """Constraints that a step must look at: all but the peaks, and of these the maxima with their neighbours."""
    rows = values[others:].reshape(-1, frequencies)
    top = np.full_like(rows, -np.inf)
    top[:, 1:-1] = np.maximum(rows[:, :-2], rows[:, 2:])
    maxima = (rows >= top) & (rows > max(values.max(), 0.0) - 0.5)
    wide = maxima.copy()
    wide[:, :-1] |= maxima[:, 1:]
    wide[:, 1:] |= maxima[:, :-1]
    return np.concatenate([np.ones(others, bool), wide.ravel()])


def stable_on(design: JointDesign, plants: Sequence[ModalModel]) -> Bool[np.ndarray, " plants"]:
    """Whether all loops of every plant are stable, by the eigenvalues of plant and equivalent controller."""
    nothing = constant(np.zeros((1, 1)))
    states = [plant.state_space() for plant in plants]
    stable = np.ones(len(plants), bool)
    for mass, loop in enumerate(design.loops()):
        seen = channel(closed_loop(nothing, loop.compensator, design.controller.state_space()), "d", "f")
        whole = [
            np.block([[p.a, p.b @ seen.c], [seen.b @ p.c[mass : mass + 1], seen.a]]) for p in states
        ]  # the equivalent controller has no feedthrough
        stable &= np.all(np.linalg.eigvals(np.array(whole)).real < 0, axis=1)
    return stable


def _vector(design: JointDesign, names: Sequence[str]) -> np.ndarray:
    return np.log(np.concatenate([np.atleast_1d(getattr(design, name)) for name in names]))


def _design(start: JointDesign, names: Sequence[str], x: np.ndarray) -> JointDesign:
    values, place = {}, 0
    for name in names:
        if isinstance(getattr(start, name), tuple):
            values[name] = tuple(np.exp(x[place : place + 3]).tolist())
            place += 3
        else:
            values[name] = float(np.exp(x[place]))
            place += 1
    return replace(start, **values)
