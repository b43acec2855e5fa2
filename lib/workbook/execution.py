"""One notebook in one kernel: from its source to the bytes of its results.

`execute` writes nothing that outlives it and returns plain values, so it runs alike in a thread and on a
worker of a cluster. The caller publishes the results.
"""

import contextlib
import json
import logging
import platform
import re
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib import metadata
from pathlib import Path

from workbook import paths
from workbook.checks import one_line
from workbook.kernels import kernel_manager


@dataclass(frozen=True)
class Job:
    """What to execute.

    Attributes
    ----------
    build : str
        The build that runs it; `stop` ends all its kernels.
    notebook, source : str
        Name ``topic/nn-result`` and the file's text.
    settings : dict
        Parameters that differ from the published settings.
    """

    build: str
    notebook: str
    source: str
    settings: dict[str, object]


@dataclass(frozen=True)
class Failure:
    """Where and why a notebook failed."""

    where: str
    error: str
    traceback: str = ""

    def __post_init__(self):
        # What a notebook raises may quote a file, and is printed on a terminal.
        for name in ("where", "error", "traceback"):
            lines = _plain(getattr(self, name)).split("\n")
            object.__setattr__(self, name, "\n".join(map(one_line, lines)))


@dataclass(frozen=True)
class Outcome:
    """What came of a job: the files it wrote and the executed notebook, or a failure."""

    files: dict[str, bytes] = field(default_factory=dict)
    executed: bytes = b""
    software: dict[str, object] = field(default_factory=dict)
    failure: Failure | None = None
    seconds: float = 0.0

    def claimed(self) -> set[str]:
        """Ids of the ledger's entries that the notebook holds its numbers against."""
        return set(json.loads(self.files.get("claims.json", b"{}")))


def execute(job: Job, on_cell: Callable[[], object] = lambda: None, forks: bool = False) -> Outcome:
    """Execute a notebook in a kernel of its own; a failure is an outcome, not an exception.

    Parameters
    ----------
    job : Job
    on_cell : callable
        Called when a code cell has run.
    forks : bool
        Whether the kernel is forked from a warmed process (`workbook.kernels.warmed`), or started.
    """
    begin = time.monotonic()
    with _folder() as folder:
        outcome = _execute(job, folder, on_cell, forks)
    return replace(outcome, seconds=time.monotonic() - begin)


@contextlib.contextmanager
def _folder():
    """A folder for one kernel and what it writes."""
    folder = Path(tempfile.mkdtemp(prefix="stillwork-"))
    try:
        yield folder
    finally:
        for pause in (0.0, 0.05, 0.2, 1.0):  # a kernel that was killed may just be writing its last file
            time.sleep(pause)
            shutil.rmtree(folder, ignore_errors=True)
            if not folder.exists():
                break


def _execute(job: Job, folder: Path, on_cell: Callable[[], object], forks: bool) -> Outcome:
    import nbformat
    from nbclient.exceptions import DeadKernelError
    from papermill import execute_notebook
    from papermill.exceptions import PapermillExecutionError
    from papermill.translators import papermill_translators

    papermill_translators.register("python", _translator())
    for noisy in ("papermill", "traitlets"):  # what they log is in the outcome
        logging.getLogger(noisy).setLevel(logging.CRITICAL)
    source = nbformat.reads(job.source, as_version=4)
    source.metadata.setdefault("language_info", {"name": "python"})
    begun = []

    def counts(cell) -> bool:
        return cell.cell_type == "code" and "injected-parameters" not in cell.metadata.get("tags", [])

    def note(cell, cell_index):
        if counts(cell):
            begun.append(cell.source)

    def step(cell, cell_index, execute_reply):
        if counts(cell):
            on_cell()

    output = folder / "output"
    manager = kernel_manager(job.build, folder, output, forks)
    try:
        executed = execute_notebook(
            source,
            None,
            parameters=job.settings,
            progress_bar=False,
            kernel_name="python3",
            start_timeout=120,
            kernel_manager_class=manager,
            shutdown_kernel="immediate",
            resources={"metadata": {"path": str(paths.root())}},
            on_cell_start=note,
            on_cell_executed=step,
            record_timing=False,
            iopub_timeout=60,
        )
    except PapermillExecutionError as error:
        message = f"{error.ename}: {error.evalue}".strip().splitlines()[-1]
        # The message of wrong input states what to do; the place in the library where it was refused does not help.
        traceback = "" if error.ename == "InputError" else "\n".join(error.traceback)
        return Outcome(failure=Failure(_where(begun), message, traceback))
    except DeadKernelError:
        return Outcome(failure=Failure(_where(begun), manager.last_words()))
    except RuntimeError as error:  # the kernel did not come up
        return Outcome(failure=Failure(_where(begun), f"{manager.last_words()} ({error})"))
    finally:
        manager.end()
    _forget_run(executed)
    try:
        files = _collect(output, job.notebook)
    except (OSError, ValueError) as error:
        return Outcome(failure=Failure("files", str(error)))
    return Outcome(files, nbformat.writes(executed).encode() + b"\n", _software())


def _where(begun: list[str]) -> str:
    if not begun:
        return "kernel start"
    first = next(iter(begun[-1].strip().splitlines()), "")
    return f"cell [{len(begun)}] {first if len(first) <= 60 else first[:59] + '…'}"


def _plain(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


def _forget_run(notebook) -> None:
    """Drop what papermill notes about the run: times and folders of this machine."""
    notebook.metadata.pop("papermill", None)
    for cell in notebook.cells:
        cell.metadata.pop("papermill", None)
        if not cell.metadata.get("tags"):
            cell.metadata.pop("tags", None)
        elif "injected-parameters" in cell.metadata.tags:
            cell["id"] = "injected-parameters"


def _collect(output: Path, notebook: str) -> dict[str, bytes]:
    home = output / notebook
    files = {}
    for file in sorted(output.rglob("*")):
        if file.is_file():
            if not file.is_relative_to(home):
                page = file.parent.relative_to(output).as_posix()
                raise ValueError(f"the notebook writes to the page {page!r}; name it Page({notebook!r})")
            files[file.relative_to(home).as_posix()] = file.read_bytes()
    return files


def _software() -> dict[str, object]:
    from workbook.environment import drift

    versions = {name: metadata.version(name) for name in ("numpy", "numba")}
    return {"python": platform.python_version(), **versions, "drift": drift()}


def _translator():
    from papermill.translators import PythonTranslator

    class Translator(PythonTranslator):
        """Papermill's, and tuples, which it would turn into strings."""

        @classmethod
        def translate(cls, val):
            return repr(val) if isinstance(val, tuple | list) else super().translate(val)

    return Translator
