import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[2] / "benchmarks" / "fuzz.py"


@pytest.mark.slow
def test_wrong_values_end_in_documented_errors():
    """Calls, files, tables and settings, made from a seed; see the benchmark for more of them."""
    done = subprocess.run([sys.executable, str(FUZZ), "--cases", "2500"], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ", 0 wrong" in done.stdout
