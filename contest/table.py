"""The contest over all machines, uncertainties and seeds: its command, its table and its results.

``python -m stillwork contest`` holds it; ``python -m contest.table`` writes the leaderboard's page from the committed
tables, and the results beside them.
"""

import hashlib
import json
import platform
import re
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from functools import cache, partial
from pathlib import Path

import numpy as np
import pandas as pd
import scipy

from contest.bench import PERIOD, SAMPLES
from contest.compute import BLOCK, COLUMNS, COUNTED, ROUNDS, compute_standings
from contest.compute import FILE as COMPUTED
from contest.nominal import nominal_of
from contest.plants import PLANTS, plant_of
from contest.ranking import KEYS, block, by_track, critical_difference, mean_ranks, standings
from contest.record import FILE as RECORDED
from contest.record import record_standings, record_table
from contest.runner import UNREACHED, Disqualified, ExternalObserver, declared_knobs
from contest.scores import ENTRANTS, ORACLE, Scan, Scored, contest_trial
from contest.tuning import TUNINGS, scans_of, settings_for, tune, write_development_set
from contest.uncertainties import hidden_seed
from stillwork.base.checks import InputError, pluralise, require_choice, require_count
from workbook import paths
from workbook.progress import Progress
from workbook.workers import client_of, cores, processes

EDITION = 2
SHARED = 4  # seeds of a machine in one task: designs are made once for them
PRACTICE = "practice"  # in a public number's place, where none is given
FILE, PAGE = paths.data("motion", "contest.csv"), paths.root() / "docs" / "leaderboard.md"


def run_contest(
    public: str,
    seeds: int,
    files: Sequence[str | Path] = (),
    *,
    only: Sequence[str] = (),
    plants: Sequence[str] = tuple(PLANTS),
    loops: int | None = None,
    tuned: bool = False,
    executor=None,
) -> tuple[pd.DataFrame, dict[str, str]]:
    """Run our entrants (`only` these and the Kalman filter) and the observers in `files` over `seeds` hidden seeds.

    Returns the table, and why observers were disqualified, by name. Loops are run for the first `loops` of the seeds, by
    default for all. `tuned` sets the knobs that a file declares by the official tuner first. The result does not depend
    on the executor, on its number of workers or on their order.
    """
    for name in only:
        require_choice("only", name, ENTRANTS)
    require_count("loops", loops or 0, at_least=0)
    for file in files:
        ExternalObserver(file)  # an unreadable one is not waited for
    sources = {
        name_of(file): str(file) if name_of(file) == str(file) else str(Path(file).resolve())
        for file in files
    }
    if len(sources) < len(files):
        raise InputError("two files have one name, by which observers are ranked; give one of them another")
    if taken := set(sources) & {*ENTRANTS, ORACLE, *KEYS}:
        raise InputError(f"the name {taken.pop()!r} is taken already; give the file another")
    for name in sources:
        if not re.fullmatch(r"[\w .:()+-]+", name) or not name.strip(" ."):
            raise InputError(f"the name {name!r} would spoil a table; take letters, digits and spaces")
    names = [name for name in ENTRANTS if not only or name in ("Kalman", *only)]
    submit = partial(_now) if executor is None else executor.submit
    # An observer that is out on the first scan is not run on the others.
    trial = scans_of(plants[0], public, 0)[0]
    knobs, reasons = {}, {}
    for name, source in sources.items():
        try:
            knobs[name] = declared_knobs(source)
        except Disqualified as reason:
            reasons[name] = str(reason)
    defaults = {name: tuple(knob.default for knob in some) for name, some in knobs.items()}
    reasons |= contest_trial([(trial, defaults)], sources)[1]
    for name, reason in reasons.items():
        if reason.startswith(UNREACHED):
            raise InputError(f"{name} {reason}; start its program first, or give another tcp:HOST:PORT")
    sources = {name: source for name, source in sources.items() if name not in reasons}
    places = [(plant, name, each) for plant in plants for name in sources for each in range(TUNINGS)]
    chosen = {
        place: submit(tune, place[1], sources[place[1]], knobs[place[1]], place[0], place[2])
        for place in places
        if tuned and knobs[place[1]]
    }
    trials = []
    for first in range(0, require_count("seeds", seeds), SHARED):
        for plant in plants:
            settings = {}
            for seed in range(first, min(first + SHARED, seeds)):
                theirs = {
                    name: tuple(chosen[plant, name, seed % TUNINGS].result())
                    if (plant, name, seed % TUNINGS) in chosen
                    else defaults[name]
                    for name in sources
                }
                settings[seed] = settings_for(plant, seed, names) | {ORACLE: ()} | theirs
            scans = [
                each
                for seed in settings
                for each in scans_of(plant, public, seed)
                if each.track == "estimate" or loops is None or seed < loops
            ]
            # In an order that the hidden seed gives: nothing is learnt from when a scan is run.
            rng = np.random.default_rng(hidden_seed(public, "order", plant, first))
            trials.append([(scans[k], settings[scans[k].seed]) for k in rng.permutation(len(scans))])
    order = np.random.default_rng(hidden_seed(public, "order")).permutation(len(trials))
    # The longest first, so that workers end together; an observer is given its machine anyhow.
    order = sorted(order, key=lambda k: -cost_of([scan for scan, _ in trials[k]]))
    running = (submit(contest_trial, trials[k], sources) for k in order)
    done = []
    with Progress(len(trials), task="contest", unit="machine", tenths=True, to_stderr=True) as progress:
        for future in running if executor is None else list(running):
            done.append(future.result())
            progress.step()
    reasons |= {name: reason for _, out in done for name, reason in out.items()}
    return tabulated([each for found, _ in done for each in found if each.entrant not in reasons]), reasons


