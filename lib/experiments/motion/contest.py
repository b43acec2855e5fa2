"""Observers side by side on the same scans, each with one knob, tuned alike; what section 5.4.3 says of Fig. 5.10."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike

from experiments.motion.scan_study import Errors, Records, Scan, filter_model, judge, record_scans, rms
from experiments.motion.uncertainty import detuned, norm_bound, sample_errors, sampled_derivatives
from stillwork.base.checks import InputError, require_array, require_choice, require_count
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.robust import Derivatives, kalman_gains, regularised_gains, sensitivity_gains
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel, estimate
from stillwork.lti.discretisation import zoh_modes


def bank_estimate(
    models: Sequence[TimeVaryingModel],
    u: ArrayLike,
    y: ArrayLike,
) -> tuple[Float64[np.ndarray, "runs states samples"], Float64[np.ndarray, "models runs samples"]]:
    """Mean over the models and the posterior probability of each (static multiple-model estimation, Magill 1965)."""
    if not models:
        raise InputError("models is empty; give at least one")
    y, u = require_array("y", y, ndim=3), require_array("u", u, ndim=3)
    states, scores = [], []
    for model in models:
        gains = kalman_gains(model)
        x = estimate(gains, u, y)
        states.append(x)
        scores.append(np.cumsum(log_likelihood(model, gains, u, y, x), axis=1))
    scores = np.array(scores)
    weights = np.exp(scores - scores.max(axis=0))
    weights /= weights.sum(axis=0)
    return np.einsum("mrk,mrnk->rnk", weights, np.array(states)), weights


def log_likelihood(
    model: TimeVaryingModel,
    gains: FilterGains,
    u: Float64[np.ndarray, "runs inputs samples"],
    y: Float64[np.ndarray, "runs outputs samples"],
    states: Float64[np.ndarray, "runs states samples"],
) -> Float64[np.ndarray, "runs samples"]:
    """Logarithm of the density of every measurement given those before it; 0 at the first sample."""
    predicted = np.einsum("kij,rjk->rik", gains.forward[1:], states[:, :, :-1])
    predicted += np.einsum("kij,rjk->rik", gains.inputs[1:], u[:, :, :-1])
    innovation = y[:, :, 1:] - np.einsum("koi,rik->rok", gains.outputs[1:], predicted)
    along, driven, seen = model.a[1:], model.g[1:], model.c[1:]
    before = along @ gains.covariance[:-1] @ np.swapaxes(along, 1, 2)
    before += driven @ model.process @ np.swapaxes(driven, 1, 2)
    root = np.linalg.cholesky(seen @ before @ np.swapaxes(seen, 1, 2) + model.sensor)
    white = np.linalg.solve(root[None], np.moveaxis(innovation, 2, 1)[..., None])[..., 0]
    logs = np.log(np.einsum("kii->ki", root)).sum(axis=1)
    out = np.zeros((len(y), y.shape[2]))
    out[:, 1:] = -0.5 * np.sum(white**2, axis=2) - logs - 0.5 * y.shape[1] * np.log(2 * np.pi)
    return out


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
    derivatives = sampled_derivatives(scan.nominal, scan.sample_time, modes).along(
        model, scan.shapes[:, None, :]
    )
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
    own[np.arange(states), np.arange(states) // 2] = model.b[1, :, 0]
    process = np.diag([model.process[0, 0], *[deviation**2] * (states // 2)])
    return estimate(kalman_gains(model.with_process(np.hstack([model.b[1], own]), process)), u, y)


def hinfinity(contest: Contest, ratio: float, u, y):
    """H-infinity filter for the flexible states in units of their size, at `ratio` times the smallest level."""
    wanted = np.diag(1 / contest.scale)[2:]
    level = ratio * smallest_level(contest.model, wanted)
    return estimate(hinfinity_gains(contest.model, wanted, level), u, y)


def bank(contest: Contest, spread: float, u, y, grid=(3, 3), factor: float = 1.0):
    """Kalman filters on a grid of both flexible frequencies, off by up to `spread`, with Q times `factor`."""
    nominal = contest.scan.nominal
    models = []
    for place in np.ndindex(grid):
        errors = [spread * np.linspace(-1, 1, points)[k] for points, k in zip(grid, place, strict=True)]
        sampled = zoh_modes(detuned(nominal, errors), contest.scan.sample_time)
        process = factor * contest.model.process
        models.append(replace(contest.model, a=sampled.a, b=sampled.b, g=sampled.b, process=process))
    return bank_estimate(models, u, y)[0]


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


def sample_scans(
    scan: Scan, plants: int, seed: int | np.random.Generator, size: float, law: str, rigid: bool
) -> Records:
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
    tries = require_count("tries", tries, at_least=2)  # the ends of the range
    knobs = np.geomspace(ENTRANTS[name].low, ENTRANTS[name].high, tries)
    tried = (run_entrant(name, contest, float(knob), records) for knob in knobs)
    costs = [np.median(judge(contest.scan, records, each).flexible()) for each in tried]
    return Tuning(knobs, np.array(costs))


def contest_trial(
    rng: np.random.Generator, contest: Contest, knobs: Mapping[str, float], plants: int, law: str = "ends"
) -> dict[str, np.ndarray]:
    """Relative error of the flexible states of every observer on `plants` random stages; a trial of a study.

    A trial takes several plants, because an observer is designed once and then run on all of them.

    `knobs` says where the knob of every observer stands. Flexible modes err, by the contest's size and `law`.
    """
    scan = contest.scan
    records = sample_scans(scan, require_count("plants", plants), rng, contest.size, law, False)
    return {
        name: judge(scan, records, run_entrant(name, contest, knob, records)).flexible()
        for name, knob in knobs.items()
    }


AS_KALMAN = 0.05  # "identical" rigid-body errors of two filters: the width of a line in the figure
_FLEXIBLE, _POSITIONS = slice(2, 6), [2, 4]


def figure_statements(
    kalman: Errors, penalised: Errors, regularised: Errors
) -> dict[str, Bool[np.ndarray, " runs"]]:
    """On which plants each statement about Fig. 5.10 holds; the figure shows rigid body, first and second mode."""
    rigid, worse = penalised.rms[:, :2] / kalman.rms[:, :2], np.maximum(kalman.rms, penalised.rms)
    return {
        "regularised-best-on-rigid": regularised.rms[:, 0] < np.minimum(kalman.rms, penalised.rms)[:, 0],
        "sensitivity-rigid-as-kalman": (np.abs(rigid - 1) < AS_KALMAN).all(axis=1),
        "regularised-worst-on-flexible": (regularised.rms > worse)[:, _FLEXIBLE].all(axis=1),
        "regularised-above-state": (regularised.rms > regularised.size)[:, _FLEXIBLE].all(axis=1),
        "sensitivity-drift": (np.abs(penalised.drift) > np.abs(kalman.drift))[:, _POSITIONS].all(axis=1),
        "sensitivity-end-above-state": (np.abs(penalised.end) > penalised.size)[:, _POSITIONS].all(axis=1),
        "kalman-below-state-move": (kalman.move < kalman.move_size)[:, _FLEXIBLE].all(axis=1),
        "kalman-below-state-scan": (kalman.rms < kalman.size)[:, _FLEXIBLE].all(axis=1),
        "larger-in-acceleration": np.all(
            [(e.accelerating > e.rms)[:, _POSITIONS] for e in (kalman, penalised, regularised)], axis=(0, 2)
        ),
    }


@dataclass(frozen=True)
class OutputErrors:
    """Of an estimate what MC lives on, and what (5.26) says of it; rms in the scanning phase, a value a plant."""

    noise: Float64[np.ndarray, " runs"]  # m, -v + d
    innovation: Float64[np.ndarray, " runs"]  # m, e_y = y - C x_hat
    deformation: Float64[np.ndarray, " runs"]  # m, y_flex: what the flexible modes add to the position
    deformation_error: Float64[np.ndarray, " runs"]  # m, y_flex less its estimate
    position_errors: Float64[np.ndarray, "runs modes"]  # of the modal positions, sqrt(kg) m
    by_pseudo_inverse: Float64[np.ndarray, "runs modes"]  # the same by (5.26)


def output_errors(scan: Scan, errors: ArrayLike, records: Records, estimates: ArrayLike) -> OutputErrors:
    r"""Errors of the predicted output, and :math:`C^\dagger(-v+d+C^\delta x)` of (5.26).

    `errors` (runs, modes, 4) are those of `uncertainty.perturbed` under which the scans were recorded. From
    :math:`e_y = (C+C^\delta)x - v + d - C\hat x\approx 0` follows :math:`C(\hat x - x) = -v + d + C^\delta x`.
    """
    errors = require_array("errors", errors, shape=(len(records.states), len(scan.nominal.frequencies), 4))
    estimates = require_array("estimates", estimates, shape=records.states.shape)
    window = scan.setpoint.scanning
    true, told = (each[:, ::2, window] for each in (records.states, estimates))  # positions
    model = scan.shapes[window].T
    shapes = model * (1 + errors[:, :, 3])[:, :, None]
    measured = records.y[:, 0, window]
    noise = measured - np.sum(shapes * true, axis=1)
    deformation = np.sum((shapes * true)[:, 1:], axis=1)
    seen = noise + np.sum((shapes - model) * true, axis=1)

    return OutputErrors(
        rms(noise),
        rms(measured - np.sum(model * told, axis=1)),
        rms(deformation),
        rms(deformation - np.sum((model * told)[:, 1:], axis=1)),
        rms(true - told),
        rms(model / np.sum(model**2, axis=0) * seen[:, None]),
    )


def sample_output_errors(
    contest: Contest, plants: int, seed: int, size: float, law: str, rigid: bool
) -> OutputErrors:
    """Output errors of the Kalman filter on randomly perturbed plants, see `uncertainty.sample_errors`."""
    rng, scan = np.random.default_rng(seed), contest.scan
    errors = np.array([sample_errors(rng, scan.nominal, size, law, rigid) for _ in range(plants)])
    records = record_scans(scan, list(errors), rng)
    return output_errors(scan, errors, records, run_entrant("Kalman", contest, 1.0, records))
