"""The course: its exercises' checks are what the solutions give, and its texts name what is there."""

import json
import os
import re
import shlex
import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from scipy import integrate, linalg, optimize, signal

from workbook import paths
from workbook.notebooks import select

COURSE = paths.root() / "docs/course"
TRACKS = sorted(file.stem for file in (COURSE / "solutions").glob("*.py"))
TEXTS = {file.stem: file.read_text(encoding="utf-8") for file in sorted(COURSE.glob("*.md"))}
NOTEBOOKS = {notebook.name: notebook for notebook in select()}
EXERCISE = re.compile(r"^## (\d+)\. (.+?)$(.*?)(?=^## |\Z)", re.DOTALL | re.MULTILINE)
EXERCISES = {
    (track, int(number)): text for track in TRACKS for number, _, text in EXERCISE.findall(TEXTS[track])
}


# A reader's process: without the tests' type checker, which takes no lists. What an exercise fails with is its answer.
RUN = """
import json, runpy, sys
found = {}
for name, solution in runpy.run_path(sys.argv[1]).items():
    if name.startswith("exercise_"):
        try:
            found[name] = solution()
        except Exception as error:
            found[name] = repr(error)
print(json.dumps(found))
"""


@cache
def answers(track: str) -> dict[int, str]:
    """What a track's solutions return, by the exercise's number."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(COURSE / f"solutions/{track}.py")],
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(paths.root() / "lib"), str(paths.root())])},
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return {int(name.removeprefix("exercise_")): answer for name, answer in json.loads(done.stdout).items()}


@pytest.mark.slow
@pytest.mark.parametrize(("track", "number"), EXERCISES)
def test_a_solution_gives_the_check_of_its_exercise(track, number):
    (check,) = re.findall(r"^\*\*Check:\*\* `([^`]+)`$", EXERCISES[track, number], re.MULTILINE)
    assert answers(track)[number] == check


def harmonic(amplitude: float) -> float:
    """Gain of x / (1 + |x|) for a sine."""
    value = integrate.quad(lambda a: np.sin(a) ** 2 / (1 + amplitude * np.sin(a)), 0, np.pi)[0]
    return 2 / np.pi * value


def butterworth() -> float:
    a, c = np.array([[0.0, 1], [0, 0]]), np.array([[1.0, 0]])
    p = linalg.solve_continuous_are(a.T, c.T, np.diag([0.0, 1]), [[1e-8]])
    pole = np.linalg.eigvals(a - 1e8 * p @ c.T @ c)[0]
    return -pole.real / abs(pole)


SEEN = np.random.default_rng(1).standard_normal((2, 400_000)) * [[1.0], [0.5]]
SPOT_CHECKS = {
    ("feedforward", 6): lambda: (
        3 / optimize.brentq(lambda r: abs(1 - (1 - (1 + 1j * r) ** -3) ** 2) - 0.1, 1, 10)
    ),
    ("feedforward", 9): lambda: np.linalg.cond([[1, 0.99], [0.99, 1]]),
    ("observers", 4): lambda: (
        abs(np.angle(np.roots(signal.bilinear([1], [1, 0, (2 * np.pi * 800) ** 2], 5000)[1])[0]))
        * 5000
        / (2 * np.pi)
    ),
    ("observers", 7): butterworth,
    ("uncertainty", 1): lambda: (
        optimize.minimize_scalar(lambda x: np.hypot(x - 2, x - 1) + 0.5 * abs(x), (0, 2)).x
    ),
    ("uncertainty", 8): lambda: SEEN.sum(0) @ SEEN[0] / (SEEN.sum(0) @ SEEN.sum(0)),
    ("noise", 4): lambda: np.sqrt(np.linalg.inv(sum(np.outer(t, t) for t in WINDOW))[1, 1] / 2),
    ("budget", 1): lambda: np.sqrt(
        integrate.quad(lambda w: 1e8 / abs(RING**2 - w**2 + 0.08j * RING * w) ** 2, 0, 1e4, points=[RING])[0]
        / (2 * np.pi)
    ),
    ("budget", 7): lambda: (
        optimize.minimize_scalar(lambda b: 676 * (83 / b) ** 4 + 625 * b / 83, (50, 200)).x
    ),
    ("noise", 7): lambda: optimize.brentq(lambda a: harmonic(a) - 0.5, 0.1, 10),
}
RING = 2 * np.pi * 12.3
WINDOW = np.vander(np.arange(-11.0, 1), 3, increasing=True)


@pytest.mark.parametrize(("track", "number"), SPOT_CHECKS)
def test_an_answer_by_numpy_and_scipy_alone(track, number):
    (check,) = re.findall(r"^\*\*Check:\*\* `([^`]+)`$", EXERCISES[track, number], re.MULTILINE)
    digits = len(check.partition(".")[2])
    assert f"{SPOT_CHECKS[track, number]():.{digits}f}" == check


def test_commands_and_parameters_that_the_text_names_exist():
    for text in TEXTS.values():
        for line in re.findall(r'make figures ARGS="([^"]+)"', text):
            name, option, setting = shlex.split(line)
            key, _, value = setting.partition("=")
            assert option == "-p" and NOTEBOOKS[name].parameters[key].value != float(value)
    for text in EXERCISES.values():
        place = re.search(r"^\*.*?\.\*(?= )", text.strip(), re.DOTALL)[0]
        known = set()
        for name in re.findall(r"notebooks/([^)]+)\.ipynb", place):
            known |= set(NOTEBOOKS[name].parameters)
        if "parameter" in place:
            assert set(re.findall(r"`([a-z_]+)`", place)) <= known
