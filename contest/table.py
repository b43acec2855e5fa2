"""The contest over all plants, doubts and seeds: its command, its table, and its ranking with intervals.

``python -m stillwork contest`` holds it; ``python -m contest.table`` writes the committed
table's ranking into ``docs/contest.md``.
"""

import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from contest.plants import PLANTS
from contest.scores import ENTRANTS, SCORES, Scored, contest_trial
from contest.tuning import capped_mean, settings_for
from contest.uncertainties import UNCERTAINTIES
from stillwork.base.checks import InputError, require_choice, require_count
from workbook import paths
from workbook.workers import client_of, cores, processes

COLUMNS = ("entrant", "plant", "doubt", "score", "median", "low", "high", "microseconds")
RESAMPLES = 1000
OTHERS = {"rigid": "rigid", "loop": "tracking", "peak": "peak"}  # columns of the page and their scores
FILE, GUIDE = paths.data("motion", "contest.csv"), paths.root() / "docs" / "contest.md"
BEGIN, END = "<!-- leaderboard:begin -->", "<!-- leaderboard:end -->"  # in the guide


def run_contest(
    public: str,
    seeds: int,
    files: Sequence[str | Path] = (),
    *,
    only: Sequence[str] = (),
    plants: Sequence[str] = tuple(PLANTS),
    doubts: Sequence[str] = tuple(UNCERTAINTIES),
    loops: int | None = None,
    heavy: int | None = None,
    executor=None,
) -> tuple[list[Scored], dict[str, str]]:
    """Run our entrants (`only` these and the Kalman filter) and the observers in these files over `seeds` hidden seeds.

    Returns the scores, and why observers were disqualified, by name.
    Loops are run for the first `loops` of them, our heavy entrants on the first `heavy`, by default on all.
    The result does not depend on the executor, on its number of workers or on their order.
    """
    for name in only:
        require_choice("only", name, ENTRANTS)
    named = {Path(file).stem: str(Path(file).resolve()) for file in files}
    if len(named) < len(files):
        raise InputError("two files have one name, by which observers are ranked; give one of them another")
    if taken := set(named) & set(ENTRANTS):
        raise InputError(f"{taken.pop()!r} is an entrant already; give the file another name")
    names = [name for name in ENTRANTS if not only or name in ("Kalman", *only)]
    light = [name for name in names if not ENTRANTS[name].heavy]
    settings = {plant: settings_for(plant, names) for plant in plants}

    def trial(plant: str, seed: int) -> tuple:
        ours = names if heavy is None or seed < heavy else light
        knobs = {name: settings[plant][name] for name in ours}
        return plant, seed, public, knobs, named, doubts, loops is None or seed < loops

    trials = [trial(plant, seed) for seed in range(require_count("seeds", seeds)) for plant in plants]
    # Whoever is out on the first is not waited for on all others.
    reasons = contest_trial(plants[0], 0, public, {}, named, doubts[:1])[1] if named else {}
    for name in reasons:
        del named[name]
    if executor is None:
        done = [contest_trial(*each) for each in trials]
    else:
        done = [future.result() for future in [executor.submit(contest_trial, *each) for each in trials]]
    reasons |= {name: reason for _, out in done for name, reason in out.items()}
    return [each for found, _ in done for each in found if each.entrant not in reasons], reasons


def median_interval(values: ArrayLike) -> tuple[float, float, float]:
    """Median and the interval that holds it with 95 % whatever the law, between two values in order of size.

    Below six values no two of them hold it so surely: their ends are given.
    """
    ordered = np.sort(np.asarray(values, dtype=float))
    low = max(int(stats.binom.ppf(0.025, len(ordered), 0.5)) - 1, 0)
    return float(np.median(ordered)), float(ordered[low]), float(ordered[-1 - low])


