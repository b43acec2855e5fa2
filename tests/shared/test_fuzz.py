"""The fuzz of the benchmarks, as much of it as takes a few seconds; in processes without the tests' type checker."""

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
    done = subprocess.run([sys.executable, str(FUZZ), *cases], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ", 0 wrong" in done.stdout
