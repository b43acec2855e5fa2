"""Power that remains: what this notebook alone needs."""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache

import numpy as np
from jaxtyping import Float64
from scipy import optimize

from experiments.isolation.floors import FLAT_LEVEL, ShapedFloor, flat_floor
from experiments.isolation.one_rig import edges, equal_struts, numbers, parameters, ranges
from experiments.isolation.performance import DIRECTIONS, ENTRIES, central_axes, expected_density
from experiments.isolation.power import BAND_HZ, limit_ratio_db, measures, power_trial
from experiments.isolation.responses import responses
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError
from stillwork.base.toml_files import read_toml
from stillwork.signals.spectra import Spectrum
from workbook import figures, paths
from workbook.claims import load_entries

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
        panel.set(title=title, ylabel=unit)
        if "tau" in first or first == "fig-7.":
            panel.set_yscale("log")
        elif "final" in first:
            panel.set_yscale("symlog", linthresh=0.1)
    figures.label(axes, "number")
    figures.legend_below(axes[0, 0], 3)
    return figure


# === Open choices =================================================================================================


FELMS_S, FERLS_S, RECORD_S = 250.0, 60.0, 40.0  # s, of a run of notebook 05
LINES_HZ = np.arange(0.25, 500.25, 0.25)  # as an estimate has them


def power(
    *,
    mains_in_power: str,
    output_noise: float,
    sensor_levels: str,
    strut_damping: float,
    actuator_pole: float,
    floor_upper_end: float,
    strut_tilt: float,
    pair_angle: float,
    rotations: float,
    seed: int,
    lean: bool,
) -> dict[str, float]:
    """Fig. 8: one run of notebook 05, or (`lean`) the weights of `steady_state` and what they leave in the mean.

    `mains_in_power` is ``"bridged"`` or ``"counted"``, `sensor_levels` three numbers between colons.
    """
    twin = equal_struts(
        strut_damping=strut_damping,
        actuator_pole=actuator_pole,
        strut_tilt=strut_tilt,
        pair_angle=pair_angle,
        rotations=rotations,
        output_noise=output_noise,
    )
    levels = FLAT_LEVEL * np.array([float(level) for level in sensor_levels.split(":")])
    floor = flat_floor(floor_upper_end, levels)
    found = _expected(twin, floor) if lean else _measured(twin, floor, seed)
    removed = found["removed with mains" if mains_in_power == "counted" else "removed FeRLS"]
    bands, above = limit_ratio_db(
        found["lines"], [found["density FeRLS"]], [found["density output noise"]], twin.instruments.mains_hz
    )
    late = np.flatnonzero(above.max(axis=0) > 3.0)
    after = late[-1] + 1 if len(late) else 0
    return {
        **{f"isolation.fig-8.removed.{name}": value for name, value in zip(ENTRIES, removed, strict=True)},
        "isolation.fig-8.removed.range": np.mean((removed > 89.5) & (removed < 94.5)),
        "isolation.fig-8.reaches-the-limit": np.mean(found["removed limit"] - found["removed FeRLS"] < 1.0),
        "isolation.fig-8.low-end-lost": np.mean(found["low end"] > 1),
        "isolation.fig-8.no-limit-above-300-hz": np.mean(found["above band"] > found["in band"]),
        "isolation.fig-8.limit-in-band": bands[after] if after < len(bands) else np.nan,
    }


def _measured(twin: Twin, floor: ShapedFloor, seed: int) -> dict[str, np.ndarray]:
    [found] = power_trial(
        [np.random.default_rng(seed)],
        twin=twin,
        floor=floor,
        felms_s=FELMS_S,
        ferls_s=FERLS_S,
        record_s=RECORD_S,
    )
    return found | {"lines": np.arange(found["density FeRLS"].shape[1]) * LINES_HZ[0]}


def _expected(twin: Twin, floor: ShapedFloor) -> dict[str, np.ndarray]:
    """What `power_trial` gives, in the mean and without mains but where they are counted."""
    weights = steady_state(twin, floor).weights
    before = expected_density(twin, floor, LINES_HZ)
    after = expected_density(twin, floor, LINES_HZ, weights=weights)
    total, left, limit = (
        Spectrum(LINES_HZ, density, 1)
        for density in (sum(before.values()), sum(after.values()), before["output noise"])
    )
    lines = [mains_power(twin, given) for given in (None, weights)]
    return measures(total, left, limit) | {
        "removed with mains": 100
        * (1 - (left.power(*BAND_HZ) + lines[1]) / (total.power(*BAND_HZ) + lines[0])),
        "density FeRLS": left.density,
        "density output noise": limit.density,
        "lines": LINES_HZ,
    }


def mains_power(twin: Twin, weights: np.ndarray | None) -> Float64[np.ndarray, "3"]:
    """Power of the mains lines in the platform's spectrum, (m/s^2)^2 and (rad/s^2)^2.

    Their sines enter all platform sensors alike, and all floor sensors.
    """
    instruments, axes = twin.instruments, central_axes(twin.rig)
    paths = responses(twin, instruments.mains_hz)
    amplitude = paths.sensitivity.sum(axis=2) * np.array(instruments.platform_mains)[:, None]
    amplitude = (
        amplitude + paths.feedforward(weights).sum(axis=2) * np.array(instruments.floor_mains)[:, None]
    )
    return 0.5 * np.sum(np.abs(amplitude @ axes.platform.T) ** 2, axis=0)