def measured(scores: Sequence[Scored]) -> pd.DataFrame:
    """What was measured: a row an entrant, plant, doubt and score, with the median over the seeds and its interval.

    Over all plants and doubts there are the mean error of each seed and the bytes that the entrant holds at most.
    """
    runs = pd.DataFrame(scores)
    by_entrant = runs.groupby("entrant", sort=False)
    speed, held = by_entrant["microseconds"].median(), by_entrant["bytes"].max()
    errors = runs.groupby(["entrant", "seed"], sort=False)["flexible"].agg(capped_mean)
    table = [
        (name, "all", f"seed {seed}", "mean error", error, error, error, speed[name])
        for (name, seed), error in errors.items()
    ]
    table += [(name, "all", "all", "bytes", *[held[name]] * 3, speed[name]) for name in held[held > 0].index]
    for key, own in runs.groupby(["entrant", "plant", "doubt"], sort=False):
        for score in SCORES:
            if len(values := own[score].dropna()):
                table.append((*key, score, *median_interval(values), own["microseconds"].median()))
    return _rounded(table)


def _rounded(rows: list[tuple]) -> pd.DataFrame:
    """Rows of the table as it is written: four digits a number, two a time."""
    return pd.DataFrame(
        [(*row[:4], *(float(f"{each:.4g}") for each in row[4:7]), float(f"{row[7]:.2g}")) for row in rows],
        columns=COLUMNS,
    )


def of_seeds(table: pd.DataFrame) -> pd.DataFrame:
    """Mean error of every entrant, a row each, on every seed; NaN where it did not run."""
    rows = table[table["doubt"].str.startswith("seed ")]
    found = rows.pivot(index="entrant", columns="doubt", values="median")
    return found.loc[rows["entrant"].unique()]


def level(seen: pd.DataFrame) -> tuple[np.ndarray, np.ndarray]:
    """Mean over the seeds of each entrant, and the same of resampled seeds.

    Who ran on some of the seeds is compared with the Kalman filter there: its lead is taken off the filter's mean
    over all. Seeds that all ran on, and the others, are resampled apart.
    """
    errors, kalman = seen.to_numpy(), seen.loc["Kalman"].to_numpy()
    rng, whole = np.random.default_rng(0), np.isfinite(errors).all(axis=0)
    chosen = np.hstack(
        [rng.choice(np.flatnonzero(part), (RESAMPLES, part.sum())) for part in (whole, ~whole) if part.any()]
    )
    behind = errors - kalman
    every = np.arange(len(kalman))
    return tuple(np.nanmean(behind[:, of], axis=-1) + kalman[of].mean(axis=-1) for of in (every, chosen))


def ranked(table: pd.DataFrame) -> pd.DataFrame:
    """The table with its ranking on top, by mean error; intervals of 95 % from resampled seeds.

    For each entrant: its mean error, its rank (ties share one), and its error less the Kalman filter's on the same scans.
    """
    seen = of_seeds(table)
    means, resampled = level(seen)
    kalman = seen.index.get_loc("Kalman")
    scores = {
        "mean error": (means, resampled),
        "rank": (stats.rankdata(means), stats.rankdata(resampled, axis=0)),
        "less Kalman": (means - means[kalman], resampled - resampled[kalman]),
    }
    speed = table[table["plant"] == "all"].groupby("entrant")["microseconds"].first()
    rows = []
    for place in np.argsort(means, kind="stable"):
        name = seen.index[place]
        for score, (values, again) in scores.items():
            interval = np.quantile(again[place], [0.025, 0.975])
            rows.append((name, "all", "all", score, values[place], *interval, speed[name]))
    kept = table[~((table["doubt"] == "all") & table["score"].isin(list(scores)))]
    return pd.concat([_rounded(rows), kept], ignore_index=True)