def cost_of(scans: Sequence[Scan]) -> int:
    """How long these scans take, roughly, in samples of a loop: those of a record are run at once, ten times as fast."""
    samples = {"estimate": SAMPLES // 10, "loop": SAMPLES, "bandwidth": 6 * PERIOD}
    return sum(samples[scan.track] for scan in scans)


class _Now:
    """What an executor gives for what has been done already."""

    def __init__(self, value):
        self.value = value

    def result(self):
        return self.value


def _now(function, *arguments) -> _Now:
    return _Now(function(*arguments))


def tabulated(scores: Sequence[Scored]) -> pd.DataFrame:
    """A row for each scan and score, a column for each entrant; four digits."""
    rows = [
        (*(score.score, *score.scan[3:4], *score.scan[1:3], score.scan[4]), score.entrant, score.value)
        for score in scores
    ]
    long = pd.DataFrame(rows, columns=[*KEYS, "entrant", "value"])
    wide = long.pivot(index=KEYS, columns="entrant", values="value").reset_index()
    ours = [name for name in (*ENTRANTS, ORACLE) if name in wide]
    others = sorted(set(wide.columns) - {*KEYS, *ours})
    return wide[[*KEYS, *ours, *others]].rename_axis(columns=None).map(_rounded)


def _rounded(value):
    return float(f"{value:.4g}") if isinstance(value, float) else value


def joined(before: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """Two tables in one: other scans, or other entrants on the same ones; the new one counts where both hold the same.

    Times aside, the Kalman filter has to have the same values on the scans that both hold.
    """
    before, new = (each.assign(public=each["public"].astype(str)).set_index(KEYS) for each in (before, new))
    both = before.index.intersection(new.index)
    both = both[both.get_level_values("score") != "microseconds"]
    one, other = (each.loc[both, "Kalman"] for each in (before, new))
    if not np.array_equal(one, other, equal_nan=True):
        raise InputError("the table to join was made by another edition of the contest; make it anew")
    columns = list(dict.fromkeys([*before.columns, *new.columns]))
    return new.combine_first(before)[columns].reset_index()


def write_table(table: pd.DataFrame, file: str | Path, entered: Mapping[str, dict] | None = None) -> None:
    """The table as CSV, and its results as JSON beside it; there stands what was `entered` before, too."""
    table.to_csv(file, index=False, float_format="%.4g", lineterminator="\n")
    beside = Path(file).with_suffix(".json")
    before = json.loads(beside.read_text(encoding="utf-8")).get("entered", {}) if beside.exists() else {}
    text = json.dumps(results(table, before | (entered or {})), indent=1)
    beside.write_text(text + "\n", encoding="utf-8")


def name_of(file: str | Path) -> str:
    """The name under which an observer of this source is ranked."""
    return str(file) if str(file).startswith("tcp:") else Path(file).stem


def entries(files: Sequence[str | Path]) -> dict[str, dict]:
    """What ran under each name: the digest of its file, and whether it was isolated."""
    observers = {name_of(file): ExternalObserver(file) for file in files}
    return {
        name: {
            "sha256": None if observer.remote else hashlib.sha256(observer.content).hexdigest(),
            "isolated": observer.isolated,
        }
        for name, observer in observers.items()
    }


@cache
def digest_of_code() -> str:
    """Of the contest's programs and data, the numbers of its machines among them; the tables are none of it."""
    tables = FILE.name, RECORDED.name, COMPUTED.name, "contest_map.csv"
    data = [each for each in sorted(FILE.parent.glob("contest*.[ct]*")) if each.name not in tables]
    files = [*sorted(Path(__file__).parent.glob("*.py")), *data]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:12]


def digest_of(plant: str) -> str:
    """Of what observers are given of a machine, to nine digits: the same wherever it is built."""
    model, noise = nominal_of(plant_of(plant), 1.0)
    numbers = np.concatenate([np.ravel(each) for each in (*vars(model).values(), *vars(noise).values())])
    text = " ".join(
        f"{each:.9e}" for each in np.where(np.abs(numbers) < 1e-12 * np.abs(numbers).max(), 0.0, numbers)
    )
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def results(table: pd.DataFrame, entered: Mapping[str, dict] | None = None) -> dict:
    """What the leaderboard's page shows, with edition, environment and digests.

    `entered` holds what is known of the observers that are not ours; of whom nothing is known, nothing vouches.
    """
    unknown = {"sha256": None, "isolated": False}
    others = [name for name in table.columns if name not in (*KEYS, *ENTRANTS, ORACLE)]
    ranks, (chance, reach) = (
        mean_ranks(block(table, "flexible")),
        critical_difference(block(table, "flexible")),
    )
    return {
        "edition": EDITION,
        "code": digest_of_code(),
        "public": sorted(map(str, table["public"].unique())),
        "environment": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "system": platform.system(),
            "machine": platform.machine(),
        },
        "entered": {name: (entered or {}).get(name, unknown) for name in others},
        "machines": {name: digest_of(name) for name in PLANTS if (table["plant"] == name).any()},
        "friedman": float(f"{chance:.3g}"),
        "critical difference": round(reach, 2),
        "mean ranks": ranks["rank"].round(2).to_dict(),
        "standings": standings(table).to_dict("records"),
    }


