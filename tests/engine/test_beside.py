"""A module beside a notebook is imported alike by a build, Jupyter, nbval, pytest and workers of every kind."""

import subprocess
import sys

import pytest

from engine import toy as toys
from workbook import paths

FIRST, SECOND = "isolation/01-first", "isolation/02-second"
IMPORT = "from notebooks.isolation.first import trial, twice"
MODULE = """\
import os

from experiments.isolation.model import gain


def twice(level):
    return 2 * gain(level)


def trial(rng, level):
    return {"twice": twice(level), "process": os.getpid()}
"""
# A study's trials on processes of this machine and on a cluster's.
WORKERS = f"""\
import os
from distributed import Client, LocalCluster
{IMPORT}
from workbook.studies import run_study
from workbook.workers import processes

if __name__ == "__main__":
    with processes(1) as pool:
        here = run_study(trial, 2, 1, executor=pool, progress=False, level=1.0)
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        with Client(cluster) as client:
            there = run_study(trial, 2, 1, executor=client.get_executor(), progress=False, level=1.0)
    assert os.getpid() not in {{*here["process"], *there["process"]}}
    print(here["twice"].tolist() + there["twice"].tolist())
"""


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    made = toys.make(tmp_path_factory.mktemp("beside"))
    made.write("notebooks/isolation/first.py", MODULE)
    made.add(FIRST, f"{IMPORT}\nassert twice(1.0) == 4.0")
    made.add(SECOND)
    assert made.run("figures").returncode == 0
    yield made
    toys.clean_up(made)


def run(toy, *command: str, **options) -> str:
    done = subprocess.run(
        [sys.executable, *command],
        env=toy.environment(),
        capture_output=True,
        text=True,
        **{"cwd": toy.root, **options},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_a_build_imports_it_and_its_code_makes_the_notebook_stale(toy):
    file = "notebooks/isolation/first.py"
    toy.write(file, f"# Why, in a comment.\n{MODULE}")
    assert "2 up to date" in toy.run("figures").stdout
    toy.write(file, MODULE.replace("2 *", "2.0 *"))
    told = toy.run("figures", "--why").stdout
    assert f"{FIRST}: {file} changed" in told and f"{SECOND}: up to date" in told
    toy.write(file, MODULE)


@pytest.mark.slow
def test_workers_import_it(toy):
    toy.write("workers.py", WORKERS)
    assert run(toy, "workers.py") == "[4.0, 4.0, 4.0, 4.0]\n"


def beside() -> list[str]:
    """Dotted names of the modules beside this workbook's notebooks."""
    return [
        f"notebooks.{file.parent.name}.{file.stem}"
        for file in sorted((paths.root() / "notebooks").glob("*/*.py"))
    ]
