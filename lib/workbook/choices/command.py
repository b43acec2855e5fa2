"""``python -m workbook choices``: run what is missing, keep the results, report the robustness of every entry."""

import contextlib
import math
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

from workbook import paths
from workbook.checks import InputError, require_choice
from workbook.choices.axes import Axis, Multiverse, load_axes
from workbook.choices.checking import (
    age,
    drawn,
    forget,
    has_moved,
    is_older,
    moved_before,
    moves,
    note,
    parts_a_day,
    short_form_differs,
    today,
)
from workbook.choices.judging import Robustness, judge
from workbook.choices.results import Outcomes, read_results, results_text
from workbook.choices.running import Journal, calls_of, compute, design, run_combinations
from workbook.claims import Claim, ledger, load_entries
from workbook.lock import held, interrupts
from workbook.publish import replace_file
from workbook.report import screen, table
from workbook.workers import client_of, cores, processes

# Parts a day of `checking.DAYS`, at least, that decide whether a study is computed again: those of CI.
SAMPLED = 4
SHOWN = 3  # of the values that moved

RUNNING = "combinations of this checkout are being tried already; wait for them or stop them"


def compute_choices(
    topic: str | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    budget_min: float | None = None,
    changed: bool = False,
    study: str | None = None,
    short: bool = False,
) -> int:
    """Run the combinations of a topic, or of all; returns the exit code (1: not whole yet, 128 + signal: interrupted).

    Parameters
    ----------
    topic : str, optional
    jobs : int, optional
        Processes; by default one per core.
    scheduler : str, optional
        Address of a Dask scheduler whose workers compute.
    budget_min : float, optional
        No combination is started after this many minutes, for all topics together; the next run continues.
    changed : bool
        Only studies of which a sampled value moved, those whose axes changed, and those that never ran.
    study : str, optional
        Only this study of the topic, all of it, regardless of earlier results.
    short : bool
        Only compare the study's short form with its full form at every option; returns 1 if a verdict differs.
    """
    if short and study is None:
        raise InputError("short compares the forms of one study; name it: choices TOPIC --study NAME --short")
    if study is not None:
        if topic is None:
            raise InputError("study needs its topic; name it before: choices TOPIC --study NAME")
        require_choice("study", study, [one.study for one in load_axes(paths.require_topic(topic))[1]])
    if short:
        (multiverse,) = [each for each in load_axes(topic)[1] if each.study == study]
        if not multiverse.lean:
            raise InputError(f"study {study} has no short form; leave out --short")
        lines = short_form_differs(multiverse, load_entries(topic), compute)
        print("\n".join(lines or [f"{study}: the same verdicts by the short form at every option"]))
        return int(bool(lines))
    topics = paths.topics() if topic is None else [paths.require_topic(topic)]
    end = time.monotonic() + 60 * budget_min if budget_min is not None else math.inf
    whole = True
    with held("choices/lock", RUNNING), interrupts() as caught, contextlib.ExitStack() as stack:
        executor, at_once = _executor(stack, jobs, scheduler)
        for each in topics:
            if not caught:
                whole &= _compute_topic(each, executor, at_once, end, lambda: bool(caught), changed, study)
    return 128 + caught[0] if caught else int(not whole)


def _executor(stack: contextlib.ExitStack, jobs: int | None, scheduler: str | None):
    """What makes an executor, and how many combinations to submit at a time: one waits behind each that runs."""
    if scheduler is None:
        jobs = jobs or cores()
        return (lambda: processes(jobs)), 2 * jobs
    client = stack.enter_context(client_of(scheduler))
    return (lambda: client.get_executor(pure=False)), 2 * max(sum(client.nthreads().values()), 1)


def _compute_topic(topic: str, executor, at_once: int, end: float, stopped, changed: bool, study) -> bool:
    axes, multiverses = load_axes(topic)
    if not multiverses:
        return True
    folder = paths.root() / "build" / "choices"
    journal = Journal(folder / f"{topic}.jsonl")

    def run(wanted: list[Multiverse], runs_of) -> list[Outcomes]:
        budget_s = end - time.monotonic()
        return run_combinations(
            wanted, executor, journal, at_once=at_once, budget_s=budget_s, stopped=stopped, runs_of=runs_of
        )

    if study is not None:
        kept = [outcomes for outcomes in read_results(multiverses) if outcomes.multiverse.study != study]
        for call in calls_of(
            next(multiverse for multiverse in multiverses if multiverse.study == study)
        ).values():
            journal.found.pop(call.key, None)
    else:
        kept = _unmoved(topic, multiverses, run, journal) if changed else []
    names = {each.multiverse.study for each in kept}
    others = [each for each in multiverses if each.study not in names]
    done = kept + run(others, calls_of)
    if len(done) < len(multiverses):
        names = {each.study for each in multiverses} - {each.multiverse.study for each in done}
        print(
            f"{topic}: not complete yet: {', '.join(sorted(names))}; run the same command again to continue"
        )
        return False
    done.sort(key=lambda each: multiverses.index(each.multiverse))
    # Safe while a build or accept runs: neither writes or reads this file.
    replace_file(paths.data(topic, "choices.csv"), results_text(done).encode())
    for each in others:
        forget(each)
    done = read_results(multiverses)  # what is judged is what was written
    standings = _judged(topic, done, axes, ledger(topic=topic))
    print(standings_text(topic, done, standings, screen()))
    print("the site shows every entry over its combinations")
    return True


