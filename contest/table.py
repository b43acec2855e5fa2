"""The contest over all machines, uncertainties and seeds: the command for your observer, the table, the leaderboard.

``python -m stillwork contest`` runs files beside the committed table; ``python -m contest.table`` writes the leaderboard's
page from the committed tables, ``python -m contest.table again`` makes the table of ours anew first.
"""

import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import pandas as pd

from contest.compute import BLOCK, ROUNDS, compute_standings
from contest.compute import FILE as COMPUTED
from contest.plants import PLANTS
from contest.ranking import KEYS, block, by_track, critical_difference, standings
from contest.record import COLUMNS, file_rows, record_standings
from contest.record import FILE as RECORDED
from contest.runner import Disqualified, checked_file, knobs_of, running
from contest.scores import ENTRANTS, ORACLE, Scan, rows_of, scores_of
from contest.tuning import TUNINGS, capped_mean, scans_of, settings_for, tune
from stillwork.base.checks import InputError, pluralise, require_choice
from workbook import paths
from workbook.workers import cores, processes

EDITION = 2
PUBLICS, SEEDS = ("20180628", "31415926"), 2  # of the committed table
FILE, PAGE = paths.data("motion", "contest.csv"), paths.root() / "docs" / "leaderboard.md"


def tabulated(rows: Iterable[tuple]) -> pd.DataFrame:
    """A row for each scan and score, a column for each entrant, of the rows that `rows_of` gives; four digits."""
    long = pd.DataFrame(rows, columns=[*KEYS, "entrant", "value"])
    long["value"] = [float(f"{value:.4g}") for value in long["value"]]
    return long.pivot(index=KEYS, columns="entrant", values="value").rename_axis(columns=None)


def own_table(public: str, seeds: int, plants: Sequence[str], submit: Callable) -> pd.DataFrame:
    """The table of our entrants: ``submit(function, *arguments)`` gives a future for each machine and seed."""
    futures = [
        submit(rows_of, settings_for(plant, seed) | {ORACLE: ()}, scans_of(plant, public, seed))
        for plant in plants
        for seed in range(seeds)
    ]
    table = tabulated(row for future in futures for row in future.result())
    return table[[*ENTRANTS, ORACLE]].reset_index()


def written_table() -> pd.DataFrame:
    """The committed table, public numbers as text."""
    return pd.read_csv(FILE, dtype={"public": str})


def run_file(
    name: str, file: str, machines: Sequence[str], every: bool, tuned: bool, table: pd.DataFrame
) -> tuple[pd.Series, pd.DataFrame]:
    """Scores of a file's observer on the scans of the table, and on the measured record where `every` is given.

    Without `every`, on the estimates of the first public number's first seed. Its error is printed machine by machine.
    """
    publics, seeds = (PUBLICS, range(SEEDS)) if every else (PUBLICS[:1], range(1))
    rows, recorded = [], []
    with running(file) as call:
        try:
            knobs = call(knobs_of, file)
        except Disqualified as reason:
            raise InputError(f"{file} {reason}; correct it") from None
        settings = dict.fromkeys(range(TUNINGS), tuple(knob.default for knob in knobs))
        for plant in machines:
            if tuned and knobs:
                settings = {k: call(tune, name, file, knobs, plant, k, scans=40) for k in settings}
            scans = [scan for public in publics for k in seeds for scan in scans_of(plant, public, k)]
            scans = [scan for scan in scans if every or scan.track == "estimate"]
            for scan in scans:
                scores = call(scores_of, name, file, scan, settings[scan.seed % TUNINGS])
                rows += [(score, *scan_key(scan), name, value) for score, value in scores.items()]
            print(on_machine(tabulated(rows)[name], table, plant), file=sys.stderr, flush=True)
        if every:
            recorded = call(file_rows, name, file, knobs, tuned, scans=12)
    return tabulated(rows)[name], pd.DataFrame(recorded, columns=COLUMNS)


def scan_key(scan: Scan) -> tuple:
    """Of a scan's rows in the table."""
    return scan.public, scan.plant, scan.uncertainty, scan.seed


def on_machine(found: pd.Series, table: pd.DataFrame, plant: str) -> str:
    """A line of progress: the mean error on a machine, as the ranking counts it, and the Kalman filter's on the same scans."""
    own = found.xs("flexible").xs(plant, level="plant", drop_level=False)
    others = table[table["score"] == "flexible"].set_index(KEYS[1:]).loc[own.index]
    return f"{plant}: error {capped_mean(own):.2f}, Kalman {capped_mean(others['Kalman']):.2f}"


def as_markdown(found: pd.DataFrame) -> str:
    """A ranking as a page of the site shows it."""
    lines = [f"| {' | '.join(line)} |" for line in (found.columns, *found.to_numpy())]
    return "\n".join([lines[0], "|" + "---|" * found.shape[1], *lines[1:]])


