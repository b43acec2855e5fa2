"""Observers side by side on the same scans, each with one knob, tuned with the same effort on other plants."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from experiments.motion.model_bank import bank_estimate
from experiments.motion.scan_study import Records, Scan, filter_model, judge, record_scans
from experiments.motion.uncertainty import norm_bound, perturbed, sample_errors, sampled_derivatives
from stillwork.base.checks import InputError, require_choice, require_count
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.robust import Derivatives, kalman_gains, regularised_gains, sensitivity_gains
from stillwork.estimation.time_varying import TimeVaryingModel, estimate
from stillwork.lti.discretisation import zoh_modes


@dataclass(frozen=True)
class Contest:
    """What the observers are told: the nominal model, how it may be wrong, and how large the states are."""

    scan: Scan
    model: TimeVaryingModel
    derivatives: Derivatives
    size: float  # largest relative error they are told of
    scale: Float64[np.ndarray, " states"]  # size of the states in the scanning phase of the nominal plant


def prepare(scan: Scan, size: float, rigid: bool) -> Contest:
    """Contest with errors up to `size` in all modes, or (`rigid` false) in the flexible ones."""
    model = filter_model(scan)
    modes = range(0 if rigid else scan.nominal.rigid_modes, len(scan.nominal.frequencies))
    derivatives = sampled_derivatives(scan.nominal, scan.step, modes).along(model, scan.shapes[:, None, :])
    still = record_scans(scan, [np.zeros((len(scan.nominal.frequencies), 4))], np.random.default_rng(0))
    return Contest(scan, model, derivatives, size, judge(scan, still, np.zeros_like(still.states)).size[0])


def kalman(contest: Contest, factor: float, u, y):
    """Kalman filter with Q times `factor`."""
    model = contest.model
    return estimate(kalman_gains(model.with_process(model.g, factor * model.process)), u, y)


def regularised(contest: Contest, size: float, u, y):
    """Regularised least squares (5.21), told of errors up to `size`; lambda by the rule of thumb."""
    bound = norm_bound(contest.model, contest.derivatives, size)
    return estimate(regularised_gains(contest.model, bound), u, y)


def sensitivity(contest: Contest, weight: float, u, y):
    """Sensitivity penalisation (5.25) with gamma = `weight`."""
    return estimate(sensitivity_gains(contest.model, contest.derivatives, weight), u, y)


def fictitious(contest: Contest, deviation: float, u, y):
    """Kalman filter with an independent fictitious force of this deviation (N) on every mode."""
    model = contest.model
    states = model.a.shape[1]
    own = np.zeros((states, states // 2))
    pairs = np.arange(states).reshape(-1, 2)
    for mode, pair in enumerate(pairs):
        own[pair, mode] = model.b[1, pair, 0]
    process = np.diag([model.process[0, 0], *[deviation**2] * (states // 2)])
    return estimate(kalman_gains(model.with_process(np.hstack([model.b[1], own]), process)), u, y)


def hinfinity(contest: Contest, ratio: float, u, y):
    """H-infinity filter for the flexible states in units of their size, at `ratio` times the smallest level."""
    wanted = np.diag(1 / contest.scale)[2:]
    level = ratio * smallest_level(contest.model, wanted)
    return estimate(hinfinity_gains(contest.model, wanted, level), u, y)


def bank(contest: Contest, spread: float, u, y, grid=(3, 3), factor: float = 1.0):
    """Kalman filters on a grid of the first two flexible frequencies, off by up to `spread`, with Q times `factor`."""
    nominal = contest.scan.nominal
    models = []
    for place in np.ndindex(grid):
        errors = np.zeros((len(nominal.frequencies), 4))
        errors[1:3, 0] = [
            spread * np.linspace(-1, 1, points)[k] for points, k in zip(grid, place, strict=True)
        ]
        sampled = zoh_modes(perturbed(nominal, errors), contest.scan.step)
        process = factor * contest.model.process
        models.append(replace(contest.model, a=sampled.a, b=sampled.b, g=sampled.b, process=process))
    return bank_estimate(models, u, y).states


class Entrant(NamedTuple):
    """An observer, its one knob, where the knob may stand, and where the thesis (or habit) has it."""

    run: Callable
    knob: str
    low: float
    high: float
    given: float


ENTRANTS: Mapping[str, Entrant] = {
    "Kalman": Entrant(kalman, "factor on Q", 1e-2, 1e8, 1.0),
    "regularised least squares": Entrant(regularised, "largest error told", 5e-6, 5.0, 0.05),
    "sensitivity penalised": Entrant(sensitivity, "gamma", 2e-20, 2e-8, 2e-18),
    "fictitious noise": Entrant(fictitious, "force on a mode (N)", 1e-3, 1e3, 1.0),
    "H-infinity": Entrant(hinfinity, "level over the smallest", 1.01, 100.0, 1.2),
    "model bank": Entrant(bank, "spread of frequencies", 0.005, 0.08, 0.05),
}


def sample_scans(scan: Scan, plants: int, seed: int, size: float, law: str, rigid: bool) -> Records:
    """Recorded scans of randomly perturbed plants, see `uncertainty.sample_errors`."""
    rng = np.random.default_rng(seed)
    errors = [sample_errors(rng, scan.nominal, size, law, rigid) for _ in range(plants)]
    return record_scans(scan, errors, rng)


def run_entrant(name: str, contest: Contest, knob: float, records: Records):
    """Estimates of one observer on recorded scans, shape (runs, states, samples)."""
    require_choice("name", name, ENTRANTS)
    return ENTRANTS[name].run(contest, knob, records.u, records.y)


@dataclass(frozen=True)
class Tuning:
    """Cost of every knob position tried, and the best of them."""

    knobs: Float64[np.ndarray, " tries"]
    costs: Float64[np.ndarray, " tries"]  # median over plants of the relative error of the flexible states

    @property
    def best(self) -> float:
        return float(self.knobs[self.costs.argmin()])


def tune(name: str, contest: Contest, records: Records, tries: int) -> Tuning:
    """Try `tries` knob positions, equal in the logarithm, on recorded scans of plants kept for tuning.

    The cost is the median over plants of `Errors.flexible`.
    """
    require_choice("name", name, ENTRANTS)
    if tries < 2:
        raise InputError(f"tries is {tries}; give at least 2, the ends of the range")
    knobs = np.geomspace(ENTRANTS[name].low, ENTRANTS[name].high, tries)
    costs = []
    for knob in knobs:
        errors = judge(contest.scan, records, run_entrant(name, contest, float(knob), records))
        costs.append(float(np.median(errors.flexible())))
    return Tuning(knobs, np.array(costs))


def contest_trial(
    rng: np.random.Generator, contest: Contest, knobs: Mapping[str, float], plants: int, law: str = "ends"
) -> dict[str, np.ndarray]:
    """Relative error of the flexible states of every observer on `plants` random stages; a trial of a study.

    A trial takes several plants, because an observer is designed once and then run on all of them.

    `knobs` says where the knob of every observer stands. Flexible modes err, by the contest's size and `law`.
    """
    scan = contest.scan
    errors = [
        sample_errors(rng, scan.nominal, contest.size, law) for _ in range(require_count("plants", plants))
    ]
    records = record_scans(scan, errors, rng)
    return {
        name: judge(scan, records, run_entrant(name, contest, knob, records)).flexible()
        for name, knob in knobs.items()
    }
