"""The build: stale notebooks in many kernels at once, one writer of their results."""

import contextlib
import json
import uuid
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait

from stillwork.workbook import publish
from stillwork.workbook.execution import Failure, Job, Outcome, execute, sweep
from stillwork.workbook.inputs import NOTEBOOKS_OWN, changes, digest, room_inputs
from stillwork.workbook.jupyter_kernel import stop
from stillwork.workbook.progress import Progress
from stillwork.workbook.provenance import commit, modified, provenance
from stillwork.workbook.tasks import Task, tasks
from stillwork.workbook.workers import alone, client_of, cores, noted_signals


def build_figures(
    target: str | None = None,
    settings: dict[str, str] | None = None,
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    force: bool = False,
    why: bool = False,
) -> int:
    """Build what is stale; returns the exit code (0 good, 1 something failed, 128 + signal when interrupted).

    Parameters
    ----------
    target : str, optional
        ``room`` or ``room/nn-result``; by default the whole workbook.
    settings : dict of str to str, optional
        Parameters as typed.
    jobs : int, optional
        Kernels at once; by default one a core.
    scheduler : str, optional
        Address of a Dask scheduler whose workers execute the notebooks.
    force : bool
        Build what is fresh, too.
    why : bool
        Only say what would be built, and why.
    """
    wanted = tasks(target, settings)
    if why:
        for task in wanted:
            print(f"{task.label}: {'; '.join(task.reasons()) or 'up to date'}")
        return 0
    with alone():
        for task in wanted:
            publish.recover(task.target)
        stale = [(task, reasons) for task in wanted if (reasons := task.reasons() or ["forced"] * force)]
        fresh = len(wanted) - len(stale)
        if not stale:
            print(f"nothing to do: {fresh} up to date")
            return 0
        sweep()
        workers = _cluster(scheduler) if scheduler else _threads(jobs or cores())
        with workers as (submit, halt):
            failures, caught = _build(stale, submit, halt)
    return _close(failures, len(stale), fresh, caught)


def _build(stale: list[tuple[Task, list[str]]], submit: Callable, halt: Callable):
    """Run the stale tasks; returns the failures and the signals that came."""
    made_from = commit(), modified()
    build = uuid.uuid4().hex
    failures: list[tuple[Task, Failure]] = []
    running = {}
    with noted_signals() as caught, Progress(sum(task.cells for task, _ in stale)) as progress:
        for task, reasons in stale:
            progress.say(f"build {task.label}: {_short(reasons)}")
            job = Job(build, task.notebook.name, task.notebook.source, task.settings)
            running[submit(job, task, progress)] = task
        while running and not caught:
            done, _ = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                outcome = _outcome(future)
                failure = outcome.failure or _publish(task, outcome, made_from)
                if failure:
                    failures.append((task, failure))
                    progress.say("\n".join(filter(None, [f"FAILED {task.label}", failure.traceback])))
                else:
                    progress.say(f"built {task.label} in {outcome.seconds:.0f} s")
        if caught:
            started = [future for future in running if not future.cancel()]
            halt(build)
            wait(started)
            failures += [(task, Failure("", "interrupted")) for task in running.values()]
    return failures, caught


def _outcome(future: Future) -> Outcome:
    try:
        return future.result()
    except Exception as error:  # a lost worker, a full disk under /tmp: the others go on
        return Outcome(failure=Failure("", f"{type(error).__name__}: {error}"))


def _publish(task: Task, outcome: Outcome, made_from) -> Failure | None:
    record = provenance(task.notebook, task.settings, task.inputs, outcome.software, made_from)
    files = {**outcome.files, "provenance.json": record}
    if task.settings:
        files[task.executed.name] = outcome.executed
    try:
        if not task.settings:
            publish.replace_file(task.executed, outcome.executed)
        publish.replace_folder(task.target, files)  # after all that may fail before it
        outputs = {name: digest(content) for name, content in files.items()}
        state = json.dumps({"inputs": task.inputs, "outputs": outputs}, indent=1)
        publish.replace_file(task.state, state.encode())
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
        print("the last good results of these stand untouched")
    return 128 + caught[0] if caught else int(bool(failures))


@contextlib.contextmanager
def _threads(jobs: int):
    with ThreadPoolExecutor(jobs) as pool:
        yield (lambda job, task, progress: pool.submit(execute, job, progress.step)), stop


@contextlib.contextmanager
def _cluster(address: str):
    with client_of(address) as client, client.get_executor(pure=False) as executor:

        def submit(job, task, progress):
            future = executor.submit(execute_elsewhere, job, task.inputs)
            future.add_done_callback(lambda _: progress.step(task.cells))
            return future

        yield submit, lambda build: client.run(stop, build)


def execute_elsewhere(job: Job, inputs: dict[str, str]) -> Outcome:
    """`execute` on a worker, once its checkout and its Python have been seen to be the driver's."""
    here = room_inputs(job.notebook.partition("/")[0])
    expected = {name: inputs[name] for name in inputs if name in here or not name.startswith(NOTEBOOKS_OWN)}
    if different := changes(expected, here):
        return Outcome(failure=Failure("worker", f"its checkout differs: {_short(different)}"))
    return execute(job)


def _short(reasons: list[str]) -> str:
    return "; ".join(reasons[:3]) + (f" and {len(reasons) - 3} more" if len(reasons) > 3 else "")
