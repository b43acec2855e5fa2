"""Who stands where: ranks on each machine, intervals over machines and seeds, and how much one machine decides.

A table holds a row for each scan and score and a column for each entrant. `docs/contest.md` explains each number.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float64
from scipy import stats

from contest.tuning import TUNINGS, WORST, capped_mean

KEYS = ["score", "public", "plant", "uncertainty", "seed"]
MARGIN = 0.02  # of the error over that of the estimate zero: observers that differ by less are level
LOST = 10.0  # times the error of the estimate zero, from which on an estimate has diverged
RESAMPLES = 2000
FEWEST_PLANTS, FEWEST_DRAWS = 6, 4  # below these no interval is given


@dataclass(frozen=True)
class Block:
    """One score of a table: its cells are machines under uncertainties, its draws public numbers and seeds."""

    values: Float64[np.ndarray, "cells draws entrants"]  # the smaller the better
    plants: np.ndarray  # (cells,) names
    groups: np.ndarray  # (draws,) which tuning a draw takes
    entrants: tuple[str, ...]

    def without(self, plant: str) -> "Block":
        """All but one machine."""
        kept = self.plants != plant
        return Block(self.values[kept], self.plants[kept], self.groups, self.entrants)

    def by_plant(self, of_cells: np.ndarray) -> np.ndarray:
        """Means over each machine's cells, of an array that has cells first."""
        return np.array([of_cells[self.plants == plant].mean(axis=0) for plant in dict.fromkeys(self.plants)])

    @property
    def relative_ranks(self) -> np.ndarray:
        """Ranks of the entrants on each scan, ties sharing one, averaged over a machine's uncertainties: plant, draw, entrant."""
        return self.by_plant(stats.rankdata(self.values, axis=2))


def block(table: pd.DataFrame, score: str, entrants: Sequence[str] | None = None) -> Block:
    """The rows of one score that all these entrants ran on."""
    rows = table[table["score"] == score].drop(columns="score").set_index(KEYS[1:])
    rows = rows[list(entrants)] if entrants else rows.dropna(axis=1, how="all")
    rows = rows.unstack(["public", "seed"]).dropna()
    columns = rows.columns.to_frame(index=False)
    names = tuple(dict.fromkeys(columns.iloc[:, 0]))
    draws = columns.iloc[:, 1:].drop_duplicates()
    values = rows.to_numpy(float).reshape(len(rows), len(names), len(draws)).transpose(0, 2, 1)
    values = -values if score == "bandwidth" else values
    plants = rows.index.get_level_values("plant").to_numpy()
    return Block(values, plants, draws["seed"].to_numpy(int) % TUNINGS, names)


