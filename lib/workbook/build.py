"""The build: stale notebooks in many kernels at once, one writer of their results."""

import contextlib
import math
import os
import uuid
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

from workbook import paths
from workbook.dependencies import look_again
from workbook.execution import Failure, Job, Outcome, execute
from workbook.inputs import changes, claimed_inputs, ledger_inputs, notebook_inputs
from workbook.kernels import stop, warmed
from workbook.lock import exclusive_lock, interrupts
from workbook.progress import Progress
from workbook.provenance import commit, modified, provenance
from workbook.publish import read_record, replace_record, tidy
from workbook.tasks import Task, built, durations, tasks
from workbook.workers import client_of, cores

# Warming a process costs about as much as the imports of this many notebooks.
WARM_FROM = 3


def build_figures(
    *targets: str,
    settings: dict[str, str] | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    force: bool = False,
    why: bool = False,
) -> int:
    """Build what is stale; returns the exit code (0 good, 1 something failed, 128 + signal when interrupted).

    Parameters
    ----------
    *targets : str
        ``topic`` or ``topic/nn-result``; by default the whole workbook.
    settings : dict of str to str, optional
        Parameters as typed.
    jobs : int, optional
        Kernels at once; by default one per core.
    scheduler : str, optional
        Address of a Dask scheduler whose workers execute the notebooks.
    force : bool
        Build what is fresh, too.
    why : bool
        Only list what would be built, and why.
    """
    wanted = tasks(*targets, settings=settings)
    if why:
        for task in wanted:
            print(f"{task.label}: {'; '.join(task.reasons()) or 'up to date'}")
        return 0
    with exclusive_lock():
        for task in wanted:
            tidy(task.target)
        stale = [(task, reasons) for task in wanted if (reasons := task.reasons() or ["forced"] * force)]
        fresh = len(wanted) - len(stale)
        if not stale:
            place = os.path.relpath(built(), paths.root())
            print(f"nothing to do: {fresh} up to date" + f" in {place}/" * (not settings))
            if settings:
                _print_summary(wanted)
            return 0
        warm = len(stale) >= WARM_FROM
        workers = _cluster(scheduler) if scheduler else _threads(jobs or cores(), warm)
        with workers as (submit, halt):
            failures, caught = _build(stale, submit, halt)
    code = _close(failures, len(stale), fresh, caught)
    if not caught:
        good = [task for task in wanted if task not in [failed for failed, _ in failures]]
        (_print_summary if settings else _compare)(good)
    return code


def _build(stale: list[tuple[Task, list[str]]], submit: Callable, halt: Callable):
    """Run the stale tasks; returns the failures and the signals that came."""
    made_from = commit(), modified()
    ledger = {name: value for topic in paths.topics() for name, value in ledger_inputs(topic).items()}
    build = uuid.uuid4().hex
    failures: list[tuple[Task, Failure]] = []
    running = {}
    with interrupts() as caught, Progress(sum(task.cells for task, _ in stale)) as progress:
        for task, reasons in longest_first(stale):
            progress.print_line(f"build {task.label}: {_short(reasons)}")
            job = Job(build, task.notebook.name, task.notebook.source, task.settings)
            running[submit(job, task, progress)] = task
        while running and not caught:
            done, _ = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                outcome = _outcome(future)
                failure = outcome.failure or _publish(task, outcome, made_from, ledger)
                so_far = f"{len(stale) - len(running)} of {len(stale)}{progress.left() if running else ''}"
                if failure:
                    failures.append((task, failure))
                    told = [f"FAILED {task.label} ({so_far})", failure.traceback]
                    progress.print_line("\n".join(filter(None, told)))
                else:
                    progress.print_line(f"built {task.label} in {outcome.seconds:.0f} s ({so_far})")
        if caught:
            started = [future for future in running if not future.cancel()]
            halt(build)
            wait(started)
            failures += [(task, Failure("", "interrupted")) for task in running.values()]
    return failures, caught


