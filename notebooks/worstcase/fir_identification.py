"""FIR identification with a noisy input: what this notebook alone needs."""

from functools import cache

import numpy as np
from scipy import signal, special

from stillwork.estimation.min_max import min_max_solve
from stillwork.estimation.recursive import track, worst_case_residuals
from stillwork.identification.regressors import fir_regressors
from workbook import figures
from workbook.studies import Study, mean_interval, run_study


def fir_trial(
    rng: np.random.Generator,
    parameters: tuple[float, ...],
    period: int,
    samples: int,
    input_noise: float,
    output_noise: float,
    law: str = "uniform",
    update: str = "exact",
) -> dict[str, np.ndarray]:
    """One realisation of Fig. 1: square wave into an FIR filter, input and output measured with bounded noise.

    The `law` of both noises is ``uniform`` or ``cut Gaussian``, `update` ``exact`` or ``approximate``, algorithm (20).

    ``min_max``, ``total``, ``least`` (unknowns x samples): estimates from all rows up to t, NaN before
    there are more rows than unknowns. ``min_max_worst``, ``total_worst``, ``least_worst``: worst-case
    residuals |A x - b| + eta |x|. ``total_target``: norm of the correction of b. ``total_matrix``: norm
    of the correction of A. ``perturbation``: norm of the true perturbation. ``bound``: eta_t.
    """
    noises = {"input_noise": input_noise, "output_noise": output_noise, "law": law}
    regressors, outputs, errors = fir_record(rng, parameters, period, samples, **noises)
    taps = len(regressors)
    bounds = np.sqrt(taps) * input_noise * np.sqrt(np.arange(1.0, samples + 1))
    settings = {"bound": bounds, "iterations": int(update == "approximate"), "silent": True}
    found = {"min_max": track(regressors, outputs, **settings).estimates}
    found["least"], found["total"], correction = _growing_windows(regressors, outputs)
    found |= {
        f"{name}_worst": worst_case_residuals(regressors, outputs, values, bounds, 1.0)
        for name, values in found.items()
    }
    found = {name: np.where(np.arange(samples) < taps, np.nan, values) for name, values in found.items()}
    length = np.linalg.norm(found["total"], axis=0)
    found["total_matrix"] = correction * length / np.hypot(1, length)
    found["total_target"] = correction / np.hypot(1, length)
    outer = np.cumsum(errors[:, None] * errors[None], axis=2)
    found["perturbation"] = np.sqrt(np.linalg.eigvalsh(np.moveaxis(outer, 2, 0))[:, -1])
    found["bound"] = bounds
    return found


def fir_record(rng, parameters, period, samples, input_noise, output_noise, law="uniform"):
    """Measured regressors, outputs, and the errors of the regressors."""
    parameters = np.asarray(parameters, float)
    taps = len(parameters)
    clean = signal.square(2 * np.pi * (np.arange(samples + taps - 1) + 0.5) / period)
    error = sample_bounded(rng, law, input_noise, len(clean))
    full = slice(taps - 1, None)  # every row holds measured samples only
    outputs = parameters @ fir_regressors(clean, taps)[:, full]
    outputs += sample_bounded(rng, law, output_noise, samples)
    errors = fir_regressors(error, taps)[:, full]
    return fir_regressors(clean, taps)[:, full] + errors, outputs, errors


def sample_bounded(rng: np.random.Generator, law: str, bound: float, count: int) -> np.ndarray:
    """Independent noise within +-`bound`, ``uniform`` or ``cut Gaussian``; it is cut at two standard deviations."""
    if law == "uniform":
        return rng.uniform(-bound, bound, count)
    tail = special.ndtr(-2.0)
    return bound / 2 * special.ndtri(rng.uniform(tail, 1 - tail, count))


def _growing_windows(regressors, outputs):
    # least squares and total least squares of rows 0..t for all t, from sums of products: (A'A) x = A'b, and
    # the eigenvector of the smallest eigenvalue of [A b]'[A b]
    stacked = np.vstack([regressors, outputs])
    products = np.moveaxis(np.cumsum(stacked[:, None] * stacked[None], axis=2), 2, 0)
    unknowns = len(regressors)
    values, vectors = np.linalg.eigh(products)
    smallest = vectors[:, :, 0]
    least, total = np.zeros((2, *regressors.shape))
    late = products[unknowns:]  # from there on A has more rows than columns
    information, correlation = late[:, :unknowns, :unknowns], late[:, :unknowns, unknowns:]
    least[:, unknowns:] = np.linalg.solve(information, correlation)[..., 0].T
    total[:, unknowns:] = -(smallest[unknowns:, :unknowns] / smallest[unknowns:, unknowns:]).T
    return least, total, np.sqrt(np.maximum(values[:, 0], 0))


