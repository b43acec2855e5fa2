"""A small workbook with a copy of the shared library, in a folder of its own, to run the runner on."""

import contextlib
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

import psutil
import pytest

from workbook import dependencies, inputs, paths
from workbook.__main__ import main

LIBRARY = Path(__file__).parents[2] / "lib"

LEDGER = """\
# Numbers of the toy.

[{topic}.gain]
place = "Table 1"
quantity = "gain"
unit = ""
published = 2.0  # as printed
kind = "value"
tolerance = {{ relative = 0.01, source = "printed digits" }}

# What comes next.
"""

PARAMETERS = "seed: int = 1  # of the noise\nlevel: float = 1.0  # V"

SAVE_FIGURE = """\
figure, axes = figures.new()
axes.plot([0, 1, 2], np.random.default_rng(seed).normal(size=3), label="noise")
axes.set_xlabel("time (s)")
page.save("fig-1", figure)"""


def cell(name: str, source: str, kind: str = "code", tags: tuple[str, ...] = ()) -> dict:
    made = {"cell_type": kind, "id": name, "metadata": {"tags": list(tags)} if tags else {}, "source": source}
    return made | ({"outputs": [], "execution_count": None} if kind == "code" else {})


def notebook(cells: list[dict]) -> str:
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return json.dumps(
        {"nbformat": 4, "nbformat_minor": 5, "metadata": {"kernelspec": kernel}, "cells": cells}
    )


@dataclass
class Toy:
    """The toy's folder, and ways to change, run and inspect it."""

    root: Path
    temporary: Path = field(default_factory=lambda: Path(tempfile.mkdtemp(prefix="toy-", dir="/tmp")))
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)

    def write(self, path: str, text: str) -> None:
        file = self.root / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")

    def replace(self, path: str, old: str, new: str) -> None:
        text = (self.root / path).read_text(encoding="utf-8")
        assert old in text
        self.write(path, text.replace(old, new))

    def add(self, name: str, *sources: str, parameters: str = PARAMETERS) -> None:
        """A notebook that writes ``out.csv`` (no matplotlib: quick), then runs `sources`."""
        begin = (
            "from workbook import paths\n"
            f"from experiments.{name.partition('/')[0]}.model import gain\n"
            f"folder = paths.output('{name}')\nfolder.mkdir(parents=True)"
        )
        write = "written = (folder / 'out.csv').write_text(f'{seed},{gain(level)}\\n')"
        cells = [
            cell("title", "# A toy", "markdown"),
            cell("begin", begin),
            cell("parameters", parameters, tags=("parameters",)),
            cell("write", write),
            *(cell(f"cell-{number}", source) for number, source in enumerate(sources, 1)),
        ]
        self.write(f"notebooks/{name}.ipynb", notebook(cells))

    def add_page(self, name: str) -> None:
        """A notebook with a figure and a claim."""
        topic = name.partition("/")[0]
        begin = (
            "import numpy as np\nfrom workbook import figures, paths\nfrom workbook.page import Page\n"
            f"from experiments.{topic}.model import gain\npage = Page('{name}')\n"
            f"rig = paths.data('{topic}', 'rig.toml').read_text()"
        )
        cells = [
            cell("title", "# A toy", "markdown"),
            cell("begin", begin),
            cell("parameters", PARAMETERS, tags=("parameters",)),
            cell("figure", SAVE_FIGURE),
            cell("claim", f"page.check('{topic}.gain', gain(level))"),
            cell("claims", "page.claims"),
        ]
        self.write(f"notebooks/{name}.ipynb", notebook(cells))

    def environment(self) -> dict[str, str]:
        outside = {k: v for k, v in os.environ.items() if not k.startswith("STILLWORK")}
        return outside | {
            "PYTHONPATH": os.pathsep.join([str(self.root / "lib"), str(self.root)]),
            "TMPDIR": str(self.temporary),
            "TOY": str(self.root),
            "TOY_MARK": self.mark,
        }

    def command(self, *arguments: str) -> list[str]:
        return [sys.executable, "-m", "workbook", *arguments]

    def git(self, *arguments: str) -> str:
        identity = ["-c", "user.name=toy", "-c", "user.email=toy@example.org"]
        command = ["git", "-C", str(self.root), *identity, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    def commit(self) -> None:
        """Everything, in a repository that is made where there is none."""
        self.git("init", "--quiet")
        self.git("add", ".")
        self.git("commit", "--quiet", "-m", "toy")

    def run(self, *arguments: str, script: str = "", **options) -> subprocess.CompletedProcess:
        """A command of the toy's, or a script of Python."""
        return subprocess.run(
            [sys.executable, "-c", script] if script else self.command(*arguments),
            cwd=self.root,
            env=self.environment(),
            capture_output=True,
            text=True,
            timeout=900,
            **options,
        )

    def reasons(self, *arguments: str) -> dict[str, str]:
        """What ``--why`` says, by notebook, without those that are up to date; by this process, without one of its own."""
        dependencies.look_again()
        inputs._pins.cache_clear()  # by folder, in which a test may change them
        with paths.rooted(self.root), pytest.MonkeyPatch.context() as patch:
            patch.setattr(sys, "path", [str(self.root / "lib"), str(self.root), *sys.path])
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                assert main(["figures", "--why", *arguments]) == 0
        lines = (line.split(": ", 1) for line in printed.getvalue().splitlines())
        return {name: reason for name, reason in lines if reason != "up to date"}

    def start(self, *arguments: str, ignored: tuple[int, ...] = ()) -> subprocess.Popen:
        """Run in a session of its own, as a terminal does, and do not wait."""
        return subprocess.Popen(
            self.command(*arguments),
            cwd=self.root,
            env=self.environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: set_signals(*ignored),
        )

    def interrupt(self, process: subprocess.Popen, number: int) -> str:
        """Signal the runner's process group; returns what it printed until it ended."""
        os.killpg(process.pid, number)
        return process.communicate(timeout=300)[0]

    def wait_for(self, *names: str) -> None:
        """Wait until the notebooks have touched these files in the toy's folder."""
        until(lambda: all((self.root / name).exists() for name in names))

    def files(self, *folders: str) -> dict[str, bytes]:
        """Every file under `folders`, by its path."""
        found = {}
        for folder in folders:
            for place, inner, names in os.walk(self.root / folder, followlinks=True):
                inner[:] = sorted(
                    name for name in inner if not name.startswith(".")
                )  # reached by their links
                for name in sorted(names):
                    file = Path(place, name)
                    found[file.relative_to(self.root).as_posix()] = file.read_bytes()
        return found

    def results(self) -> dict[str, bytes]:
        """Every file that builds made, apart from what each says of how it was made."""
        return {name: text for name, text in self.files("build/figures").items() if "record.json" not in name}

    def stamps(self, *folders: str) -> dict[str, tuple[int, int]]:
        """Inode and time of change of every file and folder (of some `folders`), caches of Python aside."""
        return {
            str(path): (path.stat().st_ino, path.stat().st_mtime_ns)
            for path in self.root.rglob("*")
            if "__pycache__" not in str(path)
            and (not folders or path.relative_to(self.root).parts[0] in folders)
        }

    def processes(self) -> list[psutil.Process]:
        """Processes that the toy's runs started and that still live."""
        found = []
        for process in psutil.process_iter():
            try:
                if process.environ().get("TOY_MARK") == self.mark and process.status() != "zombie":
                    found.append(process)
            except psutil.Error:
                continue
        return found

    def leftovers(self) -> list[str]:
        """What a run left behind: processes, temporary files, half-written results."""
        hidden = [path for path in self.root.rglob("*") if path.name.endswith((".new", ".old"))]
        processes = [" ".join(process.cmdline()) for process in self.processes()]
        return [str(path) for path in [*self.temporary.iterdir(), *hidden]] + processes


def set_signals(*ignored: int) -> None:
    """Set how a process begins: a background job of a shell, and all that it starts, ignores interrupts."""
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM, signal.SIGPIPE):
        signal.signal(number, signal.SIG_IGN if number in ignored else signal.SIG_DFL)