def as_markdown(found: pd.DataFrame) -> str:
    """A ranking as a page of the site shows it."""
    lines = [f"| {' | '.join(line)} |" for line in (found.columns, *found.to_numpy())]
    return "\n".join([lines[0], "|" + "---|" * found.shape[1], *lines[1:]])


def own_record(files: Sequence[str | Path], out: dict[str, str], tuned: bool) -> str:
    """Standings on the measured record of the observers in files, with the yardsticks; `out` gets who is disqualified."""
    sources = {name_of(file): str(file) for file in files if name_of(file) not in out}
    table, reasons = record_table(["zero", "Kalman"], sources, tuned)
    out |= reasons
    return record_standings(table).to_string(index=False)


REMARKS = {
    "Estimate": "Errors of the flexible states over those of the estimate *zero*, whose row has 1 by definition, "
    "none counted beyond 2 in the columns *error*, *rigid-body error* and *minus Kalman*; intervals of 95 % over machines, "
    "tunings and seeds together.",
    "Loop": "*Tracking* and *rejection*: medians over the judged loops, over a cautious loop without an observer; "
    "*bandwidth*: mean over machines, over that which the true states, the *oracle*, allow with the nominal model.",
    "Compute": "Medians over machines, in brackets the least and the largest machine. *Time* is that of the processor over "
    "the Kalman filter's, which took {unit:.2g} µs: all in one process on one core, each in turn with the Kalman filter, "
    "median of {rounds} blocks of {block} samples, designs not counted. *Operations* are counted in a run of the same code "
    "as Python, on {counted} samples of a scan: one for an addition, subtraction, product, quotient, power or elementary "
    "function of real numbers; none for comparisons, signs and whole numbers. Zeros are operated on as the code does it. "
    "*Bytes* is what an observer holds. Of a file or a library operations are not counted: its time is all that its "
    "process takes, over its samples.",
    "Record": "A measured beam: a laser is the truth, which no observer sees. Errors over those of the estimate *zero*, "
    "median and range of six pairs of releases, one that all is fitted to and another that judges; three releases are too "
    "few for an interval. *Linear* are causal filters of the last 25 samples of each signal, one fitted to the training "
    "release, the *oracle* to what is judged: the best that a linear filter of this length can do.",
}


