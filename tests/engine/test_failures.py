"""Whatever goes wrong in a build: the last good figures stand, the others go on, nothing is left behind."""

import resource
import signal

import pytest

from engine import toy as toys
from engine.toy import until

pytestmark = pytest.mark.slow

# Say which process it is, whole, and wait to be killed.
WAIT = """\
import os, time
from pathlib import Path
begun = Path(os.environ["TOY"], "{}")
written = begun.with_suffix(".part").write_text(str(os.getpid()))
begun.with_suffix(".part").rename(begun)
time.sleep(1000)"""


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Two good notebooks, built once."""
    made = toys.make(tmp_path_factory.mktemp("good"))
    made.add("isolation/01-first")
    made.add("isolation/02-second")
    assert made.run("figures").returncode == 0
    yield made
    toys.clean_up(made)


@pytest.fixture
def built(good, tmp_path):
    """A copy of the built workbook that a test may change."""
    with toys.copy_of(good, tmp_path) as copy:
        yield copy


def end_with(built, *sources) -> dict[str, bytes]:
    """Make the first notebook end with `sources`, and both stale; returns the good figures."""
    before = built.results()
    built.add("isolation/01-first", *sources)
    built.replace("notebooks/isolation/02-second.ipynb", "seed: int = 1", "seed: int = 2")
    return before


def assert_only_second_was_built(toy, good):
    first = {name: content for name, content in good.items() if "01-first" in name}
    now = toy.results()
    assert first == {name: content for name, content in now.items() if "01-first" in name}
    assert now["build/figures/isolation/02-second/out.csv"] == b"2,2.0\n"
    assert toy.leftovers() == []


def test_a_notebook_that_raises_and_a_kernel_that_is_killed_and_had_children(built):
    good = end_with(built, "ratio = 1 / 0")
    child = "import subprocess\nchild = subprocess.Popen(['sleep', '1000'])"
    built.add("isolation/03-third", child, "import os\nos.kill(os.getpid(), 9)")
    done = built.run("figures")
    assert done.returncode == 1
    assert "1 built, 2 failed" in done.stdout
    first, third = (line.split() for line in done.stdout.splitlines() if line.startswith("  isolation/"))
    assert first == "isolation/01-first cell [4] ratio = 1 / 0 ZeroDivisionError: division by zero".split()
    assert third[1:5] == "cell [5] import os".split() and "killed by SIGKILL" in " ".join(third)
    assert done.stdout.endswith("\nthe last good results of 1 of these stand untouched\n")
    assert_only_second_was_built(built, good)
    assert built.reasons() == {"isolation/01-first": "cell cell-1 added", "isolation/03-third": "never built"}


LARGE = "written = (folder / 'large.csv').write_bytes(bytes(3_000_000))"


def limit_files():
    """Files of this process and its children end at 2 MB, as on a full disk; a child may lift it."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, resource.RLIM_INFINITY))


def test_a_disk_that_is_full_for_the_results(built):
    lift = "import resource\nhard = resource.RLIM_INFINITY\nresource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))"
    good = end_with(built, lift, LARGE)
    done = built.run("figures", preexec_fn=limit_files)
    assert done.returncode == 1
    assert "writing the results" in done.stdout.splitlines()[-2]
    assert "File too large" in done.stdout.splitlines()[-2]
    assert_only_second_was_built(built, good)


def test_an_interrupt_of_a_parallel_build(built):
    good = built.results()
    for name in ("01-first", "02-second", "03-third"):
        built.add(
            f"isolation/{name}",
            "import subprocess\nchild = subprocess.Popen(['sleep', '1000'])",
            WAIT.format(name),
        )
    process = built.start("figures", "--jobs", "2")
    built.wait_for("01-first", "02-second")
    printed = built.interrupt(process, signal.SIGINT)
    assert process.returncode == 128 + signal.SIGINT
    assert "0 built, 3 failed" in printed
    assert [line.split()[-1] for line in printed.splitlines()[-4:-1]] == ["interrupted"] * 3
    assert built.results() == good
    assert built.leftovers() == []


@pytest.mark.parametrize("kernels", [1, 3])
def test_no_kernel_outlives_a_runner_that_is_killed(toy, kernels):
    """Neither one that was started nor those that were forked, with what they began."""
    names = ["begun", "second", "third"][:kernels]
    child = "import subprocess\nchild = subprocess.Popen(['sleep', '1000'])"
    for name in names:
        toy.add(f"isolation/0{names.index(name) + 1}-{name}", *[child] * (kernels > 1), WAIT.format(name))
    process = toy.start("figures", "--jobs", "3")
    toy.wait_for(*names)
    process.kill()
    process.communicate()
    until(lambda: not toy.processes())