def gain_trial(
    rng: np.random.Generator,
    parameters: tuple[float, ...],
    period: int,
    samples: int,
    gain: float,
    output_noise: float,
) -> dict[str, float]:
    """One record whose true input is `gain` times the measured one: a perturbation that is the same at every instant.

    Distances from the true parameters: of ``min_max``, given the norm of that perturbation, and of ``least`` squares.
    """
    regressors, outputs, _ = fir_record(rng, gain * np.array(parameters), period, samples, 0.0, output_noise)
    bound = abs(gain - 1) * np.linalg.norm(regressors, 2)
    estimates = {
        "min_max": min_max_solve(regressors.T, outputs, bound).estimate,
        "least": np.linalg.lstsq(regressors.T, outputs)[0],
    }
    return {name: float(np.linalg.norm(estimate - parameters)) for name, estimate in estimates.items()}


def criterion_trial(
    rng: np.random.Generator, shares: tuple[float, ...], parameters: tuple[float, ...], **record
) -> dict[str, np.ndarray]:
    """``saved``: by how much the smallest worst-case residual is below that of least squares, as a share of it.

    The bound is each of `shares` of the one at which the estimate becomes zero; `record` as of `fir_trial`.
    """
    regressors, outputs, _ = fir_record(rng, parameters, **record)
    matrix = regressors.T
    least = np.linalg.lstsq(matrix, outputs)[0]
    residual, length = np.linalg.norm(matrix @ least - outputs), np.linalg.norm(least)
    bounds = np.array(shares) * np.linalg.norm(matrix.T @ outputs) / np.linalg.norm(outputs)
    worst = [min_max_solve(matrix, outputs, bound).worst_case_residual for bound in bounds]
    return {"saved": 1 - np.array(worst) / (residual + bounds * length)}


def least_squares_limit(parameters: tuple[float, float], period: int, input_noise: float) -> np.ndarray:
    """What least squares tends to in Fig. 1's setting: (R + s I)^-1 R x.

    R is the input's covariance, for two taps of a square wave of amplitude 1 with an even `period`; s the
    variance of the uniform input noise, input_noise^2 / 3.
    """
    parameters = np.asarray(parameters, float)
    neighbour = 1 - 4 / period
    covariance = np.array([[1, neighbour], [neighbour, 1]])
    return np.linalg.solve(covariance + input_noise**2 / 3 * np.eye(2), covariance @ parameters)


# === Identification pictures ======================================================================================
# Pictures of FIR identification with noisy inputs (Fig. 1) and of what happens as the record grows.


METHODS = (
    ("min_max", "min-max", figures.BLUE, "-"),
    ("total", "total least squares", figures.RED, "--"),
    ("least", "least squares (not in the paper)", figures.BLACK, "-"),
)


def paint_fig_1(study: Study, parameters: tuple[float, ...]):
    """Estimates averaged over the realisations (a), (b) and residuals (c), drawn as in Fig. 1."""
    figure, (*panels, third) = figures.new(3, 1, height=7.2, sharex=True)
    time = _paint_estimates(panels, study, parameters)
    figures.legend_below(panels[0], 4)
    third.plot(time, study["min_max_worst"].mean(0), color=figures.BLUE, label="min-max: worst case")
    third.plot(time, study["total_target"].mean(0), "--", color=figures.RED, label="TLS: |(A + δA)x − b|")
    style = {"color": figures.RED, "label": "TLS: worst case under the same bound, median"}
    third.plot(time, np.median(study["total_worst"], 0), ":", **style)
    third.set(ylabel="residual", xlabel="time (samples)", title="(c)")
    third.set(ylim=(0, 1.5 * study["min_max_worst"].mean(0)[-1]))
    third.legend(ncols=2)
    return figure