def foreign_compute(shown: pd.DataFrame, entered: Iterable[str]) -> pd.DataFrame:
    """Rows of the compute track for observers that are not ours."""
    times = shown.set_index("observer")["µs a sample"]
    rows = [(name, f"{times[name]} µs", "not counted", "") for name in entered]
    return pd.DataFrame(rows, columns=COLUMNS)


def leaderboard(found: dict, recorded: pd.DataFrame, computed: pd.DataFrame) -> str:
    """The page with every track, of the results of a table."""
    shown = pd.DataFrame(found["standings"])
    late = [name for name in ENTRANTS if name not in shown["observer"].tolist()]
    unit = computed["microseconds"].median()
    remarks = REMARKS | {
        "Compute": REMARKS["Compute"].format(unit=unit, rounds=ROUNDS, block=BLOCK, counted=COUNTED)
    }
    compute = pd.concat([compute_standings(computed), foreign_compute(shown, found["entered"])])
    tracks = {**by_track(shown), "Compute": compute, "Record": record_standings(recorded)}
    lines = [
        "# The leaderboard of the observer benchmark",
        f"Edition {EDITION}, code `{found['code']}`, public numbers {' and '.join(found['public'])}, which are known: an "
        "observer from outside is ranked on a number of a beacon. [The data sheet](contest.md) explains each column, "
        "how to submit, and what the benchmark does not measure. `python -m contest.table` writes this page.",
        f"Friedman's test: {found['friedman']:.1g}; Nemenyi's critical difference of mean ranks at 5 %: "
        f"{found['critical difference']:.1f}. Smaller differences are not significant with thirteen machines.",
    ]
    if late:
        lines.append(f"Not in these tables yet, since they entered after them: {', '.join(late)}.")
    for track, some in tracks.items():
        lines += [f"## {track}", remarks[track], as_markdown(some)]
    return "\n\n".join(lines) + "\n"


def hold_contest(
    files: list[str],
    *,
    seeds: int,
    hidden: bool = False,
    dev: str | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    out: str | None = None,
    **choices,
) -> int:
    """Run the contest and print who stands where; returns 1 when an observer of the reader's was disqualified.

    `choices` are those of `run_contest`. `hidden` reads the public number from standard input: no process that an
    observer might see has it on its command line. The rows that the file `out` holds already are kept.
    """
    if dev:
        write_development_set(dev)
        print(f"the development set, with its truth, is in {dev}")
        return 0
    began, public = time.monotonic(), sys.stdin.readline().strip() if hidden else PRACTICE
    if not public:
        raise InputError(
            "hidden finds no public number on standard input; give one: echo NUMBER | ... --hidden"
        )
    jobs = min(jobs or cores(), -(-seeds // SHARED) * len(PLANTS))
    alone = processes(jobs) if jobs > 1 else nullcontext()
    with client_of(scheduler) if scheduler else alone as pool:
        executor = pool.get_executor() if scheduler else pool
        table, disqualified = run_contest(public, seeds, files, executor=executor, **choices)
    if out and Path(out).exists():
        table = joined(pd.read_csv(out), table)
    print(standings(table).to_string(index=False))
    if files:
        print(f"\nOn the measured beam:\n{own_record(files, disqualified, choices.get('tuned', False))}\n")
    for name, reason in disqualified.items():
        print(f"{name} is disqualified: {reason}")
    entered = entries(files)
    for name, entry in entered.items():
        if not entry["isolated"]:
            print(f"{name}: not isolated")
    per_machine = f"{pluralise(seeds, 'seed')} per machine"
    print(f"edition {EDITION}, {per_machine}, {time.monotonic() - began:.0f} s")
    if out:
        write_table(table, out, entered)
    return int(bool(disqualified))


def main() -> None:
    """Write the leaderboard and the results from the committed tables."""
    table = pd.read_csv(FILE)
    write_table(table, FILE)
    found = json.loads(FILE.with_suffix(".json").read_text(encoding="utf-8"))
    page = leaderboard(found, pd.read_csv(RECORDED), pd.read_csv(COMPUTED))
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
