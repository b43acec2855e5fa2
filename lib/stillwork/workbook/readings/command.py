"""``python -m stillwork readings``: run what is missing, keep the results, say how every entry stands."""

import contextlib
import math
import sys
import time
from collections import Counter

from stillwork.base import paths
from stillwork.workbook.claims import load_entries
from stillwork.workbook.lock import held, interrupts, settle
from stillwork.workbook.publish import replace_file
from stillwork.workbook.readings.axes import load_axes
from stillwork.workbook.readings.journal import Journal
from stillwork.workbook.readings.judging import DEPENDS, FAILS, HOLDS, Standing, judge
from stillwork.workbook.readings.results import Outcomes, read_results, results_text
from stillwork.workbook.readings.running import run_readings
from stillwork.workbook.report import screen, table
from stillwork.workbook.workers import client_of, cores, processes

RUNNING = "readings of this checkout are being tried already; wait for them or stop them"


def compute_readings(
    room: str | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    budget_min: float | None = None,
) -> int:
    """Run the readings of a room, or of all; returns the exit code (1: not whole yet, 128 + signal: interrupted).

    Parameters
    ----------
    room : str, optional
    jobs : int, optional
        Processes; by default one a core.
    scheduler : str, optional
        Address of a Dask scheduler whose workers compute.
    budget_min : float, optional
        After so many minutes, of all rooms together, no reading is begun; the next run goes on from there.
    """
    rooms = paths.rooms() if room is None else [paths.require_room(room)]
    end = time.monotonic() + 60 * budget_min if budget_min is not None else math.inf
    whole = True
    settle()
    with held("readings/lock", RUNNING), interrupts() as caught, contextlib.ExitStack() as stack:
        executor, at_once = _executor(stack, jobs, scheduler)
        for each in rooms:
            if not caught:
                whole &= _compute_room(each, executor, at_once, end, lambda: bool(caught))
    return 128 + caught[0] if caught else int(not whole)


def _executor(stack: contextlib.ExitStack, jobs: int | None, scheduler: str | None):
    """What makes an executor, and how many readings to hand out at a time: one waits behind each that runs."""
    if scheduler is None:
        jobs = jobs or cores()
        return (lambda: processes(jobs)), 2 * jobs
    client = stack.enter_context(client_of(scheduler))
    return (lambda: client.get_executor(pure=False)), 2 * max(sum(client.nthreads().values()), 1)


def _compute_room(room: str, executor, at_once: int, end: float, stopped) -> bool:
    axes, multiverses = load_axes(room)
    if not multiverses:
        return True
    folder = paths.root() / "build" / "readings"
    done = run_readings(
        multiverses,
        executor,
        Journal(folder / f"{room}.jsonl"),
        at_once=at_once,
        budget_s=end - time.monotonic(),
        stopped=stopped,
    )
    if len(done) < len(multiverses):
        names = {each.study for each in multiverses} - {each.multiverse.study for each in done}
        print(f"{room}: not whole yet: {', '.join(sorted(names))}; run the same again to go on")
        return False
    # Whatever build or accept runs: neither writes this file, nor makes anything of it.
    replace_file(paths.data(room, "readings.csv"), results_text(done).encode())
    done = read_results(multiverses)  # what is judged is what was written
    standings = judge(done, load_entries(room), axes)
    print(standings_text(room, done, standings, screen()))
    _paint(room, done, standings)
    return True


def standings_text(room: str, studies: list[Outcomes], standings: dict[str, Standing], width: int) -> str:
    """Table of all entries of a room over their readings, what failed, and the counts by class."""
    rows = [("claim", "tried", "agree", "interval", "class", "decided by", "best joint reading")]
    for name, standing in standings.items():
        judged = standing.share is not None
        spread = "{:.2f} .. {:.2f}".format(*standing.interval) if judged else ""
        joint = standing.joint
        best = f"{len(joint.agreeing)} of {len(joint.ours)} in {joint.tried} tried" if joint else ""
        agree = f"{100 * standing.share:.3g} %" if judged else ""
        rows.append(
            (
                name,
                str(standing.tried),
                agree,
                spread,
                standing.class_ or "not judged",
                ", ".join(standing.decided_by),
                best,
            )
        )
    lines = table(rows, width)
    for name, standing in standings.items():
        for axis in standing.undeclared:
            lines.append(f"{name} moves with {axis}, which does not say that it touches it")
    for study in studies:
        for reason, count in Counter(study.failures.values()).most_common():
            lines.append(f"{study.multiverse.study}: {count} readings failed: {reason}")
    counts = Counter(standing.class_ for standing in standings.values())
    classes = ", ".join(f"{counts[name]} {name}" for name in (HOLDS, DEPENDS, FAILS) if counts[name])
    return "\n".join([*lines, "", f"{room}: {classes or 'nothing judged'}"])


def _paint(room: str, studies: list[Outcomes], standings: dict[str, Standing]) -> None:
    from stillwork.workbook.figures import save
    from stillwork.workbook.readings.drawing import paint_room_readings, paint_specification_curve

    folder = paths.root() / "build" / "readings" / room
    if any(standing.class_ for standing in standings.values()):
        save(paint_room_readings(room, standings.values()), folder / "readings")
    for study in studies:
        for name in study.multiverse.entries:
            if standings[name].class_ == DEPENDS:
                save(paint_specification_curve(study, standings[name]), folder / name)
    print(f"pictures: {folder.relative_to(paths.root())}")


def standings_of(room: str) -> dict[str, Standing]:
    """How the entries of a room stand by its committed results, by id; without those whose axes changed since."""
    axes, multiverses = load_axes(room)
    studies = read_results(multiverses)
    known = {each.multiverse.study for each in studies}
    run = paths.data(room, "readings.csv").exists()
    if run and (changed := [each.study for each in multiverses if each.study not in known]):
        print(f"{room}: the axes of {', '.join(changed)} changed: run `make readings`", file=sys.stderr)
    return judge(studies, load_entries(room), axes)