def _paint_estimates(panels, study: Study, parameters: tuple[float, ...]) -> np.ndarray:
    time = np.arange(1, study["bound"].shape[1] + 1)
    for number, (axes, truth) in enumerate(zip(panels, parameters, strict=True)):
        for name, label, colour, style in METHODS:
            axes.plot(time, study[name][:, number].mean(0), style, color=colour, label=label)
        axes.axhline(truth, color=figures.GREY, linewidth=2.5, alpha=0.5, zorder=1, label="true value")
        axes.set(ylabel=f"estimate of x{number + 1}", title=f"({'ab'[number]})")
        _frame(axes, study, number, truth)
    return time


def _frame(axes, study: Study, number: int, truth: float):
    # The first samples of total least squares run off any scale.
    reach = max(0.8, 1.3 * np.abs(study["min_max"][:, number].mean(0)[10:] - truth).max())
    axes.set(ylim=(truth - reach, truth + reach))


def paint_corrections(study: Study):
    """Norm of the perturbation that TLS assumes, beside the true one and its bound."""
    figure, axes = figures.new(height=3.0)
    time = np.arange(1, study["bound"].shape[1] + 1)
    axes.plot(time, study["total_matrix"].mean(0), "--", color=figures.RED, label="correction assumed by TLS")
    axes.plot(time, study["bound"][0], color=figures.BLUE, label="bound √(2t) × largest input noise")
    axes.plot(time, study["perturbation"].mean(0), color=figures.GREY, label="true perturbation")
    axes.set(xlabel="time (samples)", ylabel="2-norm of the perturbation of A")
    axes.legend()
    return figure


def error_norms(study: Study, parameters: tuple[float, ...], group: int = 1) -> dict[str, np.ndarray]:
    """|x - estimate| of the averages over groups of realisations, shape (groups, samples), by method."""
    truth, groups = np.asarray(parameters, float)[:, None], study.runs // group
    found = {name: study[name][: groups * group] for name, *_ in METHODS}
    means = {name: v.reshape(groups, group, *v.shape[1:]).mean(axis=1) for name, v in found.items()}
    return {name: np.linalg.norm(mean - truth, axis=1) for name, mean in means.items()}


def paint_long(study: Study, parameters: tuple[float, ...], least_limit: np.ndarray):
    """Median error over realisations as the record grows, and the limit of least squares."""
    figure, axes = figures.new(height=3.2)
    for name, label, colour, style in METHODS:
        values = np.median(error_norms(study, parameters)[name], axis=0)
        time = np.unique(np.geomspace(len(parameters) + 2, len(values), 150).astype(int))
        axes.loglog(time, values[time - 1], style, color=colour, label=label)
    limit = np.linalg.norm(least_limit - np.asarray(parameters))
    axes.axhline(limit, color=figures.BLACK, linestyle=":", linewidth=1, label="limit of least squares")
    axes.set(xlabel="time (samples)", ylabel="median |x − estimate|")
    axes.legend()
    return figure


