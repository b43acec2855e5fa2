"""The contest over all plants, doubts and seeds: its table, and its ranking with intervals.

``python -m experiments.motion.observer_contest.table`` writes the committed table's ranking into ``docs/contest.md``.
"""

import csv
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from experiments.motion.observer_contest.doubts import DOUBTS
from experiments.motion.observer_contest.entrants import ENTRANTS
from experiments.motion.observer_contest.plants import PLANTS
from experiments.motion.observer_contest.scores import SCORES, Scored, contest_trial
from experiments.motion.observer_contest.tuning import WORST, settings_for
from stillwork.base import paths
from stillwork.base.checks import InputError, require_count

COLUMNS = ("entrant", "plant", "doubt", "score", "median", "low", "high", "microseconds")
RESAMPLES = 1000
FILE, GUIDE = paths.data("motion", "contest.csv"), paths.root() / "docs" / "contest.md"
BEGIN, END = "<!-- leaderboard:begin -->", "<!-- leaderboard:end -->"  # in the guide


@dataclass(frozen=True)
class ContestResult:
    """What a contest gave."""

    scores: list[Scored]
    disqualified: Mapping[str, str]  # reasons by name


def run_contest(
    public: str,
    seeds: int,
    files: Sequence[str | Path] = (),
    *,
    plants: Sequence[str] = tuple(PLANTS),
    doubts: Sequence[str] = tuple(DOUBTS),
    loops: int | None = None,
    executor=None,
) -> ContestResult:
    """Run all entrants, and the observers in these files, over `seeds` hidden seeds a plant.

    Loops are run for the first `loops` of them, by default for all.
    The result does not depend on the executor, on its number of workers or on their order.
    """
    named = {Path(file).stem: str(Path(file).resolve()) for file in files}
    settings = {plant: settings_for(plant) for plant in plants}
    if taken := set(named) & set(settings[plants[0]]):
        raise InputError(f"{taken.pop()!r} is an entrant already; give the file another name")
    work = [
        (plant, seed, public, settings[plant], named, doubts, loops is None or seed < loops)
        for seed in range(require_count("seeds", seeds))
        for plant in plants
    ]
    if executor is None:
        done = [contest_trial(*each) for each in work]
    else:
        done = [future.result() for future in [executor.submit(contest_trial, *each) for each in work]]
    reasons = {name: reason for _, out in done for name, reason in out.items()}
    return ContestResult(
        [each for found, _ in done for each in found if each.entrant not in reasons], reasons
    )