def _unmoved(topic: str, multiverses: list[Multiverse], run, journal: Journal) -> list[Outcomes]:
    """Committed results that the code as it is gave, or that came out again in a sample of today's."""
    entries, day, parts = load_entries(topic), today(), max(parts_a_day(), SAMPLED)
    committed = {outcomes.multiverse.study: outcomes for outcomes in read_results(multiverses)}
    kept, older = [], []
    for each in committed.values():
        if each.design != design(each.multiverse):
            continue
        if not has_moved(each.multiverse):
            (older if is_older(each) else kept).append(each)
        elif not is_older(each):
            # Not the code changed but the system it runs on: earlier results do not count.
            for call in calls_of(each.multiverse).values():
                journal.found.pop(call.key, None)

    def sample(multiverse: Multiverse) -> dict:
        runs = calls_of(multiverse)
        again = [at for at in moved_before(multiverse) if at in runs]
        return {at: runs[at] for at in (*drawn(multiverse, runs, day, parts), *again)}

    for now in run([each.multiverse for each in older], sample):
        multiverse = now.multiverse
        before, tried = committed[multiverse.study], list(sample(multiverse))
        moved = moves(before, now, tried, entries)
        note(multiverse, [at for at in tried if moves(before, now, [at], entries)])
        if moved:
            more = f" (and {len(moved) - SHOWN} more)" if len(moved) > SHOWN else ""
            print("\n".join(moved[:SHOWN]) + more)
        else:
            kept.append(before)
            print(f"{multiverse.study}: as before in {len(tried)} of {before.failed.size} combinations, kept")
    return kept


def standings_text(topic: str, studies: list[Outcomes], standings: dict[str, Robustness], width: int) -> str:
    """Table of all entries of a topic over their combinations, and what failed."""
    rows = [("claim", "tried", "agree", "interval", "decided by")]
    for name, standing in standings.items():
        judged = standing.share is not None
        spread = "{:.2f} .. {:.2f}".format(*standing.interval) if judged else ""
        agree = f"{100 * standing.share:.3g} %" if judged else "not judged"
        rows.append(
            (
                name,
                str(standing.tried),
                agree,
                spread,
                ", ".join(standing.decided_by),
            )
        )
    lines = table(rows, width)
    for name, standing in standings.items():
        for axis in standing.undeclared:
            lines.append(f"{name} moves with {axis}, which is not declared to touch it")
    for name, standing in standings.items():
        if standing.differs:
            lines.append(
                f"{name} at the default: {standing.differs}, with another verdict; that of the ledger counts"
            )
    for study in studies:
        for reason, count in Counter(study.failures.values()).most_common():
            lines.append(f"{study.multiverse.study}: {count} combinations failed: {reason}")
    return "\n".join(lines)


def judged_ledger(topic: str | None = None, figures: Path | None = None, notes: bool = False) -> list[Claim]:
    """The ledger with what every verdict needs: of each entry how it fares over its combinations, as committed.

    Parameters
    ----------
    topic : str, optional
        Only this topic.
    figures : Path, optional
        Folder of built figures; by default the workbook's own.
    notes : bool
        Note what older code has computed, too, which takes longer.
    """
    claims = ledger(figures, topic)
    topics = dict.fromkeys(claim.entry.topic for claim in claims)
    over = {name: one for each in topics for name, one in robustness_of(each, claims, notes).items()}
    return [replace(claim, over=over.get(claim.entry.id)) for claim in claims]


def _judged(topic: str, studies: list[Outcomes], axes: dict[str, Axis], claims) -> dict[str, Robustness]:
    by_id = {claim.entry.id: claim for claim in claims}
    return judge(studies, load_entries(topic), axes, by_id)


def robustness_of(topic: str, claims: list[Claim] | None = None, notes: bool = True) -> dict[str, Robustness]:
    """How the entries of a topic stand by its committed results, by id; without those whose axes changed since."""
    axes, multiverses = load_axes(topic)
    studies = read_results(multiverses)
    known = {study.multiverse.study for study in studies}
    run = paths.data(topic, "choices.csv").exists()
    if run and (changed := [multiverse.study for multiverse in multiverses if multiverse.study not in known]):
        print(f"{topic}: the axes of {', '.join(changed)} changed: run `make choices`", file=sys.stderr)
    standings = _judged(topic, studies, axes, claims or ledger(topic=topic))
    if not notes:
        return standings
    ages = {entry: age(each) for each in studies for entry in each.multiverse.entries}
    return {name: replace(standing, age=ages[name]) for name, standing in standings.items()}
