"""The fuzz of the benchmarks, as much of it as takes a few seconds; in processes without the tests' type checker."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"


@pytest.mark.slow
@pytest.mark.parametrize(
    "cases",
    [
        pytest.param(["--cases", "2500"], id="wrong values end in documented errors"),
        pytest.param(["--only", "forms"], id="an array's form changes neither the result nor the array"),
    ],
)
def test_nothing_goes_wrong(cases):
    """20 s of CPU: only chance calls every public function with values, types and files that no case was written for."""
    done = subprocess.run([sys.executable, str(FUZZ), *cases], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ", 0 wrong" in done.stdout
    for refused, unnamed in re.findall(r"(\d+) refused, of which (\d+) name no spoiled", done.stdout):
        assert int(unnamed) < 0.02 * int(refused)  # the others name the argument, or a field of it


COVERED = """
from fuzzing import behind, calls

asked = calls.catalogue() | calls.behind()
names = {name.split(",")[0].rpartition(".")[2] for name in asked}
public = [f"{folder}.{name}" for folder, package in calls.PACKAGES.items() for name, _ in behind.public(calls._whole(package))]
assert public and calls.missing() == []
assert not {each for each in public if each.rpartition(".")[2] not in names | {"fit"} | {n.rpartition(".")[2] for n in calls.PARTS}}
"""


@pytest.mark.slow
def test_every_public_function_is_called():
    command = [sys.executable, "-W", "ignore", "-c", COVERED]
    done = subprocess.run(command, cwd=FUZZ.parent, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
