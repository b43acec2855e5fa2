"""Tracking: min-max against RLS: what this notebook alone needs."""

from functools import lru_cache

import numpy as np

from experiments.worstcase.simulations import FIG_2_PARAMETERS, path
from stillwork.estimation.recursive import track
from stillwork.identification.regressors import exponential_bound, exponential_weights, fir_regressors
from workbook import figures
from workbook.studies import Study, fraction, mean_interval, proportion_interval, run_study, spread_interval


def tracking_record(
    rng: np.random.Generator,
    truth: np.ndarray,
    row_error: float,
    noise: float,
    amplitude: float = 1.0,
    delay_line: bool = False,
    error_law: str = "ball",
) -> tuple[np.ndarray, np.ndarray]:
    """Regressors as measured (unknowns, samples) and outputs of a trial of Fig. 2; arguments as of `tracking_trial`."""
    unknowns, samples = truth.shape
    if delay_line:
        regressors = fir_regressors(rng.standard_normal(samples + unknowns - 1), unknowns)[:, unknowns - 1 :]
    else:
        regressors = rng.standard_normal((unknowns, samples))
    regressors *= amplitude
    directions = rng.standard_normal((unknowns, samples))
    radius = row_error * rng.random(samples) ** (1 / unknowns)
    if error_law != "ball":
        radius[:] = row_error
    if error_law == "one direction":
        directions[:] = directions[:, :1]
    errors = directions * (radius / np.linalg.norm(directions, axis=0))
    outputs = np.sum((regressors + errors) * truth, axis=0) + noise * rng.standard_normal(samples)
    return regressors, outputs


