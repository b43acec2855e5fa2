"""nbval for this workbook: numbers are compared as numbers, and what a fresh build ran is not run again.

A plugin of pytest in the place of nbval's own (``-p no:nbval -p workbook.nbval_check``): its options, its
checks and its reports. Two things are added. An output that differs from the committed one in nothing but the last
digits of its numbers passes (`workbook.compare.same_text`). And where a build of exactly this notebook
stands in ``build/figures``, its recorded outputs stand in for a kernel's; ``--nbval-rerun N`` executes N notebooks all
the same, others on each day, so that a build that was accepted is not only held against itself. A build younger than
the file ``--nbval-begun`` was executed a moment ago: it needs no other turn.
"""

import datetime
import importlib
import itertools
import json
import sys
from pathlib import Path
from queue import Empty

from workbook import paths
from workbook.compare import printed, same_text
from workbook.notebooks import select
from workbook.tasks import Task, built, tasks

# As in `stillwork.base.command_line`: a second or two of every process that loads nbformat, as nbval does.
sys.modules.setdefault("rfc3987_syntax", None)
nbval = importlib.import_module("nbval.plugin")


def pytest_addoption(parser):
    nbval.pytest_addoption(parser)
    group = parser.getgroup("nbval")
    group.addoption(
        "--nbval-rerun", type=int, default=None, help="execute N notebooks although their build is fresh"
    )
    group.addoption("--nbval-begun", type=Path, help="but none whose build is younger than this file")


def pytest_configure(config):
    nbval.pytest_configure(config)


def pytest_collect_file(file_path, parent):
    """A notebook of the workbook, or None where nbval is not wanted."""
    if parent.config.option.nbval and file_path.suffix == ".ipynb":
        return ComparedNotebook.from_parent(parent, path=file_path)


def chosen_to_run(count: int, names: list[str], day: int) -> set[str]:
    """The notebooks that are executed again on a day: each has its turn before the first comes again."""
    return {names[(day * count + offset) % len(names)] for offset in range(min(count, len(names)))}


def older_than(file: Path | None, names: list[str]) -> list[str]:
    """Those whose build was put in its place before the file was written; all without a file."""
    if file is None:
        return names
    begun = file.stat().st_mtime_ns
    links = {name: built() / name for name in names}
    return [
        name for name, link in links.items() if not (link.is_symlink() and link.lstat().st_mtime_ns > begun)
    ]


class ComparedNotebook(nbval.IPyNbFile):
    """A notebook whose cells compare numbers as numbers, on a kernel or on the record of a build."""

    def collect(self):
        for cell in super().collect():
            yield ComparedCell.from_parent(
                self, name=cell.name, cell_num=cell.cell_num, cell=cell.cell, options=cell.options
            )

    def setup(self):
        task = self._fresh_build()
        if task is None:
            super().setup()
        else:
            self.kernel = Replay(task)
            self.setup_sanitize_files()

    def _fresh_build(self) -> Task | None:
        """The build to replay; None where this notebook is to be executed."""
        try:
            name = self.path.relative_to(paths.root() / "notebooks").with_suffix("").as_posix()
        except ValueError:
            return None
        rerun, begun = self.config.option.nbval_rerun, self.config.option.nbval_begun
        names = [notebook.name for notebook in select()]
        if rerun is None or name not in names:
            return None
        if name in chosen_to_run(rerun, older_than(begun, names), datetime.date.today().toordinal()):
            return None
        [task] = tasks(name)
        return None if task.reasons() else task


class ComparedCell(nbval.IPyNbCell):
    """A cell for whose output the committed text is taken where it differs from it by rounding alone."""

    def compare_outputs(self, test, ref, skip_compare=None):
        for now, before in itertools.zip_longest(test, ref):
            if now and before and now["output_type"] == before["output_type"]:
                if same_text(printed(now), printed(before)):
                    if now["output_type"] == "stream":
                        now["text"] = before["text"]
                    elif "text/plain" in now["data"] and "text/plain" in before["data"]:
                        now["data"]["text/plain"] = before["data"]["text/plain"]
        return super().compare_outputs(test, ref, skip_compare)


class Replay:
    """What nbval asks of a kernel, answered from the executed notebook of a build."""

    def __init__(self, task: Task):
        executed = json.loads(task.executed.read_text(encoding="utf-8"))
        self._cells = iter([cell for cell in executed["cells"] if cell["cell_type"] == "code"])
        self._messages: list[dict] = []
        self._asked = 0

    def execute_cell_input(self, source: str, allow_stdin=None) -> str:
        """Queue what the next cell with this source gave."""
        self._asked += 1
        parent = {"msg_id": str(self._asked)}
        cell = next(cell for cell in self._cells if "".join(cell["source"]) == source)
        self._messages = [
            {"msg_type": output["output_type"], "content": _content(output), "parent_header": parent}
            for output in cell["outputs"]
        ]
        self._messages.append(
            {"msg_type": "status", "content": {"execution_state": "idle"}, "parent_header": parent}
        )
        return parent["msg_id"]

    def get_message(self, stream: str, timeout: float | None = None) -> dict:
        """The next message of the last cell."""
        if not self._messages:
            raise Empty
        return self._messages.pop(0)

    def await_reply(self, message: str, timeout: float | None = None) -> None:
        """The reply is there."""

    def await_idle(self, message: str, timeout: float) -> None:
        """Drop what is left of the cell."""
        self._messages = []

    def is_alive(self) -> bool:
        return True

    def interrupt(self) -> None:
        """Nothing runs."""

    def stop(self) -> None:
        """Nothing runs."""


def _content(output: dict) -> dict:
    """An output as the message that it came in: stored lines as one text."""
    content = {"metadata": {}, "execution_count": None, **output}
    if "text" in content:
        content["text"] = "".join(content["text"])
    if "data" in content:
        content["data"] = {
            kind: "".join(text) if isinstance(text, list) else text for kind, text in content["data"].items()
        }
    return content
