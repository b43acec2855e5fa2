"""The environment that make builds on first use: never a half-made one, never a wrong Python."""

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from order import PLACES
from stillwork.workbook.pinned import FILE, pins

ROOT = Path(__file__).parents[2]

STUB = """\
#!/bin/sh
echo "$@" >> calls
case "$*" in
    "-m venv --clear .venv") rm -rf .venv && mkdir -p .venv/bin && cp stub .venv/bin/python ;;
    *"-r environment.txt") test ! -e broken ;;
    -c*) test ! -e old ;;
esac
"""


@pytest.fixture
def checkout(tmp_path):
    """A folder with the Makefile and a Python that only notes how it was called."""
    for name in ("Makefile", "environment.txt", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / FILE.relative_to(ROOT)).parent.mkdir(parents=True)
    shutil.copy(FILE, tmp_path / FILE.relative_to(ROOT))
    stub = tmp_path / "stub"
    stub.write_text(STUB)
    stub.chmod(stub.stat().st_mode | stat.S_IEXEC)
    return tmp_path


def make(checkout, *arguments):
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "ARGS"))}
    command = ["make", "PYTHON=./stub", *arguments]
    return subprocess.run(command, cwd=checkout, env=clean, capture_output=True, text=True)


def calls(checkout) -> list[str]:
    """Calls since the last look."""
    log = checkout / "calls"
    lines = log.read_text().splitlines() if log.exists() else []
    log.unlink(missing_ok=True)
    return [line for line in lines if not line.startswith("-c")]


MADE = ["-m venv --clear .venv", "pip install -r", "pip install -e"]


def short(lines: list[str]) -> list[str]:
    """Calls without pip's options."""
    kept = []
    for line in lines:
        if "pip install" in line:
            line = "pip install -r" if "--require-hashes -r environment.txt" in line else "pip install -e"
        kept.append(line)
    return kept


def test_the_first_use_makes_the_environment_and_the_next_does_not(checkout):
    assert make(checkout, "figures", "ARGS=isolation -p seed=3").returncode == 0
    assert short(calls(checkout)) == [*MADE, "-m stillwork figures isolation -p seed=3"]
    assert make(checkout, "doctor").returncode == 0
    assert short(calls(checkout)) == ["-m stillwork doctor"]


def test_a_half_made_environment_is_made_again(checkout):
    (checkout / "broken").touch()
    assert make(checkout, "figures").returncode != 0
    assert short(calls(checkout)) == MADE[:2]
    (checkout / "broken").unlink()
    assert make(checkout, "figures").returncode == 0
    assert short(calls(checkout)) == [*MADE, "-m stillwork figures"]


def test_another_pin_makes_the_environment_again(checkout):
    make(checkout, "figures")
    calls(checkout)
    later = (checkout / ".venv" / "complete").stat().st_mtime + 10
    os.utime(checkout / "environment.txt", (later, later))
    assert make(checkout, "figures").returncode == 0
    assert short(calls(checkout))[:3] == MADE


def test_jupyter_reaches_data_and_figures_beside_the_notebooks(checkout):
    """Its files begin at the checkout, and it opens on the index below."""
    make(checkout, "lab")
    (started,) = [line for line in calls(checkout) if "jupyter lab" in line]
    assert "--ServerApp.root_dir=. " in started
    assert "--LabApp.default_url=/lab/tree/notebooks/index.ipynb" in started


def test_binder_gets_a_python_that_the_pins_serve_and_a_script_that_runs():
    runtime = (ROOT / ".binder" / "runtime.txt").read_text().strip()
    assert runtime in {f"python-3.{minor}" for minor in range(11, 15)}
    assert os.access(ROOT / ".binder" / "postBuild", os.X_OK)
    subprocess.run(["bash", "-n", str(ROOT / ".binder" / "postBuild")], check=True)


def test_the_pins_are_installed_from_wheels():
    """By make, Binder and anyone with pip: the option stands in the file of the pins."""
    assert (ROOT / "environment.txt").read_text().splitlines()[0] == "--only-binary :all:"
    assert (ROOT / ".binder" / "requirements.txt").samefile(ROOT / "environment.txt")


def test_another_python_is_refused(checkout):
    (checkout / "old").touch()
    done = make(checkout, "figures")
    assert done.returncode != 0
    assert "./stub is not a Python 3.11, 3.12, 3.13 or 3.14; name one: make PYTHON=" in done.stdout
    assert calls(checkout) == []


def test_an_environment_of_ones_own_is_left_alone(checkout):
    own = checkout / "own" / "bin"
    own.mkdir(parents=True)
    shutil.copy(checkout / "stub", own / "python")
    assert make(checkout, f"ENVIRONMENT={own.parent}", "figures").returncode == 0
    assert calls(checkout) == ["-m stillwork figures"]
    assert not (checkout / ".venv").exists()


def test_help_lists_every_target(checkout):
    shown = make(checkout, "help").stdout
    targets = next(
        line for line in (ROOT / "Makefile").read_text().splitlines() if line.startswith(".PHONY:")
    )
    assert {line.split()[1] for line in shown.splitlines()} == set(targets.split()[1:])
    assert calls(checkout) == []


def test_the_tests_run_notebooks_under_the_settings_of_a_build(checkout):
    (checkout / "stub").write_text(STUB + "env >> settings\n")
    own = checkout / "own" / "bin"
    own.mkdir(parents=True)
    for name in ("python", "ruff"):
        shutil.copy(checkout / "stub", own / name)
    assert make(checkout, "ENVIRONMENT=own", "test").returncode == 0
    settings = set((checkout / "settings").read_text().splitlines())
    assert {f"{name}={value}" for name, value in pins().items()} <= settings
    assert f"STILLWORK_OUTPUT={checkout}/build/nbval" in settings


def test_what_each_part_of_a_test_run_took_stands_at_its_end(checkout):
    own = checkout / "own" / "bin"
    own.mkdir(parents=True)
    for name in ("python", "ruff"):
        shutil.copy(checkout / "stub", own / name)
    *_, last = parts = make(checkout, "ENVIRONMENT=own", "test").stdout.splitlines()[-6:]
    seconds = [int(line.split(" s")[0]) for line in parts]
    assert [line.partition(": ")[2] for line in parts[:-1]] == [
        "style and types",
        "unit tests",
        "build",
        "notebooks",
        "what is committed",
    ]
    assert last == f"{sum(seconds[:-1])} s in all"
    (own / "ruff").write_text("#!/bin/sh\nexit 1\n")
    failed = make(checkout, "ENVIRONMENT=own", "test")
    assert failed.returncode != 0 and "in all" not in failed.stdout


def test_the_files_that_begin_first_are_there():
    assert [file for file in PLACES if not file.is_file()] == []


@pytest.mark.slow
def test_pytest_takes_the_options_for_the_notebooks(checkout):
    """Its plugins must agree on them in this order; only a run shows it."""
    own = checkout / "own" / "bin"
    own.mkdir(parents=True)
    for name in ("python", "ruff"):
        shutil.copy(checkout / "stub", own / name)
    assert make(checkout, "ENVIRONMENT=own", "test").returncode == 0
    (given,) = [line for line in calls(checkout) if line.startswith("-m pytest notebooks ")]
    arguments = given.replace("notebooks", "notebooks/fixedpoint/01-noise-free.ipynb", 1).split()
    done = subprocess.run(
        [sys.executable, *arguments, "-n0", "--collect-only", "-p", "no:cacheprovider"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT / "lib"), "STILLWORK_OUTPUT": str(checkout / "nbval")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "01-noise-free.ipynb::Cell 0" in done.stdout
