"""Where a robust observer beats the Kalman filter and the estimate zero: a map over error size and sensor noise.

``python -m contest.noise_map`` makes ``data/motion/contest_map.csv``: errors of the flexible
states of the thesis's stage, a row a seed. Every cell has its own settings, tuned on training seeds, as often as the
contest is tuned; a judged seed takes one of these. A seed is the same machine, and the same noises but for their size,
in every cell, so that cells are compared in pairs.
"""

import csv
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np
import pandas as pd

from contest import bench
from contest.nominal import OwnObserver, nominal_of
from contest.plants import ContestPlant, plant_of
from contest.scores import ENTRANTS
from contest.tuning import DEVELOPMENT, TUNINGS, capped_mean, positions
from contest.uncertainties import Uncertainty, hidden_seed, sample_truth
from stillwork.base.checks import InputError
from workbook import paths
from workbook.studies import fraction, mean_interval

SIZES = (0.005, 0.01, 0.02, 0.05, 0.1)  # of the errors of frequency, damping, gain and shape
NOISES = (1.0, 3.0, 10.0, 30.0, 100.0, 1000.0)  # factors on the sensor's noise
ROBUST = ("sensitivity penalised", "regularised least squares")  # the thesis's two
MAPPED = ("Kalman", *ROBUST, "fictitious noise")
TRAINED, SEEDS = 6, 40  # seeds a cell is tuned on, for each tuning, and judged on
PUBLICS = ("20180628", "31415926")  # numbers of the stored map; the ledger has the first
PUBLIC = PUBLICS[0]
SAYING = 0.9  # error over that of the estimate zero, from which on an estimate is no better than none
RESAMPLES = 2000
FILE = paths.data("motion", "contest_map.csv")


def flexible_errors(
    plant: ContestPlant,
    size: float,
    noise: float,
    public: str,
    seeds: Sequence[int],
    observers: Mapping[str, OwnObserver],
) -> dict[str, np.ndarray]:
    """Error of the flexible states of each observer, a seed each, all on the same scans."""
    uncertainty = Uncertainty(size, size, size, size, noise=noise)
    given = (*nominal_of(plant, noise), plant.sample_time)
    errors = {name: np.empty(len(seeds)) for name in observers}
    for place, seed in enumerate(seeds):
        rng = np.random.default_rng(hidden_seed(public, "map", seed))
        truth = sample_truth(plant, uncertainty, bench.SAMPLES, rng)
        record = bench.record(bench.assemble(plant, truth, bench.BANDWIDTH_RATIO_LOW, estimated=False))
        for name, observer in observers.items():
            observer.start(*given)
            estimates = observer.run(record.inputs, record.measurements)
            errors[name][place] = bench.state_errors(record, estimates, plant.model.rigid_modes)[1]
    return errors


def tuned(
    plant: ContestPlant, size: float, noise: float, candidates: Mapping[str, list[OwnObserver]], tuning: int
) -> dict[str, OwnObserver]:
    """Of each entrant's candidates the one with the least mean error on the training seeds of a tuning."""
    every = {f"{name}:{k}": each for name, some in candidates.items() for k, each in enumerate(some)}
    seeds = range(tuning * TRAINED, (tuning + 1) * TRAINED)
    errors = flexible_errors(plant, size, noise, DEVELOPMENT, seeds, every)
    return {
        name: some[int(np.argmin([capped_mean(errors[f"{name}:{k}"]) for k in range(len(some))]))]
        for name, some in candidates.items()
    }


def stored_map(public: str = PUBLIC) -> pd.DataFrame:
    """The stored map of a public number, a row a cell and seed."""
    rows = pd.read_csv(FILE, dtype={"public": str})
    return rows[rows["public"] == public].drop(columns="public")


def map_variants() -> dict[str, pd.DataFrame]:
    """The stored map of each public number, with both tunings and with each of them alone."""
    maps = {f"number {public}": stored_map(public) for public in PUBLICS}
    alone = {
        f"{name}, tuning {k}": some[some["seed"] % TUNINGS == k]
        for name, some in maps.items()
        for k in range(TUNINGS)
    }
    return maps | alone


def leads(errors: pd.DataFrame, over: str = "Kalman") -> pd.DataFrame:
    """How far every observer is ahead of the Kalman filter, or of `over`, on the same scans, a row a cell and observer.

    Mean over the seeds with its interval of 95 %, and the upper end of that of the observer's mean error.
    """
    rows = []
    for (size, noise), cell in errors.groupby(["size", "noise"]):
        for name in MAPPED[1:]:
            own = cell[name].to_numpy()
            ahead = cell[over].to_numpy() - own
            rows.append((size, noise, name, ahead.mean(), *mean_interval(ahead), mean_interval(own)[1]))
    return pd.DataFrame(rows, columns=["size", "noise", "entrant", "lead", "low", "high", "error at most"])