REMARKS = {
    "Estimate": "Errors of the flexible states over those of the estimate *zero*, whose row has 1 by definition, "
    "none counted beyond 2 in the columns *error*, *rigid-body error* and *minus Kalman*; intervals of 95 % over machines, "
    "tunings and seeds together.",
    "Loop": "*Tracking* and *rejection*: medians over the judged loops, over a cautious loop without an observer; "
    "*bandwidth*: mean over machines, over that which the true states, the *oracle*, allow with the nominal model.",
    "Compute": "Time of the processor over the Kalman filter's, which took {unit:.2g} µs a sample: all in one process on one "
    "core, each in turn with the Kalman filter, median of {rounds} blocks of {block} samples, designs not counted; medians "
    "over machines, in brackets the least and the largest machine.",
    "Record": "A measured beam: a laser is the truth, which no observer sees. Errors over those of the estimate *zero*, "
    "median and range of six pairs of releases, one that all is fitted to and another that judges; three releases are too "
    "few for an interval. *Linear* are causal filters of the last 25 samples of each signal, one fitted to the training "
    "release, the *oracle* to what is judged: the best that a linear filter of this length can do.",
}


def leaderboard(table: pd.DataFrame, recorded: pd.DataFrame, computed: pd.DataFrame) -> str:
    """The page with every track."""
    chance, reach = critical_difference(block(table, "flexible"))
    unit = computed["microseconds"].median()
    remarks = REMARKS | {"Compute": REMARKS["Compute"].format(unit=unit, rounds=ROUNDS, block=BLOCK)}
    tracks = by_track(standings(table))
    tracks |= {"Compute": compute_standings(computed), "Record": record_standings(recorded)}
    lines = [
        "# The leaderboard of the observer benchmark",
        f"Edition {EDITION}, public numbers {' and '.join(table['public'].unique())}. "
        "[The data sheet](contest.md) explains each column, how to run your own observer, and what the benchmark does not "
        "measure. `python -m contest.table` writes this page.",
        f"Friedman's test: {chance:.1g}; Nemenyi's critical difference of mean ranks at 5 %: "
        f"{reach:.1f}. Smaller differences are not significant with thirteen machines.",
    ]
    for track, some in tracks.items():
        lines += [f"## {track}", remarks[track], as_markdown(some)]
    return "\n\n".join(lines) + "\n"


def hold_contest(
    files: Sequence[str],
    *,
    machine: Sequence[str] = (),
    all: bool = False,
    tuned: bool = False,
    verbose: bool = False,
    out: str | None = None,
) -> int:
    """Run the observers in `files` and print where they stand in the committed table, with `verbose` that table, too.

    Without files the committed table is printed. Returns 1 when one was disqualified. `tuned` sets the knobs that a file
    declares by the official tuner first; `out` is written with the table and a column for each file.
    """
    for name in machine:
        require_choice("machine", name, PLANTS)
    checked = {Path(file).stem: checked_file(file) for file in files}
    if len(checked) < len(files):
        raise InputError("two files have one name, by which observers are ranked; give one of them another")
    if taken := set(checked) & {*ENTRANTS, ORACLE, *KEYS}:
        raise InputError(f"the name {taken.pop()!r} is taken already; give the file another")
    began, table, recorded = time.monotonic(), written_table(), pd.read_csv(RECORDED)
    joined, disqualified = table.set_index(KEYS), {}
    for name, file in checked.items():
        print(f"{name}: runs with your rights, as python would run it", file=sys.stderr, flush=True)
        try:
            found, own = run_file(name, file, machine or tuple(PLANTS), all, tuned, table)
        except Disqualified as reason:
            disqualified[name] = reason
        else:
            joined, recorded = joined.join(found, how="inner"), pd.concat([recorded, own])
    joined = joined.reset_index()
    ranked = standings(joined)
    for line in answers(
        ranked, [name for name in checked if name not in disqualified] or list(ranked["observer"][:1])
    ):
        print(line)
    if verbose or not files:
        print(ranked.to_string(index=False))
    if all and (verbose or not files):
        print(f"\nOn the measured beam:\n{record_standings(recorded).to_string(index=False)}")
    for name, reason in disqualified.items():
        print(f"{name} is disqualified: {reason}")
    scans = joined[KEYS[1:]].drop_duplicates()
    rest = "" if verbose or not files else "; --verbose prints the table, docs/leaderboard.md explains it"
    print(f"edition {EDITION}, {pluralise(len(scans), 'scan')}, {time.monotonic() - began:.0f} s{rest}")
    if out:
        joined.to_csv(out, index=False, float_format="%.4g", lineterminator="\n")
    return int(bool(disqualified))


def answers(ranked: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """A line for each observer in `names`: its place among all, and its error beside the Kalman filter's."""
    own, (first, *_) = ranked.set_index("observer"), ranked["observer"]
    order = list(own.index)
    return [
        f"{name}: place {order.index(name) + 1} of {len(order)} by mean rank {own['mean rank'][name]}; "
        f"error {own['error'][name]}, Kalman {own['error']['Kalman']}, best: {first} {own['error'][first]}"
        for name in names
    ]


def main(again: bool) -> None:
    """Write the leaderboard's page, after the table where that is to be made `again`."""
    if again:
        with processes(cores()) as pool:
            tables = [own_table(public, SEEDS, tuple(PLANTS), pool.submit) for public in PUBLICS]
        pd.concat(tables).sort_values(KEYS).to_csv(
            FILE, index=False, float_format="%.4g", lineterminator="\n"
        )
    page = leaderboard(written_table(), pd.read_csv(RECORDED), pd.read_csv(COMPUTED))
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:] == ["again"])
