"""A module beside a notebook is imported alike by a build, Jupyter, nbval, pytest and workers of every kind."""

import subprocess
import sys
import zipfile
from importlib import import_module
from pathlib import Path

import pytest
from hatchling.build import build_editable
from jupyter_client.manager import start_new_kernel

from engine import toy as toys
from workbook import paths
from workbook.dependencies import closure

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
def test_a_kernel_of_jupyter_imports_it_in_the_notebook_s_folder(toy):
    manager, client = start_new_kernel(env=toy.environment(), cwd=str(toy.root / "notebooks" / "isolation"))
    try:
        answer = client.execute_interactive(f"{IMPORT}\nassert twice(1.0) == 4.0", timeout=60)
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
    assert answer["content"]["status"] == "ok"


@pytest.mark.slow
def test_an_installed_checkout_has_it_on_its_path(tmp_path, monkeypatch):
    """For kernels that nobody gives a PYTHONPATH."""
    monkeypatch.chdir(paths.root())
    with zipfile.ZipFile(tmp_path / build_editable(str(tmp_path))) as wheel:
        (name,) = (each for each in wheel.namelist() if each.endswith(".pth"))
        places = {Path(line) for line in wheel.read(name).decode().split("\n") if line}
    assert places == {paths.root(), paths.root() / "lib"}


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


@pytest.mark.slow
def test_tests_import_each_and_it_bears_the_name_of_its_notebook():
    for name in beside():
        _, topic, stem = name.split(".")
        assert list((paths.root() / "notebooks" / topic).glob(f"[0-9]*-{stem.replace('_', '-')}.ipynb")), name
        assert import_module(name)


@pytest.mark.slow
def test_the_digest_of_a_study_follows_what_it_imports():
    for name in beside():
        assert name in (found := closure(modules=[name]))
        assert any(each.startswith("stillwork.") for each in found), name
