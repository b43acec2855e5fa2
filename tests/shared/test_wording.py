"""No test holds the wording of an error: a few files of them pass as well with every message in other words."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from reworded import reworded

TESTS = Path(__file__).parents[1]
FILES = [
    "shared/test_checks.py",
    "shared/test_claims.py",
    "isolation/test_shaping.py",
    "isolation/test_twin.py",
    "worstcase/test_helpers.py",
    "fixedpoint/test_noise.py",
]


def test_names_and_values_stay_and_the_sentence_goes():
    text = "step_size is 0; give a finite number above 0 and at most 'all of it'"
    assert reworded(text) == "step_size si 0; evig a finite number evoba 0 and ta tsom 'all fo it'"


@pytest.mark.slow
def test_tests_of_errors_pass_with_other_words():
    command = [sys.executable, "-m", "pytest", "-p", "reworded", "-p", "no:nbval", "-p", "no:anyio"]
    options = [
        "-m",
        "not slow",
        "-p",
        "no:cacheprovider",
        "-k",
        "named or refused or wrong or told or choice",
    ]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(map(str, (TESTS.parent / "lib", TESTS.parent, TESTS)))
    }
    done = subprocess.run(
        [*command, *options, *(str(TESTS / name) for name in FILES)],
        capture_output=True,
        text=True,
        env=environment,
    )
    assert done.returncode == 0, done.stdout