def median_interval(values: ArrayLike, level: float = 0.95) -> tuple[float, float, float]:
    """Median and the interval that holds it whatever the law, between two values in order of size.

    Below six values no two of them hold it at this level: their ends are given.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    rank = int(stats.binom.ppf((1 - level) / 2, len(ordered), 0.5))
    low = max(rank - 1, 0)
    upper, lower = ordered[len(ordered) // 2], ordered[(len(ordered) - 1) // 2]
    middle = upper if upper == lower else (lower + upper) / 2
    return float(middle), float(ordered[low]), float(ordered[-1 - low])


def rows(contest: ContestResult) -> list[tuple]:
    """The table: a row an entrant, plant, doubt and score, with the median over the seeds and its interval.

    Those of the ranking, over all plants and doubts, come first: their middle column is the mean's.
    """
    table = []
    for each in ranking(contest):
        for score, value, interval in (
            ("mean error", each.error, each.interval),
            ("rank", each.rank, each.rank_interval),
            ("less Kalman", each.behind, each.behind_interval),
        ):
            table.append((each.entrant, "all", "all", score, value, *interval, each.microseconds))
    groups: dict[tuple, list[Scored]] = defaultdict(list)
    for each in contest.scores:
        groups[each.entrant, each.plant, each.doubt].append(each)
    for key, runs in groups.items():
        speed = float(np.median([run.microseconds for run in runs]))
        for score in SCORES:
            values = [value for run in runs if not np.isnan(value := getattr(run, score))]
            if values:
                table.append((*key, score, *median_interval(values), speed))
    return table


def write_table(contest: ContestResult, file: str | Path) -> None:
    """The table as CSV, four digits a number."""
    with open(file, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for *names, median, low, high, speed in rows(contest):
            writer.writerow((*names, *(f"{each:.4g}" for each in (median, low, high)), f"{speed:.2g}"))


@dataclass(frozen=True)
class Place:
    """Where an entrant stands; every pair is an interval of 95 % over seeds."""

    entrant: str
    error: (
        float  # of the flexible states, mean over plants, doubts and seeds, none counted beyond twice zero's
    )
    interval: tuple[float, float]
    rank: float
    rank_interval: tuple[float, float]
    behind: float  # its error less the Kalman filter's, on the same scans
    behind_interval: tuple[float, float]
    unstable: float  # share of the loops that ran away
    microseconds: float
    bytes: int


def ranking(contest: ContestResult) -> list[Place]:
    """Entrants by their mean error, with intervals from resampled seeds."""
    names = list(dict.fromkeys(each.entrant for each in contest.scores))
    seeds = sorted({each.seed for each in contest.scores})
    errors = np.zeros((len(names), len(seeds)))
    for i, name in enumerate(names):
        for j, seed in enumerate(seeds):
            errors[i, j] = np.mean(
                [min(x.flexible, WORST) for x in contest.scores if x.entrant == name and x.seed == seed]
            )
    chosen = np.random.default_rng(0).integers(len(seeds), size=(RESAMPLES, len(seeds)))
    means = errors[:, chosen].mean(axis=2)
    ranks = stats.rankdata(means, axis=0)
    kalman = names.index("Kalman")

    def interval(values):
        return tuple(float(each) for each in np.quantile(values, [0.025, 0.975]))

    standings = []
    for i, name in enumerate(names):
        own = [each for each in contest.scores if each.entrant == name]
        standings.append(
            Place(
                name,
                float(errors[i].mean()),
                interval(means[i]),
                float(stats.rankdata(errors.mean(axis=1))[i]),
                interval(ranks[i]),
                float((errors[i] - errors[kalman]).mean()),
                interval(means[i] - means[kalman]),
                float(
                    np.mean([np.isinf(each.tracking) for each in own if not np.isnan(each.tracking)] or [0])
                ),
                float(np.median([each.microseconds for each in own])),
                max(each.bytes for each in own),
            )
        )
    return sorted(standings, key=lambda each: each.error)


def leaderboard(contest: ContestResult) -> str:
    """The ranking as text."""
    lines = [
        f"{'':>2}  {'observer':38} {'error':>5}  {'95 %':^11}  {'rank':^7}  {'less Kalman':^14}  unstable  us/sample  bytes"
    ]
    for place, each in enumerate(ranking(contest), 1):
        first, final = (round(end) for end in each.rank_interval)
        lines.append(
            f"{place:>2}  {each.entrant:38} {each.error:5.2f}  {each.interval[0]:4.2f}..{each.interval[1]:4.2f} "
            f" {first:>2}..{final:<3} {each.behind_interval[0]:+.2f}..{each.behind_interval[1]:+.2f} "
            f" {100 * each.unstable:6.0f} %  {each.microseconds:9.1f}  {each.bytes or '':>6}"
        )
    lines += [f" -  {name:38} disqualified: {reason}" for name, reason in contest.disqualified.items()]
    return "\n".join(lines)


def standings(file: str | Path) -> str:
    """The ranking that a written table holds, as Markdown; a page of the site shows the committed one's."""
    table = pd.read_csv(file)
    away = table[table["score"] == "tracking"].groupby("entrant")["median"].agg(lambda x: np.isinf(x).mean())
    scores = {name: of.set_index("entrant") for name, of in table[table["plant"] == "all"].groupby("score")}
    lines = [
        "| rank | observer | error | less Kalman | ran away | µs a sample | after |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, each in scores["mean error"].sort_values("median", kind="stable").iterrows():
        rank, behind = (scores[score].loc[name] for score in ("rank", "less Kalman"))
        lines.append(
            f"| {rank['low']:.0f} to {rank['high']:.0f} | {name} | {each['low']:.2f} to {each['high']:.2f} | "
            f"{behind['low']:+.2f} to {behind['high']:+.2f} | {100 * away[name]:.0f} % | "
            f"{each['microseconds']:.2g} | {ENTRANTS[name].source} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Write the committed table's ranking into its guide."""
    before, _, rest = GUIDE.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    GUIDE.write_text(f"{before}{BEGIN}\n{standings(FILE)}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
