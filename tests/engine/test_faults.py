"""A hundred random faults, most of them in the steps that put results in their places; the benchmark has thousands."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

FAULTS = Path(__file__).parents[2] / "benchmarks/faults.py"


@pytest.mark.parametrize(
    ("kinds", "faults", "at_least"), [("publish", 140, 40), ("accept", 100, 16), ("build", 50, 12)]
)
def test_what_stands_after_a_fault_is_whole(kinds, faults, at_least):
    """40 s of CPU: only real kills and full disks, at moments by chance, find a half-written result that nobody thought of."""
    command = [sys.executable, str(FAULTS), "--faults", str(faults), "--jobs", "1", "--kinds", kinds]
    done = subprocess.run(
        command, capture_output=True, text=True, env=os.environ | {"PYTHONDONTWRITEBYTECODE": ""}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    injected, _, said = done.stdout.splitlines()[-1].partition(" faults in ")
    assert int(injected) >= at_least
    assert ", 0 broken;" in said