def turning(noises: Sequence[float], lead: Sequence[float] | np.ndarray) -> float:
    """Noise above which a lead stays positive, interpolated in its logarithm; 0 where it always is, else infinite."""
    noises, lead = np.log(noises), np.asarray(lead, dtype=float)
    behind = np.flatnonzero(lead <= 0)
    if not behind.size:
        return 0.0
    last = behind[-1]
    if last == len(lead) - 1:
        return np.inf
    share = lead[last] / (lead[last] - lead[last + 1])
    return float(np.exp(noises[last] + share * (noises[last + 1] - noises[last])))


def ahead_of(one: str | float, other: str | float) -> Callable[[pd.DataFrame], pd.Series]:
    """By how much the error of `one` is below that of `other`, observers or numbers, on each scan."""

    def lead(errors: pd.DataFrame) -> pd.Series:
        of_one, of_other = (errors[each] if isinstance(each, str) else each for each in (one, other))
        return of_other - of_one

    return lead


def crossings(errors: pd.DataFrame, lead: Callable[[pd.DataFrame], pd.Series]) -> pd.DataFrame:
    """For each size of the errors the noise above which the mean of ``lead(errors)`` stays positive.

    Its interval of 95 % is from resampled tunings, and seeds within each, the same in all cells; `crosses` is the share
    of them that do cross within the map, on whichever side the others lie.
    """
    cells = errors.assign(lead=lead(errors)).pivot(index="seed", columns=["size", "noise"], values="lead")
    rng, tuning = np.random.default_rng(0), cells.index.to_numpy() % TUNINGS
    groups = [np.flatnonzero(tuning == each) for each in np.unique(tuning)]
    draws = np.array(
        [
            np.concatenate(
                [rng.choice(groups[g], len(groups[g])) for g in rng.integers(len(groups), size=len(groups))]
            )
            for _ in range(RESAMPLES)
        ]
    )
    rows = []
    for size in SIZES:
        own = cells[size].to_numpy()
        turns = np.array([turning(NOISES, each) for each in own[draws].mean(axis=1)])
        low, high = np.quantile(turns, [0.025, 0.975], method="inverted_cdf")
        inside = np.mean((turns > 0) & np.isfinite(turns))
        rows.append((size, turning(NOISES, own.mean(axis=0)), low, high, inside))
    return pd.DataFrame(rows, columns=["size", "noise", "low", "high", "crosses"])


def quiet_and_loud(errors: pd.DataFrame, size: float, loud: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """One size of the errors at the thesis's sensor noise and at `loud` times as much, a row a seed."""
    some = errors[np.isclose(errors["size"], size)]
    return some[some["noise"] == 1].set_index("seed"), some[some["noise"] == loud].set_index("seed")


def noise_values(errors: pd.DataFrame, size: float = 0.05, loud: float = NOISES[-1]) -> dict:
    """Conclusions 5.4 and 5.5 on the map as the ledger has them: fractions of the seeds."""
    quiet, noisy = quiet_and_loud(errors, size, loud)
    held = {"5-4.kalman-not-beaten": quiet["Kalman"] <= quiet[list(ROBUST)].min(axis=1)}
    for short, name in zip(("penalised", "regularised"), ROBUST, strict=True):
        held[f"5-5.{short}-gains-with-noise"] = noisy["Kalman"] - noisy[name] > quiet["Kalman"] - quiet[name]
    return {f"motion.conclusion-{claim}": fraction(each) for claim, each in held.items()}


def noise_study(*, map_size: float, loud_noise: float, seed: int, lean: bool) -> dict:
    """The same for another size of the errors or another noise, from the stored map; it has no faster variant."""
    return noise_values(stored_map(), map_size, loud_noise)


def main() -> None:
    """Make the map."""
    plant = plant_of("stage")
    with open(FILE, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("public", "size", "noise", "seed", *MAPPED))
        for noise in NOISES:
            given = (*nominal_of(plant, noise), plant.sample_time)
            candidates: dict[str, list[OwnObserver]] = {name: [] for name in MAPPED}
            for name in MAPPED:
                for settings in positions(ENTRANTS[name].knobs):
                    observer = OwnObserver(ENTRANTS[name], tuple(map(float, settings)))
                    with suppress(InputError):  # there may be no such design
                        observer.start(*given)
                        candidates[name].append(observer)
            for size in SIZES:
                chosen = [tuned(plant, size, noise, candidates, tuning) for tuning in range(TUNINGS)]
                for public in PUBLICS:
                    errors = {name: np.empty(SEEDS) for name in MAPPED}
                    for tuning, observers in enumerate(chosen):
                        seeds = range(tuning, SEEDS, TUNINGS)
                        found = flexible_errors(plant, size, noise, public, seeds, observers)
                        for name, some in found.items():
                            errors[name][tuning::TUNINGS] = some
                    for seed in range(SEEDS):
                        numbers = (f"{errors[name][seed]:.4g}" for name in MAPPED)
                        writer.writerow((public, size, noise, seed, *numbers))
                print(size, noise, flush=True)


if __name__ == "__main__":
    main()
