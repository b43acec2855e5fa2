"""Pictures of tracking with bounded regressor errors: Fig. 2, its variations, and the map of wins."""

import numpy as np

from experiments.worstcase.simulations import FIG_2_PARAMETERS, path, settled, tracking_trial
from workbook import figures
from workbook.studies import Study, mean_interval, run_study

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
                axes.fill_between(time, mean - half, mean + half, color=colour, alpha=0.2, linewidth=0)
        top = 2.2 * study["zero"].mean()
        axes.set(ylabel="mean |x − estimate|", title=title, ylim=(0, top))
    panels[0, 0].legend(ncols=4)
    panels[-1, 0].set_xlabel("time (samples)")
    return figure


def gains(study: Study, forgetting: float) -> dict[str, tuple[float, tuple[float, float]]]:
    """Mean over trials, with its 95 % interval, of the settled rms error over that of RLS, by method."""
    base = settled(study["rls"], forgetting)
    ratios = {name: settled(study[name], forgetting) / base for name, *_ in METHODS}
    return {name: (float(each.mean()), mean_interval(each)) for name, each in ratios.items()}


def paint_gains(found: dict[str, dict[str, tuple[float, tuple[float, float]]]]):
    """`gains` of several settings, with intervals."""
    figure, axes = figures.new(height=0.42 * len(found) + 1.5)
    places = np.arange(len(found))
    for offset, (name, label, colour, _) in zip((0.24, 0.0, -0.24), [METHODS[0], *METHODS[2:]], strict=True):
        means = np.array([row[name][0] for row in found.values()])
        ends = np.array([row[name][1] for row in found.values()])
        style = {"fmt": "o", "markersize": 4, "color": colour, "label": label}
        axes.errorbar(means, places + offset, xerr=np.abs(ends.T - means), **style)
    axes.axvline(1, color=figures.BLACK, linestyle="--", linewidth=1, label="RLS")
    axes.set_xscale("log")
    axes.set_xticks([0.7, 1, 1.5, 2, 4, 8, 16], ["0.7", "1", "1.5", "2", "4", "8", "16"])
    axes.minorticks_off()
    axes.set_yticks(places, list(found))
    axes.set(xlabel="settled rms error over that of RLS")
    axes.invert_yaxis()
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


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


def paint_win_map(
    noises: np.ndarray, bounds: np.ndarray, ratios: np.ndarray, published: list[tuple[float, float]]
):
    """Map of `win_map`: blue where min-max is better than RLS, red where it is worse."""
    figure, axes = figures.new(height=3.8)
    mesh = axes.pcolormesh(noises, bounds, np.log2(ratios), cmap="RdBu_r", vmin=-2, vmax=2, shading="nearest")
    axes.contour(noises, bounds, np.log2(ratios), levels=[0.0], colors=figures.BLACK, linewidths=1.0)
    figures.mark_published(axes, *zip(*published, strict=True), label="settings of Fig. 2 (noise assumed)")
    axes.set(xscale="log", yscale="log", xlabel="standard deviation of the output noise (unit of b)")
    axes.set(ylabel="bound η (unit of the regressors)")
    bar = figure.colorbar(mesh, ax=axes, label="error over that of RLS", extend="both", ticks=range(-2, 3))
    bar.ax.set_yticklabels(["1/4", "1/2", "1", "2", "4"])
    axes.legend(loc="upper left", frameon=True)
    return figure


def explore_tracking(bound: float, noise: float, scale: float, kind: str):
    """Fig. 2 with another bound, noise, size of the parameters, or with a jump or a drift."""
    truth = scale * path(kind, FIG_2_PARAMETERS, 375)
    settings = {"forgetting": 0.95, "row_error": 0.25, "noise": noise, "penalty": 14.0, "progress": False}
    study = run_study(tracking_trial, 40, 1, truth=truth, bound=bound, **settings)
    size = np.linalg.norm(truth[:, 0])
    return paint_fig_2({f"{kind}, |x| = {size:.3g}, η = {bound:.3g}, noise {noise:.3g}": study})
