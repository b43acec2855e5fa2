"""Whole notebooks on the workers of a real cluster."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from engine import toy as toys

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """One workbook for all tests, with the address of a cluster whose workers run from its folder."""
    toy = toys.make(tmp_path_factory.mktemp("shared"))
    process = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("cluster.py"))],
        cwd=toy.root,
        env=toy.environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    yield toy, process.stdout.readline().strip()
    process.communicate("")
    toys.clean_up(toy)


@pytest.fixture
def scheduler(shared) -> str:
    return shared[1]


@pytest.fixture
def toy(shared):
    """The cluster's workbook, emptied of what the test before made."""
    made, _ = shared
    for folder in ("notebooks", "build"):
        shutil.rmtree(made.root / folder, ignore_errors=True)
    return made


def test_notebooks_give_the_same_bytes_as_here(toy, scheduler):
    toy.add_page("isolation/01-first")
    toy.add("isolation/02-second")
    toy.add(
        "motion/01-first",
        "import os\nfrom pathlib import Path",
        "written = Path(os.environ['TOY'], 'parent').write_text(str(os.getppid()))",
    )
    done = toy.run("figures", "--scheduler", scheduler)
    assert done.returncode == 0, done.stdout
    parent = psutil.Process(int((toy.root / "parent").read_text()))
    assert "stillwork" not in parent.cmdline()  # a worker, not the runner
    there = toy.results()
    assert toy.run("figures", "--force").returncode == 0
    assert toy.results() == there


def test_a_failure_on_a_worker_is_told_as_one_here(toy, scheduler):
    toy.add("isolation/01-first", "ratio = 1 / 0")
    toy.add("isolation/02-second", "import os\nos.kill(os.getpid(), 9)")
    toy.add("isolation/03-third")
    done = toy.run("figures", "--scheduler", scheduler)
    assert done.returncode == 1
    assert "1 built, 2 failed" in done.stdout
    assert "cell [4] ratio = 1 / 0" in done.stdout
    assert "killed by SIGKILL" in done.stdout


def test_a_worker_with_another_checkout_is_refused(toy, scheduler):
    toy.add("isolation/01-first")
    other = toy.root / "other"
    shutil.copytree(toy.root, other)
    (other / "lib/experiments/isolation/model.py").write_text("def gain(level):\n    return 3.0 * level\n")
    done = subprocess.run(
        toy.command("figures", "--scheduler", scheduler),
        cwd=other,
        env=toy.environment() | {"PYTHONPATH": f"{other / 'lib'}{os.pathsep}{other}"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert "lib/experiments/isolation/model.py changed" in done.stdout
