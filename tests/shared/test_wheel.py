"""What a wheel holds: toolbox and engine and what they read, and nothing of the experiments or of Jupyter's settings."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from stillwork.base.extras import BY_PACKAGE

ROOT = Path(__file__).parents[2]

CHECK = """
import importlib.util, os, sys
checkout = {"stillwork", "contest"}
others = [each for each in sys.path if os.path.isdir(each) and not checkout & {*os.listdir(each)}]
sys.path[:] = [sys.argv[1], *others]
import stillwork
assert stillwork.__file__.startswith(sys.argv[1]), stillwork.__file__
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("jinja2", "matplotlib", "papermill"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent())
from stillwork.__main__ import main
sys.exit(main(sys.argv[2:]))
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (file,) = folder.glob("*.whl")
    return zipfile.ZipFile(file)


@pytest.mark.slow
def test_it_holds_the_toolbox_and_no_more(wheel):
    names = set(wheel.namelist())
    library, packages = ROOT / "lib", ("stillwork", "workbook")
    wanted = {
        file.relative_to(library).as_posix()
        for package in packages
        for file in (library / package).rglob("*")
        if file.is_file() and "__pycache__" not in file.parts
    }
    assert {name for name in names if not name.startswith("stillwork-0.1.0.dist-info/")} == wanted
    assert "workbook/pinned.env" in wanted
    assert not [name for name in names if name.endswith(".ipynb") or "/etc/" in name]


def _run(wheel, folder: Path, *arguments: str, **settings: str) -> subprocess.CompletedProcess:
    """The command of the wheel alone, without the checkout and what only the workbook needs."""
    wheel.extractall(folder / "installed")
    command = [sys.executable, "-P", "-c", CHECK, str(folder / "installed"), *arguments]
    environment = {"PATH": "/usr/bin:/bin", "PYTHONDONTWRITEBYTECODE": "1", **settings}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.slow
def test_inspect_works_without_a_checkout(wheel, tmp_path):
    record = next((ROOT / "data" / "worstcase" / "your_record").glob("*.csv"))
    done = _run(wheel, tmp_path, "inspect", str(record))
    assert done.returncode == 0, done.stderr
    assert "record" in done.stdout and "require the cloned repository" in done.stdout


@pytest.mark.slow
def test_its_help_lists_what_works_without_a_checkout(wheel, tmp_path):
    done = _run(wheel, tmp_path, "--help")
    assert done.returncode == 0, done.stderr
    listed = done.stdout.split()
    assert {"inspect", "report", "design"} <= set(listed) and "contest" not in listed
    assert "also: init (python -m workbook --help)" in " ".join(listed)


def test_what_is_missing_is_asked_of_the_extra_that_brings_it():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    imported = {"griffelib": "griffe", "npTDMS": "nptdms"}
    for extra in ("data", "control", "design"):
        brought = {each.partition(">")[0] for each in extras[extra] if not each.startswith("stillwork")}
        assert {imported.get(each, each) for each in brought} == {
            name for name, of in BY_PACKAGE.items() if of == extra
        }
