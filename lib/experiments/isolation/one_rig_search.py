"""The search for one rig (`one_rig`) and what it found, ``data/isolation/one_rig_found.toml``.

``python -m experiments.isolation.one_rig_search`` searches anew (some minutes) and writes that file: the most probable
parameters, by least squares from the nearest of many draws, and Laplace's approximation around them. A search does
not see the numbers of its fold: each column of Table 1 and each direction of Fig. 8 is held out once.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache

import numpy as np
from jaxtyping import Float64
from scipy import optimize

from experiments.isolation.one_rig import edges, numbers, parameters, ranges
from experiments.isolation.performance import ENTRIES
from stillwork.base.checks import InputError
from stillwork.base.toml_files import read_toml
from workbook import paths
from workbook.claims import load_entries

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
    """Standard deviation of a number around what a rig gives, in the size that `sized` takes; from the numbers seen."""
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


def sized(name: str, value):
    """A number as the search sees it: a time or a share of the power that is left by its logarithm."""
    if ".tau-" in name:
        return np.log(value)
    return np.log(100 - value) if name.startswith("fig-8") else value


def unsized(name: str, value):
    """The inverse of `sized`."""
    if ".tau-" in name:
        return np.exp(value)
    return 100 - np.exp(value) if name.startswith("fig-8") else value


def simulate(position: np.ndarray, names: Collection[str]) -> Float64[np.ndarray, " numbers"]:
    """Numbers of a rig as `sized`; far from all where no rig can be built."""
    try:
        found = numbers(parameters(position))
    except (InputError, np.linalg.LinAlgError):
        return np.full(len(names), FAR)
    return np.array([sized(name, found[name]) for name in names])


def simulate_all(positions: np.ndarray, names: Collection[str]) -> tuple[np.ndarray, np.ndarray]:
    """Those of the positions of which a rig can be built, and the numbers of each."""
    found = np.array([simulate(position, names) for position in positions])
    whole = found[:, 0] != FAR
    return positions[whole], found[whole]


def soften(residual: np.ndarray) -> np.ndarray:
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
        return np.concatenate([soften((model(position)[seen] - observed) / deviation), position])

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
    observed = np.array([sized(name, printed[name]) for name in seen])
    deviation = np.array([of(name) for name in seen])
    size = np.hypot(simulated[:, columns].std(axis=0), deviation)
    misfit = np.sum(soften((simulated[:, columns] - observed) / size) ** 2, axis=1)
    ends = [
        laplace(lambda position: simulate(position, names), positions[k], columns, observed, deviation)
        for k in np.argsort(misfit, kind="stable")[:starts]
    ]
    middle, covariance, _ = min(ends, key=lambda end: end[2])
    print(f"{len(seen)} numbers seen, costs {[round(end[2], 1) for end in ends]}", flush=True)
    draws = np.random.default_rng(SEED).multivariate_normal(middle, covariance, MEMBERS, method="cholesky")
    return middle, draws


def band(name: str, values: np.ndarray, deviation: float) -> tuple[float, float]:
    """95 % predictive band of a printed number from what rigs give, `sized`, each with its scatter."""
    spread = np.random.default_rng(SEED).standard_normal((50, len(values))) * deviation
    low, high = sorted(unsized(name, np.quantile(values + spread, [0.025, 0.975])))
    return float(low), float(high)


def alone(
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
        low, high = sorted(unsized(name, np.array([values.min(), values.max()])))
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
        found[name]["alone"] = alone(prior, names, name, of)
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
        "# Made by `python -m experiments.isolation.one_rig_search`:",
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
