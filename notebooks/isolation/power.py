"""Power that remains: what this notebook alone needs."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from jaxtyping import Float64
from scipy import linalg, optimize

from experiments.isolation.floors import FLAT_LEVEL, ShapedFloor, flat_floor
from experiments.isolation.one_rig import edges, equal_struts, numbers, parameters, ranges
from experiments.isolation.performance import DIRECTIONS, ENTRIES
from experiments.isolation.power import RESOLUTION_HZ, limit_ratio_db, power_trial
from experiments.isolation.simulation import TOGETHER
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError
from stillwork.base.toml_files import read_toml
from workbook import figures, paths
from workbook.claims import load_entries
from workbook.studies import proportion_interval, run_study, spread_interval

# === One rig search ===============================================================================================
# The search for one rig (`one_rig`) and what it found, ``data/isolation/one_rig_found.toml``.
#
# ``python -m notebooks.isolation.power`` searches anew (some minutes) and writes that file: the most probable
# parameters, by least squares from the nearest of many draws, and Laplace's approximation around them. A search does
# not see the numbers of its fold: each column of Table 1 and each direction of Fig. 8 is held out once.


DRAWS, STARTS, MEMBERS, SEED = 200, 3, 60, 1
EVALUATIONS, STEP = 12, 0.02  # of a fit; step of its derivatives
FAR = 1e3  # stands for a number of a rig that cannot be built
FOLDS = 3
EDGES = ("fig-7.lower-end", "fig-7.upper-end", "fig-7.low-frequency-loss")  # no search sees them


@cache
def published() -> dict[str, float]:
    """The paper's numbers that a rig is held against, by the last parts of their entries.

    The times of w1 and w4 are left out: noise spreads them over more than a factor of four (notebook 02).
    """
    names = [
        f"table-1.{algorithm}.{quantity}-w{k}"
        for algorithm in ("felms", "ferls")
        for quantity in ("final", "tau")
        for k in range(1, 10)
        if quantity == "final" or k not in (1, 4)
    ]
    names += [f"fig-8.removed.{direction}" for direction in ENTRIES]
    entries = load_entries("isolation")
    return {
        name: entries[f"isolation.{name}"].published for name in (*names, "setup.equivalent-mass", *EDGES)
    }


def fold_of(name: str) -> int | None:
    """Fold that holds a number out; None for one that every search sees.

    A fold takes three columns of Table 1, one of each kind of weight and one of each sensor, and a direction of Fig. 8.
    """
    if name.startswith("table-1"):
        kind, sensor = divmod(int(name[-1]) - 1, 3)
        return (kind + sensor) % FOLDS
    return ENTRIES.index(name.rpartition(".")[2]) if name.startswith("fig-8") else None


def scatter(seen: Collection[str]) -> Callable[[str], float]:
    """Standard deviation of a number around what a rig gives, in the size that `to_log` takes; from the numbers seen."""
    stated, printed = read_toml(paths.data("isolation", "one_rig.toml"))["scatter"], published()
    apart = [
        printed[name] - printed[name.replace("ferls", "felms")]
        for name in seen
        if name.startswith("table-1.ferls.final")
    ]
    final = float(np.sqrt(np.mean(np.square(apart)) / 2))

    def of(name: str) -> float:
        if ".final-" in name:
            return final
        if name.startswith("fig-8"):
            return stated["removed_percent"] / (100 - printed[name])
        return stated["log_time"] if ".tau-" in name else stated["equivalent_mass"]

    return of


def to_log(name: str, value):
    """A number as the search sees it: a time or a share of the power that is left by its logarithm."""
    if ".tau-" in name:
        return np.log(value)
    return np.log(100 - value) if name.startswith("fig-8") else value


def from_log(name: str, value):
    """The inverse of `to_log`."""
    if ".tau-" in name:
        return np.exp(value)
    return 100 - np.exp(value) if name.startswith("fig-8") else value


def simulate(position: np.ndarray, names: Collection[str]) -> Float64[np.ndarray, " numbers"]:
    """Numbers of a rig as `to_log`; far from all where no rig can be built."""
    try:
        found = numbers(parameters(position))
    except (InputError, np.linalg.LinAlgError):
        return np.full(len(names), FAR)
    return np.array([to_log(name, found[name]) for name in names])


def simulate_all(positions: np.ndarray, names: Collection[str]) -> tuple[np.ndarray, np.ndarray]:
    """Those of the positions of which a rig can be built, and the numbers of each."""
    found = np.array([simulate(position, names) for position in positions])
    whole = found[:, 0] != FAR
    return positions[whole], found[whole]


def robust_loss(residual: np.ndarray) -> np.ndarray:
    """Residuals whose squares grow as the residual alone when it is large: an exponential's tails."""
    # The square root of 2 (sqrt(1 + r^2) - 1), without its cancellation at small r.
    return residual * np.sqrt(2 / (1 + np.sqrt(1 + residual**2)))