def resampled_means(by_plant: np.ndarray, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means over plants and draws of an array that has these first, and the same of resampled ones.

    Machines are drawn, for each of them as many tunings, and within each of these seeds. Too few give no resampled means.
    """
    plants, draws = by_plant.shape[:2]
    if plants < FEWEST_PLANTS or draws < FEWEST_DRAWS:
        return by_plant.mean(axis=(0, 1)), np.full((1, *by_plant.shape[2:]), np.nan)
    rng = np.random.default_rng(0)
    members = [np.flatnonzero(groups == group) for group in np.unique(groups)]
    again = np.empty((RESAMPLES, *by_plant.shape[2:]))
    for k in range(RESAMPLES):
        chosen, drawn = (
            rng.integers(plants, size=plants),
            rng.integers(len(members), size=(plants, len(members))),
        )
        seeds = [
            np.concatenate([rng.choice(members[group], len(members[group])) for group in row])
            for row in drawn
        ]
        again[k] = np.mean(
            [by_plant[plant, some].mean(axis=0) for plant, some in zip(chosen, seeds, strict=True)], axis=0
        )
    return by_plant.mean(axis=(0, 1)), again


def interval(again: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends of 95 %."""
    low, high = np.quantile(again, [0.025, 0.975], axis=0)
    return low, high


def mean_ranks(of: Block) -> pd.DataFrame:
    """Mean rank over machines, its interval, and the places between which leaving out one machine moves it."""
    means, again = resampled_means(of.relative_ranks, of.groups)
    low, high = interval(again)
    places = leave_one_out(of).to_numpy()
    columns = {
        "rank": means,
        "low": low,
        "high": high,
        "best place": places.min(axis=1),
        "last place": places.max(axis=1),
    }
    return pd.DataFrame(columns, index=list(of.entrants)).sort_values("rank", kind="stable")


def leave_one_out(of: Block) -> pd.DataFrame:
    """Places by mean rank, a column for each machine that is left out, where there are others; ties share one."""
    plants = dict.fromkeys(of.plants)
    columns = {
        plant: stats.rankdata(rest.relative_ranks.mean(axis=(0, 1)).round(12), "min")
        for plant in plants
        for rest in [of.without(plant) if len(plants) > 1 else of]
    }
    return pd.DataFrame(columns, index=list(of.entrants)).astype(int)


def critical_difference(of: Block, level: float = 0.05) -> tuple[float, float]:
    """Friedman's probability that all are level, machines as blocks, and Nemenyi's critical difference of mean ranks."""
    ranks = stats.rankdata(of.relative_ranks.mean(axis=1), axis=1)
    count, entrants = ranks.shape
    chance = stats.friedmanchisquare(*ranks.T).pvalue
    reach = stats.studentized_range.ppf(1 - level, entrants, np.inf) / np.sqrt(2)
    return float(chance), float(reach * np.sqrt(entrants * (entrants + 1) / (6 * count)))


def against(of: Block, other: str = "Kalman") -> pd.DataFrame:
    """Paired differences of errors on the same scans, over those of `other`.

    *behind* is the mean over machines and draws, none of the errors counted beyond `WORST`; *median* that over cells of
    the medians over draws. *better*, *level* and *worse* are shares of cells by `MARGIN`. The verdict is of the interval.
    """
    place = of.entrants.index(other)
    capped = np.minimum(of.values, WORST)
    means, again = resampled_means(of.by_plant(capped - capped[:, :, [place]]), of.groups)
    low, high = interval(again)
    large = np.minimum(of.values, 1e6)  # both lost is level
    medians = np.median(large - large[:, :, [place]], axis=1)
    verdict = np.select(
        [np.isnan(low), (low > -MARGIN) & (high < MARGIN), high < 0, low > 0],
        ["", "level", "better", "worse"],
        "open",
    )
    columns = {
        "behind": means,
        "low": low,
        "high": high,
        "median": np.median(medians, axis=0),
        "better": (medians < -MARGIN).mean(axis=0),
        "level": (np.abs(medians) <= MARGIN).mean(axis=0),
        "worse": (medians > MARGIN).mean(axis=0),
        "verdict": verdict,
    }
    return pd.DataFrame(columns, index=list(of.entrants))


def robustness(of: Block) -> pd.DataFrame:
    """Worst cell, shares of cells worse than the Kalman filter and than zero, and of scans on which all is lost; no caps."""
    medians = np.median(of.values, axis=1)
    columns = {
        "worst cell": medians.max(axis=0),
        "worse than Kalman": against(of)["worse"].to_numpy(),
        "worse than zero": (medians > 1).mean(axis=0),
        "diverged": (of.values > LOST).mean(axis=(0, 1)),
    }
    return pd.DataFrame(columns, index=list(of.entrants))


def mean_errors(of: Block) -> pd.Series:
    """Mean over machines, uncertainties and draws, none counted beyond `WORST`."""
    errors = [capped_mean(self) for self in of.by_plant(np.minimum(of.values, WORST)).transpose(2, 0, 1)]
    return pd.Series(errors, index=list(of.entrants))


def loops(table: pd.DataFrame) -> pd.DataFrame:
    """The loop's track, of those that entered: median errors, share of loops that were unstable, bandwidth over the oracle's."""
    columns = {}
    for score in ("tracking", "rejection"):
        if (table["score"] == score).any():
            of = block(table, score)
            columns[score] = pd.Series(np.median(of.values, axis=(0, 1)), index=list(of.entrants))
            # The rejection ends with the scan: it counts the loops that are lost late, too.
            lost = np.isinf(of.values).mean(axis=(0, 1))
            columns["unstable loops"] = pd.Series(lost, index=list(of.entrants))
    if (table["score"] == "bandwidth").any():
        of = block(table, "bandwidth")
        best = of.by_plant(of.values)
        shares = (best / best[:, :, [of.entrants.index("oracle")]]).mean(axis=(0, 1))
        columns["bandwidth"] = pd.Series(shares, index=list(of.entrants))
    return pd.DataFrame(columns)


def with_interval(value: float, low: float, high: float, form: str) -> str:
    """A value with its interval, where there is one."""
    return f"{value:{form}}" if np.isnan(low) else f"{value:{form}} [{low:{form}}, {high:{form}}]"


# Columns of the leaderboard's tracks.
ESTIMATE = (
    "mean rank",
    "rank range, one machine left out",
    "error",
    "minus Kalman",
    "verdict",
    "worst cell",
    "worse than Kalman",
    "diverged",
    "rigid-body error",
)
TRACKS = {
    "Estimate": ESTIMATE,
    "Loop": ("tracking", "rejection", "bandwidth", "unstable loops"),
}


def by_track(found: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Standings as a table for each track, with those that have a score in it."""
    tables = {}
    for track, wanted in TRACKS.items():
        columns = [each for each in wanted if each in found]
        some = found[["observer", *columns]]
        tables[track] = some[(some[columns] != "").any(axis=1)]
    return tables


def standings(table: pd.DataFrame) -> pd.DataFrame:
    """The leaderboard in words: a row an entrant by mean rank, the oracle and those that have no estimate last."""
    flexible = block(table, "flexible")
    ranks, behind, robust = mean_ranks(flexible), against(flexible), robustness(flexible)
    errors, loop = mean_errors(flexible), loops(table)
    rigid = mean_errors(block(table, "rigid"))
    rows = []
    for name in [*ranks.index, *loop.index.difference(ranks.index)]:
        row = {"observer": name}
        if name in ranks.index:
            rank, own = ranks.loc[name], robust.loc[name]
            places = sorted({int(rank["best place"]), int(rank["last place"])})
            row |= {
                "mean rank": with_interval(rank["rank"], rank["low"], rank["high"], ".1f"),
                "rank range, one machine left out": " to ".join(map(str, places)),
                "error": f"{errors[name]:.2f}",
                "rigid-body error": f"{rigid[name]:.2f}",
                "minus Kalman": with_interval(*behind.loc[name, ["behind", "low", "high"]], "+.2f"),
                "verdict": behind.loc[name, "verdict"],
                "worst cell": f"{own['worst cell']:.2g}",
                "worse than Kalman": f"{100 * own['worse than Kalman']:.0f} %",
                "diverged": f"{100 * own['diverged']:.1f} %",
            }
        if name in loop.index:
            shown = loop.loc[name]
            row |= {
                each: f"{shown[each]:.2g}" for each in ("tracking", "rejection", "bandwidth") if each in shown
            }
            row |= (
                {"unstable loops": f"{100 * shown['unstable loops']:.0f} %"}
                if "unstable loops" in shown
                else {}
            )
        rows.append(row)
    found = pd.DataFrame(rows).fillna("")
    return found.loc[:, (found != "").any()]
