"""A new result: its notebook, its ledger entry and its test, which run as they are and wait to be filled in."""

import re
from keyword import iskeyword

from stillwork.base.checks import InputError, nearest
from workbook import paths
from workbook.notebooks import METADATA, notebook_file, notebook_text
from workbook.publish import replace_file

PAPER = """\
# What the front page says of the paper. Every field may be left out; CONTRIBUTING.md lists them, under "Add a room".
title = "{title}"
paper = "Title of the paper"
# source = "Where it was published: with it, the paper is cited"
# by = "Author, year"
# claimed = "What it claims, in a sentence."
# headline = [{{ says = "What it says of itself first", entry = "{room}.{key}.decrement" }}]
"""

# A worked example stands in each place, so that the build, the ledger and the test run from the first minute.
ENTRY = """
# {name}

[{room}.{key}.decrement]
place = "section 0"  # where the work prints it
quantity = "logarithmic decrement of the example"
unit = "1"
published = 0.63
kind = "value"  # value | exact | ordering | slope | reported | check
tolerance = {{ absolute = 0.005, source = "half the last printed digit" }}
"""

STORY = """\
# {title}

*Work, section 0: Fig. 0.*

What is claimed, what we do, what came out. The example: a free vibration decays by the same factor each period."""

MODEL = """\
## The model

$$\\ddot x + 2 \\zeta \\omega_0 \\dot x + \\omega_0^2 x = 0, \\qquad
\\delta = \\ln \\frac{x(t)}{x(t + T)} = \\frac{2 \\pi \\zeta}{\\sqrt{1 - \\zeta^2}}$$

with the displacement $x$, the relative damping $\\zeta$ and the natural frequency $\\omega_0$ (rad/s). A period takes $T$;
$\\delta$ is the logarithmic decrement."""

IMPORTS = """\
import numpy as np

from workbook import Page, figures

page = Page("{room}/{name}")"""

PARAMETERS = """\
damping: float = 0.1  # relative damping
periods: int = 8  # shown"""

FIGURE = """\
time = np.linspace(0, periods, 200 * periods + 1)
rate = 2 * np.pi * damping / np.sqrt(1 - damping**2)
motion = np.exp(-rate * time) * np.cos(2 * np.pi * time)
figure, axes = figures.new()
axes.plot(time, motion, label="displacement")
axes.set_xlabel("time (periods)")
axes.set_ylabel("displacement (1)")
page.save("fig-0", figure)"""

CHECK = 'page.check("{room}.{key}.decrement", np.log(motion[0] / motion[200]))'

END = """\
## What agrees and what does not

Say here what agrees, what does not, and why."""

TEST = '''"""{title}, against something that shares no code with it."""

import numpy as np
import pytest


@pytest.mark.parametrize("damping", [0.01, 0.1, 0.5])
def test_the_decrement_is_that_of_an_integrated_oscillator(damping):
    """The example; put in its place your algorithm against a naive twin, brute force or a closed form."""
    position, velocity, step = 1.0, 0.0, 1e-4
    peaks = []
    while len(peaks) < 2:
        before = velocity
        velocity -= step * (position + 2 * damping * velocity)
        position += step * velocity
        if before > 0 >= velocity:
            peaks.append(position)
    decrement = 2 * np.pi * damping / np.sqrt(1 - damping**2)
    assert np.log(peaks[0] / peaks[1]) == pytest.approx(decrement, rel=2e-3)
'''


def new_result(room: str, name: str, create: bool = False) -> list[str]:
    """Write the three files of a new result, and of a new room what is said of its paper; returns their paths.

    Parameters
    ----------
    room : str
        A room's name.
    name : str
        ``nn-result``, e.g. ``09-payload``.
    create : bool
        Whether the room is a new one, which this begins.

    Raises
    ------
    InputError
        When there is no such room (or, to be created, it is there), a name has another form, or it is taken.
    """
    if create:
        _require_new_room(room)
    elif not paths.is_room(room):
        raise InputError(
            f"there is no room {room!r}{nearest(room, paths.rooms())}; to begin it, give --create"
        )
    if not re.fullmatch(r"\d\d-[a-z][a-z0-9]*(-[a-z0-9]+)*", name):
        raise InputError(f"name is {name!r}; give a number and words like '09-payload'")
    key = name.partition("-")[2]
    words = {"room": room, "name": name, "key": key, "title": key.replace("-", " ").capitalize()}
    notebook = notebook_file(f"{room}/{name}")
    test = paths.root() / "tests" / room / f"test_{key.replace('-', '_')}.py"
    ledger = paths.data(room, "published.toml")
    before = ledger.read_text(encoding="utf-8") if ledger.exists() else ""
    for file in (notebook, test):
        if file.exists():
            raise InputError(f"{file.relative_to(paths.root())} exists already; choose another name")
    taken = sorted(each.stem for each in notebook.parent.glob("[0-9][0-9]-*.ipynb"))
    if same := [each for each in taken if each[:2] == name[:2]]:
        raise InputError(f"the number {name[:2]} is taken by {same[0]}; the last one is {taken[-1][:2]}")
    if f"[{room}.{key}." in before:
        raise InputError(f"the ledger has entries {room}.{key} already; choose another name")
    written = {
        notebook: notebook_text(_notebook(words)),
        test: TEST.format(**words),
        ledger: (before + ENTRY.format(**words)).lstrip("\n"),
    }
    if create:
        about = {**words, "title": room.replace("_", " ").capitalize()}
        written[paths.data(room, "paper.toml")] = PAPER.format(**about)
    for file, text in written.items():
        replace_file(file, text.encode())
    return [file.relative_to(paths.root()).as_posix() for file in written]


def _require_new_room(room: str) -> None:
    if not re.fullmatch(r"[a-z][a-z0-9_]*", room) or iskeyword(room):
        raise InputError(f"room is {room!r}; give small letters, digits and _, as Python's modules have")
    if paths.is_room(room):
        raise InputError(f"the room {room} is there already; leave out --create")


def _notebook(words: dict[str, str]) -> dict:
    cells = [
        _cell("title", STORY.format(**words), "markdown"),
        _cell("model", MODEL, "markdown"),
        _cell("imports", IMPORTS.format(**words)),
        _cell("parameters", PARAMETERS, tags=["parameters"]),
        _cell("figure-text", "## Fig. 0", "markdown"),
        _cell("figure", FIGURE),
        _cell("check", CHECK.format(**words)),
        _cell("claims-text", "## Claims", "markdown"),
        _cell("claims", "page.claims"),
        _cell("conclusion", END, "markdown"),
    ]
    return {"cells": cells, "metadata": METADATA, "nbformat": 4, "nbformat_minor": 5}


def _cell(name: str, source: str, kind: str = "code", tags: list[str] | None = None) -> dict:
    cell = {
        "cell_type": kind,
        "id": name,
        "metadata": {"tags": tags} if tags else {},
        "source": source.splitlines(True),
    }
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})