def longest_first(stale: list[tuple[Task, list[str]]]) -> list[tuple[Task, list[str]]]:
    """Those that took longest first, before them those of unknown duration."""
    known = durations()
    return sorted(stale, key=lambda each: -known.get(each[0].notebook.name, math.inf))


def _outcome(future: Future) -> Outcome:
    try:
        return future.result()
    except Exception as error:  # a lost worker, a full disk under /tmp: the others go on
        return Outcome(failure=Failure("", f"{type(error).__name__}: {error}"))


def _publish(task: Task, outcome: Outcome, made_from, ledger: dict[str, str]) -> Failure | None:
    """Put the results in their place, unless what they depend on changed since the build began."""
    try:
        claimed = claimed_inputs(outcome.claimed())
        inputs = {**claimed, **task.inputs}
        look_again()
        now = {**claimed, **notebook_inputs(task.notebook, task.settings)}
        if different := changes({**{name: ledger.get(name, "") for name in claimed}, **task.inputs}, now):
            return Failure("inputs", f"changed while it was built: {_short(different)}; build again")
        record = provenance(task.notebook, task.settings, inputs, outcome.software, made_from)
        files = {**outcome.files, "provenance.json": record, task.executed.name: outcome.executed}
        replace_record(task.target, files, inputs, outcome.seconds)
    except OSError as error:
        return Failure("writing the results", str(error))
    return None


def _close(failures: list[tuple[Task, Failure]], stale: int, fresh: int, caught: list[int]) -> int:
    print(f"{stale - len(failures)} built, {len(failures)} failed, {fresh} up to date")
    if failures:
        rows = [(task.label, failure.where, failure.error) for task, failure in failures]
        widths = [max(len(row[i]) for row in rows) for i in range(2)]
        for label, where, error in rows:
            print(f"  {label:{widths[0]}}  {where:{widths[1]}}  {error}")
        if kept := sum(task.target.is_dir() for task, _ in failures):
            some = "" if kept == len(failures) else f"{kept} of "
            print(f"the last good results of {some}these stand untouched")
    return 128 + caught[0] if caught else int(bool(failures))


def _compare(wanted: list[Task]) -> None:
    """Report how the results agree with the committed ones, and where they are."""
    from workbook.compare import compare, summary

    # Nothing of a new notebook can have moved.
    accepted = [task for task in wanted if task.committed.is_dir()]
    whole = [task for task in accepted if (found := read_record(task.target)) and not found[1]]
    if whole:
        for line in summary([compare(task) for task in whole]):
            print(line)


def _print_summary(variants: list[Task]) -> None:
    """Report where variants are and how their settings differ from the notebook's."""
    from workbook.variants import difference

    for task in variants:
        print("\n".join(difference(task)))


@contextlib.contextmanager
def _threads(jobs: int, warm: bool):
    with warmed(warm) as forks, ThreadPoolExecutor(jobs) as pool:
        yield (lambda job, task, progress: pool.submit(execute, job, progress.step, forks)), stop


@contextlib.contextmanager
def _cluster(address: str):
    with client_of(address) as client, client.get_executor(pure=False) as executor:

        def submit(job, task, progress):
            future = executor.submit(execute_elsewhere, job, task)
            future.add_done_callback(lambda _: progress.step(task.cells))
            return future

        yield submit, lambda build: client.run(stop, build)


def execute_elsewhere(job: Job, task: Task) -> Outcome:
    """`execute` on a worker, once its checkout, Python, packages and settings have been seen to be the driver's."""
    look_again()
    if different := changes(task.inputs, notebook_inputs(task.notebook, task.settings)):
        return Outcome(
            failure=Failure("worker", f"what the notebook depends on differs there: {_short(different)}")
        )
    return execute(job)


def _short(reasons: list[str]) -> str:
    return "; ".join(reasons[:3]) + (f" and {len(reasons) - 3} more" if len(reasons) > 3 else "")