def joined(before: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """A table with the rows of some entrants in place of those that it had, ranked anew: all ran on the same scans."""
    old, again = (of_seeds(each).reindex(["Kalman"]) for each in (before, new))
    if not old.equals(again):
        raise InputError(
            "the table to join is of other scans; give the seeds and the public number that made it"
        )
    kept = before[~before["entrant"].isin(new["entrant"].unique())]
    return ranked(pd.concat([kept, new], ignore_index=True))


def write_table(table: pd.DataFrame, file: str | Path) -> None:
    """The table as CSV."""
    table.to_csv(file, index=False, float_format="%.4g", lineterminator="\n")


def middle_half(rows: pd.DataFrame, score: str) -> str:
    """Quartiles of a score's medians over machines and doubts, in words; nothing where it was not run."""
    medians = rows.loc[rows["score"] == score, "median"]
    if medians.empty:
        return ""
    low, high = medians.quantile([0.25, 0.75], interpolation="nearest")
    return f"{low:.2g} to {high:.2g}"


def standings(table: pd.DataFrame) -> pd.DataFrame:
    """Who stands where, in words: rank and errors as intervals of 95 % over seeds, the other scores as quartiles."""
    away = table[table["score"] == "tracking"].groupby("entrant")["median"].agg(lambda x: np.isinf(x).mean())
    whole = table[(table["plant"] == "all") & (table["doubt"] == "all")]
    scores = {name: of.set_index("entrant") for name, of in whole.groupby("score")}
    seen, own_rows = of_seeds(table), table[table["plant"] != "all"].set_index("entrant")
    rows = []
    for name, each in scores["mean error"].sort_values("median", kind="stable").iterrows():
        rank, behind = (scores[score].loc[name] for score in ("rank", "less Kalman"))
        own = ENTRANTS.get(name)
        rows.append(
            {
                "rank": f"{rank['low']:.0f} to {rank['high']:.0f}",
                "observer": name,
                "error": f"{each['low']:.2f} to {each['high']:.2f}",
                "less Kalman": f"{behind['low']:+.2f} to {behind['high']:+.2f}",
                **{shown: middle_half(own_rows.loc[name], score) for shown, score in OTHERS.items()},
                "ran away": f"{100 * away[name]:.0f} %" if name in away else "",
                "seeds": str(seen.loc[name].count()),
                "µs a sample": f"{each['microseconds']:.2g}",
                "bytes": f"{scores['bytes'].loc[name, 'median']:.0f}" if own and "bytes" in scores else "",
                "knobs": str(len(own.knobs)) if own else "",
                "after": own.source if own else "your file",
            }
        )
    found = pd.DataFrame(rows)
    return found.loc[:, (found != "").any()]


def as_markdown(found: pd.DataFrame) -> str:
    """A ranking as a page of the site shows it."""
    lines = [f"| {' | '.join(line)} |" for line in (found.columns, *found.to_numpy())]
    return "\n".join([lines[0], "|" + "---|" * found.shape[1], *lines[1:]])


def hold_contest(
    files: list[str],
    *,
    seeds: int,
    public: str,
    jobs: int | None = None,
    scheduler: str | None = None,
    out: str | None = None,
    **choices,
) -> int:
    """Run the contest and print who stands where; returns 1 when an observer of the reader's was disqualified.

    `choices` are those of `run_contest`. With `only` some of ours, the rows of all others are those that the file
    `out` holds, if it is there.
    """
    began = time.monotonic()
    jobs = min(jobs or cores(), seeds * len(PLANTS))
    alone = processes(jobs) if jobs > 1 else nullcontext()
    with client_of(scheduler) if scheduler else alone as pool:
        executor = pool.get_executor() if scheduler else pool
        scores, disqualified = run_contest(public, seeds, files, executor=executor, **choices)
    table = measured(scores)
    late = choices.get("only") and out and Path(out).exists()
    table = joined(pd.read_csv(out), table) if late else ranked(table)
    print(standings(table).to_string(index=False))
    for name, reason in disqualified.items():
        print(f"{name} is disqualified: {reason}")
    print(
        f"{seeds} seeds a plant from the public number {public}, {len(scores)} scans, "
        f"{time.monotonic() - began:.0f} s. Error: of the flexible states over that of the estimate zero."
    )
    if out:
        write_table(table, out)
    return int(bool(disqualified))


def main() -> None:
    """Write the committed table's ranking into its guide."""
    before, _, rest = GUIDE.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    shown = as_markdown(standings(pd.read_csv(FILE)))
    GUIDE.write_text(f"{before}{BEGIN}\n{shown}\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