def laplace(
    model: Callable[[np.ndarray], np.ndarray],
    start: Float64[np.ndarray, " parameters"],
    seen: Sequence[int],
    observed: Float64[np.ndarray, " numbers"],
    deviation: Float64[np.ndarray, " numbers"],
) -> tuple[np.ndarray, np.ndarray, float]:
    """Most probable parameters near a start, their covariance by Laplace's approximation, and their cost.

    Parameters are standard normal before anything is seen. `model` gives all numbers, `seen` says which count.
    """

    def residuals(position):
        return np.concatenate([robust_loss((model(position)[seen] - observed) / deviation), position])

    fit = optimize.least_squares(residuals, start, diff_step=STEP, xtol=1e-3, ftol=1e-3, max_nfev=EVALUATIONS)
    return fit.x, np.linalg.inv(fit.jac.T @ fit.jac), float(fit.cost)


def infer(
    prior: tuple[np.ndarray, np.ndarray],
    names: list[str],
    seen: list[str],
    of: Callable[[str], float],
    starts: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Most probable rig that has seen some of the numbers `names`, and rigs drawn around it.

    It begins with the draws from the ranges that are nearest to what is seen, and keeps the best end.
    """
    positions, simulated = prior
    columns, printed = [names.index(name) for name in seen], published()
    observed = np.array([to_log(name, printed[name]) for name in seen])
    deviation = np.array([of(name) for name in seen])
    size = np.hypot(simulated[:, columns].std(axis=0), deviation)
    misfit = np.sum(robust_loss((simulated[:, columns] - observed) / size) ** 2, axis=1)
    ends = [
        laplace(lambda position: simulate(position, names), positions[k], columns, observed, deviation)
        for k in np.argsort(misfit, kind="stable")[:starts]
    ]
    middle, covariance, _ = min(ends, key=lambda end: end[2])
    print(f"{len(seen)} numbers seen, costs {[round(end[2], 1) for end in ends]}", flush=True)
    draws = np.random.default_rng(SEED).multivariate_normal(middle, covariance, MEMBERS, method="cholesky")
    return middle, draws


def band(name: str, values: np.ndarray, deviation: float) -> tuple[float, float]:
    """95 % predictive band of a printed number from what rigs give, `to_log`, each with its scatter."""
    spread = np.random.default_rng(SEED).standard_normal((50, len(values))) * deviation
    low, high = sorted(from_log(name, np.quantile(values + spread, [0.025, 0.975])))
    return float(low), float(high)


def single_entry_band(
    prior: tuple[np.ndarray, np.ndarray], names: list[str], name: str, of: Callable[[str], float]
) -> tuple[float, float]:
    """95 % band of a number around the rig that is searched for it alone, from as many starts as the one for all."""
    middle, _ = infer(prior, names, [name], of, STARTS)
    return band(name, simulate(middle, [name]), of(name))


def sample_prior(names: list[str], draws: int = DRAWS) -> tuple[np.ndarray, np.ndarray]:
    """Rigs drawn from the ranges, as standard normal positions, and their numbers."""
    return simulate_all(np.random.default_rng(SEED).standard_normal((draws, len(ranges()))), names)


def search() -> tuple[dict[str, float], Mapping[str, dict[str, tuple[float, float]]]]:
    """Parameters of the most probable rig, and for each number its range over the draws and its bands."""
    names = [name for name in published() if name not in EDGES]
    prior = sample_prior(names)
    found: dict[str, dict] = {}
    for name, values in zip(names, prior[1].T, strict=True):
        low, high = sorted(from_log(name, np.array([values.min(), values.max()])))
        found[name] = {"drawn": (float(low), float(high))}
    of = scatter(names)
    best, draws = infer(prior, names, names, of, STARTS)
    for name, each in zip(names, simulate_all(draws, names)[1].T, strict=True):
        found[name]["seen"] = band(name, each, of(name))
    ends = np.array([edges(parameters(position)) for position in draws])
    for name, each in zip(EDGES, ends.T, strict=True):
        low, high = np.nanquantile(each, [0.025, 0.975])
        found[name] = {"held_out": (float(low), float(high))}
    for fold in range(FOLDS):
        seen = [name for name in names if fold_of(name) != fold]
        of_fold = scatter(seen)
        _, draws = infer(prior, names, seen, of_fold, 1)
        for name, each in zip(names, simulate_all(draws, names)[1].T, strict=True):
            if fold_of(name) == fold:
                found[name]["held_out"] = band(name, each, of_fold(name))
    for name in [name for name in names if not inside(name, found[name]["seen"])]:
        found[name]["alone"] = single_entry_band(prior, names, name, of)
    return parameters(best), found


def stored() -> tuple[dict[str, float], dict[str, dict[str, tuple[float, float]]]]:
    """What `search` found when it was run last."""
    table = read_toml(paths.data("isolation", "one_rig_found.toml"))
    numbers_of = table["numbers"].items()
    return table["best"], {name: {k: tuple(ends) for k, ends in bands.items()} for name, bands in numbers_of}


def inside(name: str, within: tuple[float, float]) -> bool:
    """Whether the printed number lies in a band."""
    return bool(within[0] <= published()[name] <= within[1])


def write(best: dict[str, float], found: Mapping[str, dict[str, tuple[float, float]]]) -> None:
    """Write what `search` found."""
    lines = [
        "# Made by `python -m notebooks.isolation.power`:",
        f"# {DRAWS} draws from the ranges of one_rig.toml, {STARTS} starts, {MEMBERS} rigs for a band, seed {SEED}.",
        "# drawn: least and largest value over the draws. 95 % predictive bands: of rigs that saw all numbers (seen),",
        "# all but those of the number's fold (held_out), or, where seen misses, the number alone.",
        "",
        "[best]",
        *(f"{name} = {value:.6g}" for name, value in best.items()),
    ]
    for name, bands in found.items():
        lines += ["", f'[numbers."{name}"]']
        lines += [f"{kind} = [{low:.5g}, {high:.5g}]" for kind, (low, high) in bands.items()]
    paths.data("isolation", "one_rig_found.toml").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    write(*search())


# === One rig pictures =============================================================================================
# Figure of one rig for the whole paper (notebook 05).


_BANDS = {
    "seen": ("all numbers seen", figures.BLUE, -0.17),
    "held_out": ("this one held out", figures.ORANGE, 0.17),
}
_WEIGHTS = [f"w{k}" for k in range(1, 10)]
_PANELS = [
    ("table-1.felms.tau-", _WEIGHTS, _WEIGHTS, "FeLMS", "time to stay within 63 % (s)"),
    ("table-1.ferls.tau-", _WEIGHTS, _WEIGHTS, "FeRLS", "time (s)"),
    ("fig-8.removed.", ENTRIES, DIRECTIONS, "Fig. 8", "power removed (%)"),
    ("table-1.felms.final-", _WEIGHTS, _WEIGHTS, "", "final value (N per m/s²)"),
    ("table-1.ferls.final-", _WEIGHTS, _WEIGHTS, "", "final value (N per m/s²)"),
    (
        "fig-7.",
        ["low-frequency-loss", "lower-end", "upper-end"],
        ["0 dB", "20 dB", "to 20 dB"],
        "Fig. 7",
        "frequency (Hz)",
    ),
]


def paint_one_rig(found: Mapping[str, Mapping[str, tuple[float, float]]], printed: Mapping[str, float]):
    """95 % predictive bands of every printed number, with the numbers: Table 1 on the left, Figs. 8 and 7 on the right."""
    figure, axes = figures.new(2, 3, height=5.4)
    for panel, (first, names, labels, title, unit) in zip(axes.flat, _PANELS, strict=True):
        for kind, (label, color, shift) in _BANDS.items():
            bands = [
                (k + shift, *found[first + name][kind])
                for k, name in enumerate(names)
                if kind in found.get(first + name, {})
            ]
            if bands:
                x, low, high = np.transpose(bands)
                panel.vlines(x, low, high, color=color, lw=3, alpha=0.6, label=label)
                # Some bands are a point.
                panel.plot(x, (low + high) / 2, "o", ms=3, color=color, label=f"{label}, middle")
        known = [(k, printed[first + name]) for k, name in enumerate(names) if first + name in printed]
        figures.mark_published(panel, *zip(*known, strict=True))
        panel.set_xticks(range(len(names)), labels)
        panel.set(title=title, ylabel=unit, xlim=(-0.6, len(names) - 0.4))
        for k, name in enumerate(names):
            if first + name not in found:
                look = {"xycoords": ("data", "axes fraction"), "rotation": 90, "ha": "center", "va": "center"}
                panel.annotate("noise decides", (k, 0.5), fontsize=7, color=figures.GREY, **look)
        if "tau" in first or first == "fig-7.":
            panel.set_yscale("log")
        elif "final" in first:
            panel.set_yscale("symlog", linthresh=0.1)
    figures.label(axes, "number")
    figures.legend_below(axes[0, 0], 3)
    return figure


# === Open choices =================================================================================================


FELMS_S, FERLS_S, RECORD_S = 250.0, 60.0, 40.0  # s, of a run of notebook 05
RUNS = 16  # with three directions 48 for an ordering


def power(
    *, mains_in_power: str, seed: int, lean: bool = False, **open_choices
) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """Fig. 8 with FeRLS by `RUNS` runs, as notebook 05 judges it; no leaner form.

    `mains_in_power` is ``"bridged"`` or ``"counted"``; the others are those of `other_rig`.
    """
    twin, floor = other_rig(**open_choices)
    return judged(power_runs(twin, floor, seed), twin.instruments.mains_hz, mains_in_power == "counted")


def both_algorithms(*, seed: int, lean: bool = False, **open_choices) -> dict:
    """Fig. 8 with FeLMS, too, which takes four times as long; no leaner form."""
    study = power_runs(*other_rig(**open_choices), seed, felms_s=FELMS_S)
    return {"isolation.fig-8.same-by-both": same_by_both(study)}


def other_rig(
    *, floor_upper_end: float, sensor_levels: str, sensor_correlation: float, **struts: float
) -> tuple[Twin, ShapedFloor]:
    """Rig and floor at a combination of open choices.

    `sensor_levels` are three numbers between colons, `sensor_correlation` the share of the sensors' power that all three
    see alike, `struts` the arguments of `equal_struts`.
    """
    levels = FLAT_LEVEL * np.array([float(level) for level in sensor_levels.split(":")])
    return correlated(equal_struts(**struts), sensor_correlation), flat_floor(floor_upper_end, levels)


def power_runs(twin: Twin, floor: ShapedFloor, seed: int, runs: int = RUNS, felms_s: float | None = None):
    """Runs of the experiment of Fig. 8; FeLMS, which takes most of the time, with `felms_s` alone."""
    settings = {"felms_s": felms_s, "ferls_s": FERLS_S, "record_s": RECORD_S}
    return run_study(
        power_trial, runs, seed, together=TOGETHER, progress=False, twin=twin, floor=floor, **settings
    )


def same_by_both(study) -> tuple[float, tuple[float, float]]:
    """Share of runs and directions in which FeLMS and FeRLS remove the same power within half a point."""
    obeyed = np.abs(study["removed FeLMS"] - study["removed FeRLS"]) < 0.5
    return float(obeyed.mean()), proportion_interval(int(obeyed.sum()), obeyed.size)


def correlated(twin: Twin, share: float) -> Twin:
    """Twin whose floor sensors see `share` of their power alike.

    Its plant takes three independent motions and mixes them; the feedforward hears the unmixed ones, which changes
    nothing but rounding for FeRLS (notebook 06: it commands the same on any basis).
    """
    count = twin.sensors
    mixing = linalg.sqrtm((1 - share) * np.eye(count) + share * np.ones((count, count))).real
    names = ("floor_damping", "floor_stiffness", "floor_inertia")
    return replace(
        twin, plant=replace(twin.plant, **{name: getattr(twin.plant, name) @ mixing for name in names})
    )


def judged(study, mains_hz, counted: bool = False) -> dict[str, float | tuple[float, tuple[float, float]]]:
    """Every entry that the runs of Fig. 8 decide, with its interval."""
    removed = study["removed with mains" if counted else "removed FeRLS"]
    frequencies = np.arange(study["density FeRLS"].shape[2]) * RESOLUTION_HZ
    found: dict = {
        f"isolation.fig-8.removed.{name}": (float(values.mean()), spread_interval(values))
        for name, values in zip(ENTRIES, removed.T, strict=True)
    }
    for entry, obeyed in {
        "removed.range": (removed > 89.5) & (removed < 94.5),
        "reaches-the-limit": study["removed limit"] - study["removed FeRLS"] < 1.0,
        "low-end-lost": study["low end"] > 1,
        "no-limit-above-300-hz": study["above band"] > study["in band"],
    }.items():
        interval = proportion_interval(int(obeyed.sum()), obeyed.size)
        found[f"isolation.fig-8.{entry}"] = float(obeyed.mean()), interval
    bands, above = limit_ratio_db(
        frequencies, study["density FeRLS"], study["density output noise"], mains_hz
    )
    late = np.flatnonzero(above.max(axis=0) > 3.0)
    after = late[-1] + 1 if len(late) else 0
    found["isolation.fig-8.limit-in-band"] = float(bands[after]) if after < len(bands) else np.nan
    return found


def without_unequal_sensors(best: dict[str, float]) -> dict[str, dict[str, float]]:
    """The most probable rig with its floor sensors made equal, one property after another."""

    def mean(name: str) -> dict[str, float]:
        return {f"{name}{k}": float(np.mean([best[f"{name}{j}"] for j in (1, 2, 3)])) for k in (1, 2, 3)}

    levels, radii = mean("floor_level"), mean("sensor_radius")
    angles = {f"sensor_angle{k}": 0.0 for k in (1, 2, 3)}
    near = {f"sensor_radius{k}": 0.0648 for k in (1, 2, 3)}
    return {
        "most probable rig": best,
        "equal levels": best | levels,
        "equal levels, radii and angles": best | levels | radii | angles,
        "radius of the twin, levels kept": best | near,
        "radius of the twin, equal levels and angles": best | levels | angles | near,
    }