def forgetting_trial(
    rng: np.random.Generator, truth: np.ndarray, forgetting: float, row_error: float, noise: float
) -> dict[str, float]:
    """RMS error norm over the second half of a trial of Fig. 2, with forgetting and without.

    ``min_max``, ``least``: with `forgetting`; ``min_max_kept``, ``least_kept``: all rows count alike.
    """
    rows, outputs = tracking_record(rng, truth, row_error, noise)
    growing = row_error * np.sqrt(np.arange(1.0, len(outputs) + 1))
    settings = {
        "min_max": {"forgetting": forgetting, "bound": exponential_bound(row_error, forgetting)},
        "min_max_kept": {"bound": growing},
        "least": {"forgetting": forgetting, "initial_covariance": 1e4},
        "least_kept": {"initial_covariance": 1e4},
    }
    late = slice(truth.shape[1] // 2, None)
    tracks = {name: track(rows, outputs, **each, silent=True).estimates for name, each in settings.items()}
    return {
        name: float(np.sqrt(np.mean(np.sum((found - truth)[:, late] ** 2, axis=0))))
        for name, found in tracks.items()
    }


def tracking_trial(
    rng: np.random.Generator,
    truth: np.ndarray,
    bound: float,
    forgetting: float,
    row_error: float,
    noise: float,
    penalty: float,
    update: str = "exact",
    amplitude: float = 1.0,
    delay_line: bool = False,
    error_law: str = "ball",
) -> dict[str, np.ndarray]:
    """One trial of Fig. 2: white regressors that are off by a bounded error, outputs with Gaussian noise.

    `truth` is from `path`; RLS and ridge, with its constant `penalty`, forget like min-max. The regressors have the
    standard deviation `amplitude`, each row anew or, in a `delay_line`, one sample a row. Their errors are drawn
    uniformly from the ``ball`` of radius `row_error` or its ``sphere``, or have all ``one direction`` and that length.
    ``min_max``, ``rls``, ``ridge``, ``zero``: error norms |x_t - estimate|, shape (samples,); ``norm``: |A|_2 of the
    unweighted regressors, ``weighted_norm`` of the weighted ones at the end; ``vanished``: share of the time with a
    zero estimate.
    """
    unknowns = len(truth)
    regressors, outputs = tracking_record(rng, truth, row_error, noise, amplitude, delay_line, error_law)
    record = regressors, outputs, forgetting
    min_max = track(*record, bound=bound, iterations=int(update == "approximate"), silent=True)
    tracks = {
        "min_max": min_max.estimates,
        "rls": track(*record, initial_covariance=1e4, silent=True).estimates,
        "ridge": track(*record, penalty=penalty).estimates,
        "zero": np.zeros_like(truth),
    }
    found = {name: np.linalg.norm(truth - values, axis=0) for name, values in tracks.items()}
    found["norm"] = np.linalg.norm(regressors, 2)
    weights = exponential_weights(truth.shape[1], forgetting)
    found["weighted_norm"] = np.linalg.norm(regressors * weights, 2)
    found["vanished"] = np.isinf(min_max.alphas[unknowns:]).mean()
    return found


def settled(errors: np.ndarray, forgetting: float, memories: float = 3.0) -> np.ndarray:
    """Root mean square of error norms (..., samples) after so many memory lengths 1 / (1 - forgetting)."""
    start = settled_from(forgetting, memories)
    return np.sqrt(np.mean(np.square(errors[..., start:]), axis=-1))


def settled_from(forgetting: float, memories: float = 3.0) -> int:
    """The sample after so many memory lengths."""
    return int(np.ceil(memories / (1 - forgetting)))


# === Tracking pictures =====================================================================================
METHODS = (
    ("min_max", "min-max", figures.BLUE, "-"),
    ("rls", "RLS", figures.BLACK, "--"),
    ("ridge", "ridge, constant penalty", figures.GREEN, "-"),
    ("zero", "zero estimate", figures.GREY, ":"),
)


def paint_fig_2(studies: dict[str, Study]):
    """Error norms averaged over the trials, with the 95 % interval of the mean; one panel a study."""
    figure, panels = figures.new(len(studies), 1, sharex=True, squeeze=False)
    for axes, (title, study) in zip(panels[:, 0], studies.items(), strict=True):
        time = np.arange(study["rls"].shape[1])
        for name, label, colour, style in METHODS:
            mean = study[name].mean(0)
            axes.plot(time, mean, style, color=colour, linewidth=1.1, label=label)
            if name in ("min_max", "rls"):
                half = 2.02 * study[name].std(0, ddof=1) / np.sqrt(study.runs)  # Student's t, 39 degrees
                look = {"color": colour, "alpha": 0.2, "linewidth": 0, "label": f"{label}, 95 % interval"}
                axes.fill_between(time, mean - half, mean + half, **look)
        top = 2.2 * study["zero"].mean()
        axes.set(ylabel="mean |x − estimate|", title=title, ylim=(0, top))
    figures.legend_below(panels[0, 0], 3)
    panels[-1, 0].set_xlabel("time (samples)")
    return figure


def gains(study: Study, forgetting: float) -> dict[str, tuple[float, tuple[float, float]]]:
    """Mean over trials, with its 95 % interval, of the settled rms error over that of RLS, by method."""
    base = settled(study["rls"], forgetting)
    ratios = {name: settled(study[name], forgetting) / base for name, *_ in METHODS}
    return {name: (float(each.mean()), mean_interval(each)) for name, each in ratios.items()}


def win_map(
    noises: np.ndarray, bounds: np.ndarray, runs: int, seed: int, parameters: tuple[float, ...], forgetting: float,
    samples: int, row_error: float,
) -> np.ndarray:  # fmt: skip
    """Settled rms error of min-max over that of RLS, mean over trials; shape (bounds, noises).

    All cells see the same trials: a cell's neighbours differ by the setting alone.
    """
    settings = {"forgetting": forgetting, "row_error": row_error, "penalty": 1.0, "progress": False}
    settings["truth"] = path("constant", parameters, samples)

    def ratio(bound, noise) -> float:
        study = run_study(tracking_trial, runs, seed, bound=float(bound), noise=float(noise), **settings)
        return np.mean(settled(study["min_max"], forgetting) / settled(study["rls"], forgetting))

    return np.array([[ratio(bound, noise) for noise in noises] for bound in bounds])


def repeated_draws(study: Study, trials: int, late: int, power: int = 1) -> dict[str, np.ndarray]:
    """Draws of so many trials each, from sample `late` on, of `tracking_trial`.

    ``ratio``: rms error of min-max over that of RLS in each draw. ``below``: whether its mean over the trials is the
    smaller, (draws, samples), of the errors or of a `power` of them; ``median``: the same of the medians over the draws.
    """
    errors = {
        name: study[name].reshape(-1, trials, study[name].shape[1])[..., late:] for name in ("min_max", "rls")
    }
    sizes = {name: np.sqrt(np.mean(each**2, axis=(1, 2))) for name, each in errors.items()}
    curves = {name: np.mean(each**power, axis=1) for name, each in errors.items()}
    middle = {name: np.median(each, axis=0) for name, each in curves.items()}
    return {
        "ratio": sizes["min_max"] / sizes["rls"],
        "below": curves["min_max"] < curves["rls"],
        "median": middle["min_max"] < middle["rls"],
    }


def break_even_noises(seeds, bound, trials, truth, forgetting, samples, row_error) -> list[float]:
    """`break_even_noise` at one bound for each of several seeds, and for parameters in another order."""
    about = np.linalg.norm(truth) * np.geomspace(0.5, 4.0, 8)
    plants = [*((seed, truth) for seed in seeds), (seeds[0], truth[::-1])]
    return [
        break_even_noise(
            about,
            np.array([bound]),
            win_map(about, np.array([bound]), trials, seed, plant, forgetting, samples, row_error),
            bound,
        )
        for seed, plant in plants
    ]


def break_even_noise(noises: np.ndarray, bounds: np.ndarray, ratios: np.ndarray, bound: float) -> float:
    """Noise from which min-max is better than RLS, of `win_map` at a bound, by lines between logarithms."""
    logs = np.log(ratios)
    row = np.array([np.interp(np.log(bound), np.log(bounds), column) for column in logs.T])
    last = np.flatnonzero(row > 0)[-1]
    share = row[last] / (row[last] - row[last + 1])
    return float(noises[last] * (noises[last + 1] / noises[last]) ** share)


def paint_win_map(
    noises: np.ndarray, bounds: np.ndarray, ratios: np.ndarray, published: list[tuple[float, float]]
):
    """Map of `win_map`: blue where min-max is better than RLS, red where it is worse."""
    figure, axes = figures.new(height=3.8)
    mesh = axes.pcolormesh(noises, bounds, np.log2(ratios), cmap="RdBu_r", vmin=-2, vmax=2, shading="nearest")
    axes.contour(noises, bounds, np.log2(ratios), levels=[0.0], colors=figures.BLACK, linewidths=1.0)
    axes.plot([], [], color=figures.BLACK, linewidth=1.0, label="equal to RLS")
    figures.mark_published(axes, *zip(*published, strict=True), label="settings of Fig. 2 (noise assumed)")
    axes.set(xscale="log", yscale="log", xlabel="standard deviation of the output noise (unit of b)")
    axes.set(ylabel="bound η (unit of the regressors)")
    bar = figure.colorbar(mesh, ax=axes, label="error over that of RLS", extend="both", ticks=range(-2, 3))
    bar.ax.set_yticklabels(["1/4", "1/2", "1", "2", "4"])
    figures.legend_below(axes, 2)
    return figure


def explore_tracking(bound: float, noise: float, scale: float, kind: str):
    """Fig. 2 with another bound, noise, size of the parameters, or with a jump or a drift, over half its trials: they take long."""
    truth = scale * path(kind, FIG_2_PARAMETERS, 375)
    settings = {"forgetting": 0.95, "row_error": 0.25, "noise": noise, "penalty": PENALTY, "progress": False}
    study = run_study(tracking_trial, 20, 1, truth=truth, bound=bound, **settings)
    size = np.linalg.norm(truth[:, 0])
    return paint_fig_2({f"20 trials: {kind}, |x| = {size:.3g}, η = {bound:.3g}, noise {noise:.3g}": study})


# --- Section 9: Fig. 2 --------------------------------------------------------------------------------------------

TRIALS, REPETITIONS = 40, 8  # of the figure; how often it is repeated, 40 times in the notebook
PUBLISHED_BOUND, PUBLISHED_NORM = 1.34, 20.7
PRINTED = {"none": (0.25, 0.95), "epsilon": (0.30, 0.95), "lambda": (0.25, 1 - (0.25 / PUBLISHED_BOUND) ** 2)}
PENALTY = 14.0  # of notebook 05
# Standard deviation of the regressors, and samples, with which the data have the published norm: |A|_2 of white data
# is about amplitude (sqrt(samples) + sqrt(unknowns)) less a part of the latter.
EXCITATIONS = {"1, 375 samples": (1.0, 375), "0.6, 1100 samples": (0.6, 1100), "1.4, 185 samples": (1.4, 185)}


def tracking(
    *,
    fig_2_misprint: str,
    fig_2_noise: float,
    fig_2_excitation: str,
    fig_2_regressors: str,
    fig_2_row_errors: str,
    min_max_update: str,
    fig_2_average: str,
    fig_2_from: float,
    seed: int,
    lean: bool,
) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """Fig. 2; the fast variant repeats the 40 trials 8 times instead of 40.

    `fig_2_misprint` is what is wrong of epsilon and lambda, given eta = 1.34; `fig_2_noise` in the unit of b.
    """
    row_error, forgetting = PRINTED[fig_2_misprint]
    amplitude, samples = EXCITATIONS.get(fig_2_excitation) or weighted_excitation(forgetting)
    settings = {"forgetting": forgetting, "row_error": row_error, "noise": fig_2_noise, "penalty": PENALTY}
    settings |= {"update": min_max_update, "amplitude": amplitude, "error_law": fig_2_row_errors}
    settings |= {"delay_line": fig_2_regressors == "delay line", "progress": False}
    derived = exponential_bound(row_error, forgetting)
    still = path("constant", FIG_2_PARAMETERS, samples)
    runs = TRIALS * (REPETITIONS if lean else 40)
    printed = run_study(tracking_trial, runs, seed, truth=still, bound=PUBLISHED_BOUND, **settings)
    consistent = printed
    if fig_2_misprint == "none":
        consistent = run_study(tracking_trial, runs, seed, truth=still, bound=derived, **settings)
    jump = path("jump", FIG_2_PARAMETERS, samples)
    jumped = run_study(tracking_trial, TRIALS, seed, truth=jump, bound=PUBLISHED_BOUND, **settings)
    late = settled_from(forgetting, fig_2_from)
    found = {"bound": derived}
    for study, name in ((printed, "fig-2"), (consistent, "fig-2-consistent")):
        draws = repeated_draws(study, TRIALS, late, 1 if fig_2_average == "mean" else 2)
        found[name] = draws["below"][0].mean()
        found[f"{name}-repeated"] = draws["below"].all(axis=1).mean()
        found[f"{name}-median"] = draws["median"].mean()
    own = {
        name: settled(printed[name][:TRIALS], forgetting, fig_2_from) for name in ("min_max", "rls", "ridge")
    }
    moved = [settled(jumped[name], forgetting, fig_2_from) for name in ("min_max", "rls")]
    norm = printed["weighted_norm" if fig_2_excitation == WEIGHTED else "norm"][:TRIALS]
    found |= {
        "trials": np.mean(own["min_max"] < own["rls"]),
        "ridge": np.mean(own["min_max"] / own["ridge"]),
        "fig-3-4": np.mean(moved[0] / moved[1]),
        "norm": (norm.mean(), spread_interval(norm)),
        "norm-weighted": printed["weighted_norm"][:TRIALS].max(),
    }
    return {f"worstcase.tracking.{name}": value for name, value in found.items()}


WEIGHTED = "of the weighted data"


@lru_cache(maxsize=len(PRINTED))
def weighted_excitation(forgetting: float) -> tuple[float, int]:
    """Regressors of which the weighted data have the published norm, in the mean over 200 draws at 375 samples."""
    samples = 375
    rows = np.random.default_rng(1).standard_normal((200, len(FIG_2_PARAMETERS), samples))
    rows *= exponential_weights(samples, forgetting)
    return PUBLISHED_NORM / float(np.linalg.norm(rows, 2, axis=(1, 2)).mean()), samples


# --- Abstract: weighting in tracking ------------------------------------------------------------------------------


def weighting_statements(
    truth: tuple[float, ...],
    samples: int,
    trials: int,
    seed: int,
    forgetting: float,
    row_error: float,
    noise: float,
) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """What trials with a jump and with constant parameters say of forgetting, by the ledger's names."""
    settings = {"forgetting": forgetting, "row_error": row_error, "noise": noise, "progress": False}
    jump, still = (
        run_study(forgetting_trial, trials, seed, truth=path(kind, truth, samples), **settings)
        for kind in ("jump", "constant")
    )
    helps = jump["min_max"] < jump["min_max_kept"]
    found = {
        "helps": fraction(helps),
        "jump": np.mean(jump["min_max"] / jump["min_max_kept"]),
        "jump-least-squares": np.mean(jump["least"] / jump["least_kept"]),
        "constant-least-squares": np.mean(still["least_kept"] / still["min_max"]),
    }
    return {f"worstcase.weighting.{name}": value for name, value in found.items()}


def weighting(
    *, fig_2_noise: float, weighting_size: float, weighting_forgetting: float, seed: int
) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """`weighting_statements` for parameters of another size, over those of Fig. 2, and another forgetting."""
    truth = tuple(weighting_size * each for each in FIG_2_PARAMETERS)
    return weighting_statements(truth, 375, TRIALS, seed, weighting_forgetting, 0.25, fig_2_noise)


# === What the notebook judges beside its answer =====================================================================


def appendix(
    page,
    *,
    studies: dict[float, Study],
    repeated: dict[str, dict[str, np.ndarray]],
    truth: tuple[float, ...],
    samples: int,
    trials: int,
    seed: int,
    settings: dict[str, float],
) -> None:
    """What this notebook judges beside its answer.

    Parameters
    ----------
    page : workbook.appendix.Appendix
    studies : dict of Study
        The trials of Fig. 2, by bound: the printed one, then that of epsilon.
    repeated : dict
        Of `repeated_draws`, by the ledger's names of these two.
    truth : tuple of float
    samples, trials, seed : int
    settings : dict
        Of `tracking_trial`.
    """
    forgetting, row_error = settings["forgetting"], settings["row_error"]
    (printed_bound, printed), (derived_bound, derived) = studies.items()
    page.text("## Two bounds")
    page.show(
        f"bound from epsilon and lambda: {derived_bound:.3f}; from epsilon = 0.30: {exponential_bound(0.30, forgetting):.3f}; "
        f"the printed one from lambda = {1 - (row_error / printed_bound) ** 2:.4f}"
    )
    page.check("worstcase.tracking.norm-weighted", printed["weighted_norm"].max())
    late = settled_from(forgetting)
    for study, bound, name in (
        (printed, printed_bound, "fig-2"),
        (derived, derived_bound, "fig-2-consistent"),
    ):
        means = {m: study[m].mean(0)[late:] for m in ("min_max", "rls", "ridge")}
        page.check(f"worstcase.tracking.{name}", np.mean(means["min_max"] < means["rls"]))
        each = ", ".join(f"{m.replace('_', '-')} {values.mean():.4f}" for m, values in means.items())
        page.show(
            f"η = {bound:.4g}: {each} (mean error norms); zero estimate at {study['vanished'].mean():.3f} of the time"
        )
    _of_draws(page, repeated, list(studies), trials)
    _of_a_jump(page, truth, samples, trials, seed, printed_bound, settings)


def _of_draws(page, repeated: dict, bounds: list[float], trials: int) -> None:
    page.text("""## The draw repeated

How often does one curve lie below the other at every instant, in the mean and in the median, which depends less on the draw?""")
    for (name, found), bound in zip(repeated.items(), bounds, strict=True):
        always = found["below"].all(axis=1)
        share = always.mean(), proportion_interval(always.sum(), len(always))
        page.check(f"worstcase.tracking.{name}-repeated", *share)
        page.check(f"worstcase.tracking.{name}-median", found["median"].mean())
        page.conclude(
            "With a bound of {bound:.4g} the mean of {trials} trials lies below that of RLS at every instant in {always:.0%} of the "
            "draws, at {instants:.0%} of the instants in the median draw.",
            bound=bound,
            trials=trials,
            always=always.mean(),
            instants=np.median(found["below"].mean(axis=1)),
        )


def _of_a_jump(
    page, truth, samples: int, trials: int, seed: int, bound: float, settings: dict[str, float]
) -> None:
    page.text("""## A jump

The sign of all parameters changes in the middle. Errors are rms after three memory lengths, over those of RLS in the same trial.""")
    moving = path("jump", truth, samples)
    study = run_study(tracking_trial, trials, seed, truth=moving, bound=bound, progress=False, **settings)
    mean, (low, high) = gains(study, settings["forgetting"])["min_max"]
    page.check("worstcase.tracking.fig-3-4", mean)
    page.show(f"min-max over RLS {mean:.2f} ({low:.2f} .. {high:.2f})")