def until(condition, seconds: float = 300) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.05)


def make(root: Path) -> Toy:
    """A toy with the topics `isolation` and `motion`, without notebooks."""
    toy = Toy(root)
    ignore = shutil.ignore_patterns("__pycache__")
    for file in LIBRARY.glob("stillwork/*.py"):
        toy.write(f"lib/stillwork/{file.name}", file.read_text(encoding="utf-8"))
    for package in ("stillwork/base", "stillwork/signals", "workbook"):
        shutil.copytree(LIBRARY / package, root / "lib" / package, ignore=ignore)
    # Of what its kernels are warmed with, the toy needs Jupyter's part alone: two seconds a build.
    toy.write("lib/workbook/warm.py", "import ipykernel.kernelapp\n")
    toy.write("lib/experiments/__init__.py", "")  # else an installed one of this name goes before it
    for topic in ("isolation", "motion"):
        toy.write(f"lib/experiments/{topic}/__init__.py", "")
        toy.write(f"lib/experiments/{topic}/model.py", "def gain(level):\n    return 2.0 * level\n")
        toy.write(f"data/{topic}/rig.toml", "mass = 1.0\n")
        toy.write(f"data/{topic}/published.toml", LEDGER.format(topic=topic))
    toy.write("pyproject.toml", (LIBRARY.parent / "pyproject.toml").read_text(encoding="utf-8"))
    others = {each.name for each in metadata.distributions()} - {"numpy", "scipy", "stillwork"}
    pins = [f"{name}==1.0" for name in sorted(others)]
    pins += ["numpy==2.4.5 \\", "    --hash=sha256:0", "    # via a", "scipy==1.17.1"]
    toy.write("environment.txt", "\n".join(pins) + "\n")
    return toy


@contextmanager
def copy_of(toy: Toy, folder: Path) -> Iterator[Toy]:
    """A copy in `folder` that a test may change, cleaned up at the end."""
    shutil.copytree(toy.root, folder / "copy", symlinks=True)
    copy = Toy(folder / "copy")
    yield copy
    clean_up(copy)


def clean_up(toy: Toy) -> None:
    for process in toy.processes():
        process.send_signal(signal.SIGKILL)
    shutil.rmtree(toy.temporary, ignore_errors=True)
