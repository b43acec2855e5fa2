"""The course: its exercises' checks are what the tested solutions give, and its texts name what is there."""

import json
import os
import re
import shlex
import subprocess
import sys
from functools import cache

import pytest

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
import json, runpy, sys, time
found = {}
for name, solution in runpy.run_path(sys.argv[1]).items():
    if name.startswith("exercise_"):
        begun = time.process_time()
        try:
            found[name] = solution()
        except Exception as error:
            found[name] = repr(error)
        print(f"{name}: {found[name]}, {time.process_time() - begun:.2f} s", file=sys.stderr)
print(json.dumps(found))
"""


@cache
def answers(track: str) -> dict[int, str]:
    """What a track's solutions return, by the exercise's number."""
    done = subprocess.run(
        [sys.executable, "-c", RUN, str(COURSE / f"solutions/{track}.py")],
        env=os.environ | {"PYTHONPATH": str(paths.root() / "lib")},
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


@pytest.mark.parametrize("track", TRACKS)
def test_every_exercise_has_a_solution_a_notebook_and_a_hint(track):
    mine = {number: text for (name, number), text in EXERCISES.items() if name == track}
    assert list(mine) == list(range(1, len(mine) + 1))
    source = (COURSE / f"solutions/{track}.py").read_text(encoding="utf-8")
    assert re.findall(r"^def exercise_(\d+)\(", source, re.MULTILINE) == [str(number) for number in mine]
    for text in mine.values():
        assert "../../notebooks/" in text and "\n*Hint.* " in text and "?" in text


def test_the_course_leads_to_notebooks_that_are_there():
    linked = {
        name
        for text in TEXTS.values()
        for name in re.findall(r"\]\(\.\./\.\./notebooks/([^)]+)\.ipynb\)", text)
    }
    assert linked and linked <= set(NOTEBOOKS)


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
