"""A workbook for somebody else's paper, begun in an empty folder with the wheel alone."""

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from engine.toy import cell, notebook
from workbook.checks import InputError
from workbook.site.scaffold import begin

ROOT = Path(__file__).parents[2]

# Haykin, Adaptive Filter Theory: the experiment on adaptive equalisation, its table of eigenvalue spreads.
PRINTED = {2.9: 6.0782, 3.1: 11.1238, 3.3: 21.7132, 3.5: 46.8216}

ENTRY = """
[equaliser.spread.w{tenths}]
place = "Table 5.1"
quantity = "eigenvalue spread, W = {width}"
unit = "1"
published = {spread}
kind = "value"
tolerance = {{ absolute = 5e-5, source = "half the last printed digit" }}
"""

CHOICES = """
[equaliser.with-noise]
question = "whether the correlation matrix holds the noise at the channel's output"
options = [true, false]
default = true
kind = "definition"
source = "the text defines the matrix of the tap inputs, and prints the spread without a formula"
touches = ["equaliser.spread"]

[studies.spread]
function = "notebooks.equaliser.spread:study"
entries = ["equaliser.spread"]
"""

MODULE = '''"""Eigenvalue spread of the correlation matrix of an equaliser's tap inputs."""

import numpy as np
from scipy.linalg import eigvalsh, toeplitz

WIDTHS = (2.9, 3.1, 3.3, 3.5)


def spread(width, variance, taps=11):
    """Largest over smallest eigenvalue, for a raised-cosine channel of this width."""
    channel = (1 + np.cos(2 * np.pi * (np.arange(1, 4) - 2) / width)) / 2
    row = np.zeros(taps)
    row[:3] = np.correlate(channel, channel, "full")[2:]
    row[0] += variance
    values = eigvalsh(toeplitz(row))
    return values[-1] / values[0]


def study(with_noise, seed, lean):
    return {f"equaliser.spread.w{10 * width:.0f}": spread(width, 0.001 * with_noise) for width in WIDTHS}
'''

CELLS = [
    cell(
        "title", "# Eigenvalue spread\n\n*Haykin, Adaptive Filter Theory: adaptive equalisation.*", "markdown"
    ),
    cell(
        "imports",
        "from notebooks.equaliser.spread import WIDTHS, spread\nfrom workbook import Page\n\n"
        'page = Page("equaliser/01-spread")',
    ),
    cell("parameters", "variance: float = 0.001  # of the noise", tags=("parameters",)),
    cell(
        "checks",
        'for width in WIDTHS:\n    page.check(f"equaliser.spread.w{10 * width:.0f}", spread(width, variance))',
    ),
    cell("claims", "page.claims"),
]


@pytest.fixture(scope="module")
def stranger(tmp_path_factory):
    """A Python with the wheel and, lent, the packages of this one: no checkout is on its path."""
    folder = tmp_path_factory.mktemp("stranger")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    venv.create(folder / "venv", symlinks=True)
    python = folder / "venv" / "bin" / "python"
    ask = [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]
    packages = Path(subprocess.run(ask, check=True, capture_output=True, text=True).stdout.strip())
    (file,) = folder.glob("*.whl")
    zipfile.ZipFile(file).extractall(packages)
    # The folder alone: an editable checkout that it names by a .pth file of its own is not looked at.
    (packages / "lent").symlink_to(sysconfig.get_path("purelib"))
    (packages / "lent.pth").write_text("lent\n")
    outside = {
        name: text for name, text in os.environ.items() if not name.startswith(("PYTHON", "STILLWORK"))
    }

    def run(*arguments: str, at: Path) -> str:
        done = subprocess.run([python, *arguments], cwd=at, env=outside, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    yield run


@pytest.mark.slow
def test_haykin_s_table_is_built_judged_tried_and_shown_with_the_wheel_alone(stranger, tmp_path):
    told = stranger("-m", "workbook", "init", "mine", at=tmp_path)
    home = tmp_path / "mine"
    assert set(told.splitlines()[:-1]) == {
        file.relative_to(home).as_posix() for file in home.rglob("*") if file.is_file()
    }
    place = stranger("-c", "import workbook, stillwork; print(workbook.__file__)", at=home)
    assert Path(place.strip()).is_relative_to(tmp_path.parent) and str(ROOT) not in place
    for name, text in {
        "data/equaliser/published.toml": "".join(
            ENTRY.format(tenths=round(10 * width), width=width, spread=spread)
            for width, spread in PRINTED.items()
        ),
        "data/equaliser/choices.toml": CHOICES,
        "notebooks/equaliser/spread.py": MODULE,
        "notebooks/equaliser/01-spread.ipynb": notebook(CELLS),
    }.items():
        (home / name).parent.mkdir(exist_ok=True)
        (home / name).write_text(text, encoding="utf-8")
    assert "2 built, 0 failed" in stranger("-m", "workbook", "figures", "--jobs", "1", at=home)
    tried = stranger("-m", "workbook", "choices", "--jobs", "1", at=home)
    assert tried.count(" 50 % ") == 5
    assert "accepted 2 notebooks and 5 ledger entries" in stranger("-m", "workbook", "accept", at=home)
    claims = json.loads(stranger("-m", "workbook", "claims", "equaliser", "--json", at=home))
    assert {(claim["verdict"], claim["here"]) for claim in claims} == {("mostly replicated", "inside")}
    assert [claim["ours"] for claim in claims] == pytest.approx(list(PRINTED.values()), abs=5e-5)
    assert {(claim["choices"]["tried"], claim["choices"]["agree"]) for claim in claims} == {(2, 1)}
    assert "0 broken links" in stranger("-m", "workbook", "site", at=home)
    page = (home / "build/site/notebooks/equaliser/01-spread.html").read_text(encoding="utf-8")
    assert "46.82" in page and "replicated" in page
    assert {file.stem for file in (home / "build/site/reference").iterdir()} == {
        "index",
        "notebooks.equaliser.spread",
        "notebooks.paper.deviation",
    }
    assert "2 passed" in stranger("-m", "pytest", "-p", "no:cacheprovider", "tests", at=home)


def test_a_workbook_begins_in_a_folder_of_its_own(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for folder in (tmp_path, tmp_path / "notes.txt"):
        with pytest.raises(InputError, match=r"^folder\b"):
            begin(str(folder))
    assert [file.name for file in tmp_path.iterdir()] == ["notes.txt"]