def win_shares(
    cases: list[tuple[tuple[float, ...], int]],
    runs: int,
    group: int,
    seed: int,
    samples: int,
    first: int,
    **noise: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Share of experiments that min-max wins against TLS and against least squares, by (parameters, period).

    An experiment averages `group` realisations; it is won when the time average of |x - average estimate|
    from sample `first` on is smaller.
    """
    shares = []
    for parameters, period in cases:
        record = {"parameters": parameters, "period": period, "samples": samples, **noise}
        study = run_study(fir_trial, runs, seed, progress=False, **record)
        errors = {name: e[:, first:].mean(1) for name, e in error_norms(study, parameters, group).items()}
        shares.append([np.mean(errors["min_max"] < errors[other]) for other in ("total", "least")])
    return tuple(np.array(shares).T)


def explore_fig_1(period: int, input_noise: float, output_noise: float, second: float):
    """Estimates of Fig. 1 with other unpublished choices: period, noise amplitudes, second parameter."""
    study = _explored(period, input_noise, output_noise, second)
    figure, panels = _explorer_figure()
    for number, (axes, truth) in enumerate(zip(panels, (1.0, second), strict=True)):
        *lines, true = axes.lines
        for line, (name, *_) in zip(lines, METHODS, strict=True):
            line.set_ydata(study[name][:, number].mean(0))
        true.set_ydata([truth, truth])
        _frame(axes, study, number, truth)
    return figure


def _explored(period: int, input_noise: float, output_noise: float, second: float) -> Study:
    record = {"parameters": (1.0, second), "period": int(period), "samples": 200}
    noises = {"input_noise": input_noise, "output_noise": output_noise}
    return run_study(fir_trial, 10, 1, progress=False, **record, **noises)


@cache
def _explorer_figure():
    """Figure and panels of the explorer, kept for its next move: only their data change."""
    figure, panels = figures.new(1, 2, height=3.2)
    _paint_estimates(panels, _explored(20, 0.1, 1.0, 0.5), (1.0, 0.5))
    figures.label(panels, "time (samples)")
    figures.legend_below(panels[0], 4)
    return figure, panels


# --- Section 9: Fig. 1 --------------------------------------------------------------------------------------------

AVERAGED = 10  # realisations behind a curve of Fig. 1
EXPERIMENTS = 10  # of that many realisations; the notebook has 50
COMPARED = 20  # records at each ratio of the noises; the notebook has 100
INPUT_NOISE, OUTPUT_NOISE = 0.1, 1.0  # section 9
COMPETITORS = "min_max", "total", "least"


def identification(
    *,
    fig_1_parameters: str,
    square_wave_period: int,
    fig_1_length: int,
    noise_law: str,
    min_max_update: str,
    fig_1_error: str,
    fig_1_from: int,
    seed: int,
    lean: bool,
) -> dict[str, float]:
    """Fig. 1; the fast variant makes 10 experiments of 10 realisations instead of 50, and 20 records a ratio."""
    truth = tuple(float(each) for each in fig_1_parameters.split(","))
    settings = {"parameters": truth, "period": square_wave_period, "samples": fig_1_length}
    settings |= {"input_noise": INPUT_NOISE, "law": noise_law, "update": min_max_update}
    experiments, compared = (EXPERIMENTS, COMPARED) if lean else (50, 100)
    many, three, one = (
        run_study(fir_trial, runs, seed, progress=False, output_noise=ratio * INPUT_NOISE, **settings)
        for runs, ratio in (
            (AVERAGED * experiments, OUTPUT_NOISE / INPUT_NOISE),
            (compared, 3.0),
            (compared, 1.0),
        )
    )
    errors = {m: _parameter_errors(many[m], truth, fig_1_error) for m in COMPETITORS}
    error = {name: each[..., fig_1_from:].mean(-1) for name, each in errors.items()}
    wins = error["min_max"] < error["total"]
    growth = [(each["total_matrix"] / each["bound"])[:compared, -1] for each in (one, three, many)]
    found = {
        "fig-1a": wins[:, 0].mean(),
        "fig-1b": wins[:, 1].mean(),
        "fig-1c": correction_share(many, fig_1_from),
        "row-bound": np.mean((many["perturbation"] <= many["bound"]).all(axis=1)),
        "much-greater": np.mean(np.diff(growth, axis=0) > 0),
        "least-squares": (error["min_max"] < error["least"]).all(1).mean(),
        "least-squares-both": (error["least"] < error["min_max"]).all(1).mean(),
        "square-error": np.median(
            (many["total_target"][:, -1] ** 2 / many["min_max_worst"][:, -1])[:AVERAGED]
        ),
    }
    return {f"worstcase.identification.{name}": value for name, value in found.items()}


def correction_share(many: Study, first: int) -> tuple[float, tuple[float, float]]:
    """Share of the instants from sample `first` on at which TLS corrects A by more than the bound, and its interval over records."""
    shares = (many["total_matrix"] > many["bound"])[:, first - 1 :].mean(axis=1)
    return float(shares.mean()), tuple(np.clip(mean_interval(shares), 0.0, 1.0))


def _parameter_errors(estimates: np.ndarray, truth: tuple[float, ...], error: str) -> np.ndarray:
    """Of each experiment, (experiments, unknowns, samples): of the mean estimate, or the mean of the errors."""
    groups = estimates.reshape(-1, AVERAGED, *estimates.shape[1:]) - np.array(truth)[:, None]
    return np.abs(groups.mean(axis=1)) if error == "of the average" else np.abs(groups).mean(axis=1)


# === Notebook 04 ====================================================================================================

# Other parameters and periods of the square wave.
OTHER_CASES = [((1.0, 0.5), 4), ((1.0, -0.5), 20), ((0.5, 1.0), 8), ((2.0, 1.0), 20), ((0.3, 0.1), 20)]


def noise_ratios(
    ratios: tuple[float, ...],
    input_noise: float,
    truth: tuple[float, float],
    period: int,
    samples: int,
    realisations: int,
    first: int,
    seed: int,
) -> tuple[list[np.ndarray], list[float]]:
    """TLS's last correction over the bound, and how often min-max beats it, for output noises over the input's."""
    corrections, won = [], []
    for ratio in ratios:
        noises = {"input_noise": input_noise, "output_noise": ratio * input_noise}
        each = run_study(
            fir_trial, 100, seed, parameters=truth, samples=samples, period=period, progress=False, **noises
        )
        corrections.append((each["total_matrix"] / each["bound"])[:, -1])
        won.append(win_shares([(truth, period)], 200, realisations, seed, samples, first, **noises)[0][0])
    return corrections, won


def saved_and_nearer(
    cases, shares, gains, samples: int, input_noise: float, output_noise: float, runs: int, seed: int
) -> tuple[list[np.ndarray], dict[float, list[np.ndarray]]]:
    """By case: what min-max saves of the worst case at shares of the threshold; in which runs it is nearer, by gain."""
    nearer, medians = {gain: [] for gain in gains}, []
    for parameters, period in cases:
        record = {
            "parameters": parameters,
            "period": period,
            "samples": samples,
            "output_noise": output_noise,
        }
        how = {"progress": False, **record}
        noisy = run_study(criterion_trial, runs, seed, shares=shares, input_noise=input_noise, **how)
        medians.append(np.median(noisy["saved"], axis=0))
        for gain in gains:
            distance = run_study(gain_trial, runs, seed, gain=gain, **how)
            nearer[gain].append(distance["min_max"] < distance["least"])
    return medians, nearer


def appendix(
    page,
    *,
    study: Study,
    ratios: tuple[float, ...],
    corrections: list[np.ndarray],
    won: list[float],
    medians: list[np.ndarray],
    nearer: dict[float, list[np.ndarray]],
    cases: list[tuple[tuple[float, ...], int]],
    how: dict[str, float],
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    study : Study
        Of `fir_trial`, the runs of Fig. 1.
    ratios, corrections, won
        Of `noise_ratios`.
    medians, nearer
        Of `saved_and_nearer`.
    cases : list
        Parameters and period.
    how : dict
        Of `win_shares`.
    """
    page.text("""## "Much greater than the input noise"

The paper says: "especially when the measurement noise is much greater than the input noise". We try an output noise of one, three
and ten times the input noise. Panel (c) is labelled "square error" but shows the norm; the square lies below the worst case of
min-max (`square-error`).""")
    for ratio, correction, share in zip(ratios, corrections, won, strict=True):
        page.show(
            f"output over input noise {ratio:4.1f}: correction over bound {np.median(correction):.2f} (median), "
            f"min-max beats TLS in {share:.2f} of the experiments"
        )
    page.check("worstcase.identification.much-greater", np.mean(np.diff(corrections, axis=0) > 0))
    page.check("worstcase.identification.wins-at-one", won[0])
    page.check("worstcase.identification.wins-at-ten", won[-1])
    square = study["total_target"][:, -1] ** 2 / study["min_max_worst"][:, -1]
    page.check("worstcase.identification.square-error", np.median(square))
    page.text(
        "## The unpublished choices\n\nMin-max wins against TLS and against least squares | saved of the worst case at 0.1 .. 0.9 of the "
        "threshold | nearer to the truth at a gain of 0.8 .. 1.2:"
    )
    shares = np.transpose(win_shares(cases, 200, **how))
    for number, (parameters, each) in enumerate(cases):
        saved = " ".join(f"{value:5.1%}" for value in medians[number])
        near = " ".join(f"{runs[number].mean():.2f}" for runs in nearer.values())
        wins = " ".join(f"{value:.2f}" for value in shares[number])
        page.show(f"{parameters!s:12} period {each:3d}: {wins} | {saved} | {near}")
