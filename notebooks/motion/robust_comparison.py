"""Robust observers on an uncertain stage: what this notebook alone needs."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64
from numpy.typing import ArrayLike

from experiments.motion.intervals import Values, central, key, share
from experiments.motion.perturbed_tracking import CASES, published_blocks, tracking_trial
from experiments.motion.scan_study import (
    Errors,
    Records,
    Scan,
    filter_model,
    judge,
    published_scan,
    record_scans,
    rms,
)
from experiments.motion.uncertainty import detuned, norm_bound, sample_errors, sampled_derivatives
from stillwork.base.algebra import (
    add_product,
    condition,
    copy_vector,
    measure,
    minus_row,
    multiply,
    set_product,
)
from stillwork.base.checks import InputError, require_array, require_choice, require_count, require_finite_run
from stillwork.base.kernels import kernel, pasted_kernel
from stillwork.base.validation import checked
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.robust import (
    Derivatives,
    NormBound,
    bound_rows,
    joint_covariance,
    kalman_gains,
    lower_limit,
    principal,
    regularised_gains,
    robust_step,
    sample_at,
    sensitivity_gains,
    step_data,
)
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel, estimate
from stillwork.lti.discretisation import zoh_modes
from workbook import figures
from workbook.studies import run_study

# === Contest ======================================================================================================
# Observers side by side on the same scans, each with one knob, tuned alike; what section 5.4.3 says of Fig. 5.10.


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


# === Line search ==================================================================================================
# The regularised filter with the best lambda at every sample: the exact solution of the min-max problem (5.15).


@dataclass(frozen=True)
class LineSearch:
    """Estimates of the regularised filter that solves for lambda at every sample."""

    states: Float64[np.ndarray, "states samples"]
    # optimal lambda over its lower limit; 1 where nothing is uncertain
    ratio: Float64[np.ndarray, " samples"]


@checked
def regularised_line_search(
    model: TimeVaryingModel, bound: NormBound, u: ArrayLike, y: ArrayLike, initial: ArrayLike | None = None
) -> LineSearch:
    r"""Regularised least-squares filter with the optimal :math:`\hat\lambda = \arg\min G(\lambda)` at every sample.

    :math:`G` is the minimum over (x, w) of the cost above; the optimum depends on the data, so there are no
    gains beforehand. It is the exact solution of the min-max problem (5.15) at every step.
    """
    rows, m = bound_rows(model, bound)
    samples, outputs, states = model.c.shape
    u = require_array("u", u, shape=(model.b.shape[2], samples))
    y = require_array("y", y, shape=(outputs, samples))
    initial = np.zeros(states) if initial is None else require_array("initial", initial, shape=(states,))
    turn, spread = principal(model, m)
    turned = np.einsum("koi,ik->ko", turn, y)
    out, ratio = np.zeros((samples, states)), np.ones(samples)
    out[0] = initial
    limit, start = lower_limit(model, rows, m), model.initial_covariance.copy()
    data = step_data(model, rows, turn)
    _search_filter(data, limit, spread, np.ascontiguousarray(u.T), turned, start, out, ratio)
    require_finite_run("the estimate", out, "rescale the model or the record")
    return LineSearch(np.ascontiguousarray(out.T), ratio)


@pasted_kernel
def _noise(limit, spread, over):
    """Variance 1 - spread / lambda of an output for lambda = limit (1 + over), without cancellation close to the limit."""
    return ((limit - spread) / limit + over) / (1 + over)


@kernel
def _pose(sample, u, y, sight, told):
    # The penalty's rows and the outputs as measurements `told` of the last state and the disturbance.
    step, b, c, rows, rows_u = sample
    multiply(c, step, sight[len(rows) :])
    for i in range(len(rows)):
        copy_vector(rows[i], sight[i])
        told[i] = minus_row(0.0, rows_u, i, u)
    for o in range(len(c)):
        known = y[o]
        for q in range(len(b)):
            for j in range(len(u)):
                known -= c[o, q] * b[q, j] * u[j]
        told[len(rows) + o] = known


@kernel
def _cost(logarithm, limit, spread, sight, told, p0, x):
    # G(lambda): the sum of squared innovations, each over its variance, is the minimum of the cost.
    over, size, rows = np.exp(logarithm), sight.shape[1], len(told) - len(spread)
    sigma, z, v = joint_covariance(p0, size - len(x)), np.zeros(size), np.zeros(size)
    copy_vector(x, z)
    cost = 0.0
    for i in range(len(told)):
        noise = 1 / (limit * (1 + over)) if i < rows else _noise(limit, spread[i - rows], over)
        s = measure(sigma, sight, i, noise, v)
        innovation = minus_row(told[i], sight, i, z)
        for j in range(size):
            z[j] += v[j] / s * innovation
        condition(sigma, v, s)
        cost += innovation * innovation / s
    return cost


@kernel
def _search_filter(data, limit, spread, u, y, p0, out, ratio):
    (samples, n), nu, no = out.shape, u.shape[1], y.shape[1]
    forward, onward, gain = np.zeros((n, n)), np.zeros((n, nu)), np.zeros((n, no))
    p, noise, innovation = np.zeros((n, n)), np.ones(no), np.empty(no)
    measurements = data[3].shape[1] + no
    sight, told = np.empty((measurements, data[0].shape[2])), np.empty(measurements)
    shrink = (np.sqrt(5.0) - 1) / 2
    for k in range(1, samples):
        sample, penalty = sample_at(data, k), 0.0
        noise[:] = 1.0
        if limit[k] > 0:
            _pose(sample, u[k - 1], y[k], sight, told)
            posed = (limit[k], spread[k], sight, told, p0, out[k - 1])
            low, high = -18.0, 40.0  # of log(lambda / limit - 1); G has one minimum
            left, right = high - shrink * (high - low), low + shrink * (high - low)
            at_left, at_right = _cost(left, *posed), _cost(right, *posed)
            while high - low > 1e-7:
                if at_left <= at_right:
                    high, right, at_right = right, left, at_left
                    left = high - shrink * (high - low)
                    at_left = _cost(left, *posed)
                else:
                    low, left, at_left = left, right, at_right
                    right = low + shrink * (high - low)
                    at_right = _cost(right, *posed)
            over = np.exp((low + high) / 2)
            ratio[k] = 1 + over
            penalty = limit[k] * (1 + over)
            for o in range(no):
                noise[o] = _noise(limit[k], spread[k, o], over)
        robust_step(sample, penalty, noise, p0, forward, onward, gain, p)
        set_product(forward, out[k - 1], out[k])
        add_product(onward, u[k - 1], out[k])
        for o in range(no):
            innovation[o] = minus_row(y[k, o], sample[2], o, out[k])
        add_product(gain, innovation, out[k])
        p0, p = p, p0


# === Robust pictures ==============================================================================================
# Figures of the robust-observer comparison.


STATES = [
    (mode, *error)
    for mode in ("rigid body", "first flexible mode", "second flexible mode")
    for error in (("position error (nm √kg)", 1e9), ("velocity error (µm/s √kg)", 1e6))
]
SAID = {  # of Fig. 5.10, what hangs on the weight, by claim
    "sensitivity-rigid-as-kalman": "penalised filter's rigid body as Kalman's",
    "regularised-worst-on-flexible": "regularised filter worst on flexible states",
    "sensitivity-drift": "penalised filter drifts more than Kalman's",
    "sensitivity-end-above-state": "penalised filter's error at the end above the state",
}
PUBLISHED = ("Kalman", "sensitivity penalised", "regularised least squares")
COLOURS = dict(zip(ENTRANTS, (figures.RED, figures.BLUE, figures.GREEN), strict=False))


def paint_state_errors(scan: Scan, truth: np.ndarray, estimates: Mapping[str, np.ndarray]):
    """Estimation errors of one run over time, one panel a state, on a symmetric logarithmic axis (Fig. 5.10)."""
    from matplotlib.ticker import FixedLocator

    figure, axes = figures.new(3, 2, sharex=True)
    time = scan.setpoint.time
    for k, axis in enumerate(axes.ravel()):
        mode, unit, factor = STATES[k]
        if k >= 2:
            axis.plot(time, truth[k] * factor, color=figures.GREY, linewidth=0.8, label="true state")
        for name, found in estimates.items():
            error = (truth[k] - found[k]) * factor
            axis.plot(time, error, label=name, color=COLOURS.get(name), linewidth=0.9)
        axis.set_yscale("symlog", linthresh=10.0)
        axis.yaxis.set_major_locator(FixedLocator([-1e9, -1e6, -1e3, 0.0, 1e3, 1e6, 1e9]))
        for edge in scan.setpoint.scan:
            axis.axvline(edge, color=figures.BLACK, linewidth=0.8)
        axis.set(title=mode, ylabel=unit)
    figures.label(axes, "time (s)")
    figures.legend_below(axes[1, 0], 4)
    return figure


def paint_statements(
    weights: np.ndarray,
    sweep: Sequence[Errors],
    kalman: Errors,
    regularised: Errors,
    shares: Mapping[str, np.ndarray],
    chosen: float,
):
    """Errors of the sensitivity-penalised filter over its weight, and the share of plants on which statements hold."""
    figure, (sizes, held) = figures.new(2, 1, height=4.6, sharex=True)
    rigid = [np.median(each.rms[:, 0] / kalman.rms[:, 0]) for each in sweep]
    sizes.loglog(weights, rigid, color=figures.BLACK, label="rigid body, over the Kalman filter's")
    flexible = [np.median(each.flexible()) for each in sweep]
    style = {"color": COLOURS["sensitivity penalised"], "label": "flexible states, over their size"}
    sizes.loglog(weights, flexible, **style)
    for name, each in (("regularised least squares", regularised), ("Kalman", kalman)):
        level = np.median(each.flexible())
        sizes.axhline(level, color=COLOURS[name], ls="--", linewidth=0.9, label=f"the same, {name}")
    sizes.set_ylabel("error (1, median)")
    sizes.legend(fontsize=7)
    for k, (claim, part) in enumerate(shares.items()):  # thinner and thinner: lines at 1 lie on each other
        held.semilogx(weights, part, linewidth=5 - 1.3 * k, label=SAID[claim])
    held.set(ylabel="share of the plants", xlabel="weight $\\gamma$")
    figures.legend_below(held, 2, fontsize=7)
    for axis in (sizes, held):
        axis.axvline(chosen, color=figures.BLACK, linewidth=0.8)
    return figure


def spreads(
    axis, rows: Sequence[str], samples: Sequence[np.ndarray], colour: str, label: str, offset: float = 0.0
):
    """Median and central 95 % of runs as a dot on a bar, one row each."""
    places = np.arange(len(rows)) + offset
    low, middle, high = (np.array([np.quantile(s, q) for s in samples]) for q in (0.025, 0.5, 0.975))
    ends = [middle - low, high - middle]
    axis.errorbar(middle, places, xerr=ends, fmt="o", color=colour, capsize=3, markersize=4, label=label)
    axis.set_yticks(np.arange(len(rows)), rows)


@lru_cache(maxsize=8)
def _contest(size_percent: float) -> tuple[Scan, Contest, Records]:
    """Scan, entrants and records for one size of the errors; they stay while the weight alone moves."""
    scan = published_scan()
    contest = prepare(scan, size_percent / 100, rigid=False)
    return scan, contest, sample_scans(scan, 6, 1, size_percent / 100, "ends", False)


def paint_weight(weight_exponent: float, size_percent: float):
    """Explorer: scan-phase errors of the published three as gamma and the size of the errors move."""
    scan, contest, records = _contest(size_percent)
    knobs = {"Kalman": 1.0, "sensitivity penalised": 10.0**weight_exponent}
    knobs["regularised least squares"] = size_percent / 100
    figure, axes = figures.new(1, 2, height=2.8, sharex=True)
    window = scan.setpoint.scanning
    for name, knob in knobs.items():
        error = records.states[0] - run_entrant(name, contest, knob, records)[0]
        for axis, state in zip(axes, (2, 4), strict=True):
            axis.plot(scan.setpoint.time[window], 1e9 * error[state, window], label=name, color=COLOURS[name])
            axis.set(title=STATES[state][0], xlabel="time (s)")
    axes[0].set_ylabel("estimation error (nm √kg)")
    axes[0].legend()
    return figure


# --- Section 5.4.3: Fig. 5.10 and Table 5.2 ----------------------------------------------------------------------

PLANTS, LEAN_PLANTS = 100, 40  # perturbed plants; of the notebook and of the lean form of Table 5.2


def estimation(
    *,
    penalty_weight: float,
    error_law: str,
    rigid_body_errs: bool,
    estimation_sample_time: float,
    seed: int,
    lean: bool,
) -> Values:
    """Statements about Fig. 5.10, as fractions of 100 plants; it has no leaner form."""
    scan = published_scan(sample_time=estimation_sample_time)
    contest = prepare(scan, 0.05, rigid_body_errs)
    records = sample_scans(scan, PLANTS, seed, 0.05, error_law, rigid_body_errs)
    knobs = {"Kalman": 1.0, "sensitivity penalised": penalty_weight, "regularised least squares": 0.05}
    errors = [judge(scan, records, run_entrant(name, contest, knob, records)) for name, knob in knobs.items()]
    said = figure_statements(*errors)
    kalman, penalised, _ = errors
    ratio, bias = penalised.rms[:, 0] / kalman.rms[:, 0], kalman.bias[:, 2] / kalman.rms[:, 2]
    found: Values = {f"motion.fig-5-10.{claim}": share(holds) for claim, holds in said.items()}
    return found | {
        "motion.fig-5-10.sensitivity-rigid-as-kalman": central(ratio),
        "motion.fig-5-10.kalman-unbiased": central(bias),
    }


def perturbed_scans(
    *,
    error_law: str,
    rigid_body_errs: bool,
    perturbed_feedforward: str,
    perturbed_sample_time: float,
    seed: int,
    lean: bool,
) -> Values:
    """The perturbed values of Table 5.2 and what is said of them; the lean form draws 40 plants instead of 100."""
    off = run_study(
        tracking_trial,
        LEAN_PLANTS if lean else PLANTS,
        seed,
        blocks=published_blocks(),
        size=0.05,
        law=error_law,
        rigid=rigid_body_errs,
        retune=perturbed_feedforward == "refitted",
        sample_time=perturbed_sample_time,
        progress=False,
    )
    percent = {case: 100 * off[case] / off["none"] for case in CASES if case != "none"}
    found: Values = {
        f"motion.table-5-2.perturbed.{key(case).replace('and-', '')}": central(each)
        for case, each in percent.items()
    }
    better = {case: each < 100 for case, each in percent.items()}
    said = {
        "ad-beats-none": better["AD"] & better["AD, redesigned"],
        "mc-ad-beats-none": better["MC and AD"] & better["MC and AD, redesigned"],
        "mc-ad-beats-ad": percent["MC and AD, redesigned"] < percent["AD, redesigned"],
        "redesign-beats-original": percent["AD, redesigned"] < percent["AD"],
    }
    return found | {f"motion.table-5-2.{claim}": share(holds) for claim, holds in said.items()}
