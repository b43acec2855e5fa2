"""A new result: its notebook, its module, its ledger entry and its test, which run as they are and wait to be filled in."""

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
# headline = [{{ says = "What it says of itself first", entry = "{room}.{key}.deviation" }}]
"""

# A worked example stands in each place, so that the build, the ledger and the test run from the first minute.
ENTRY = """
# {name}

[{room}.{key}.deviation]
place = "section 0"  # where the work prints it
quantity = "standard deviation of the example"
unit = "1"
published = 2.1
kind = "value"  # value | exact | ordering | slope | reported | check
tolerance = {{ absolute = 0.05, source = "half the last printed digit" }}
"""

STORY = """\
# {title}

*Work, section 0: Fig. 0.*

What is claimed, what we do, what came out. The example: a paper prints eight values and their standard deviation, 2.1,
but not which one it means."""

MODEL = """\
## The model

$$s = \\sqrt{\\frac{1}{d} \\sum_{k=1}^{n} (x_k - \\bar x)^2}, \\qquad d = n - 1 \\quad \\text{or} \\quad d = n$$

with the values $x_k$, their mean $\\bar x$ and the divisor $d$, which the paper leaves open."""

IMPORTS = """\
from notebooks.{room}.{module} import VALUES, deviation
from workbook import Page, figures

page = Page("{room}/{name}")"""

PARAMETERS = 'divisor: str = "n - 1"  # of the variance: n - 1 or n'

FIGURE = """\
figure, axes = figures.new()
axes.plot(range(1, len(VALUES) + 1), VALUES, "o", label="values")
axes.set_xlabel("number")
axes.set_ylabel("value (1)")
page.save("fig-0", figure)"""

CHECK = 'page.check("{room}.{key}.deviation", deviation(VALUES, divisor))'

END = """\
## What agrees and what does not

Say here what agrees, what does not, and why."""

MODULE = '''"""What the notebook {name} and its open choices both compute."""

VALUES = (2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0)  # as printed


def deviation(values, divisor):
    """The standard deviation with the divisor ``n - 1`` or ``n``."""
    mean = sum(values) / len(values)
    return (sum((each - mean) ** 2 for each in values) / (len(values) - (divisor == "n - 1"))) ** 0.5


def study(divisor, seed, lean):
    """What the notebook checks, under one combination of the open choices; it needs neither a seed nor a lean form."""
    return {{"{room}.{key}.deviation": deviation(VALUES, divisor)}}
'''

TEST = '''"""{title}, against something that shares no code with it."""

import statistics

import pytest

from notebooks.{room}.{module} import VALUES, deviation


@pytest.mark.parametrize(("divisor", "other"), [("n - 1", statistics.stdev), ("n", statistics.pstdev)])
def test_the_deviation_is_that_of_the_standard_library(divisor, other):
    """The example; put in its place your algorithm against a naive twin, brute force or a closed form."""
    assert deviation(VALUES, divisor) == pytest.approx(other(VALUES))
'''

CHOICES = """\
# What the paper does not specify: each choice, with every option that a careful reader could defend.

[{room}.divisor]
question = "divisor of the variance"
options = ["n - 1", "n"]
default = "n - 1"  # what the notebook takes
kind = "definition"  # text | number | definition | procedure | seed
source = "the paper says 'standard deviation' and no more"
touches = ["{room}.{key}"]  # entries of the ledger, or first parts of their ids

[studies.{module}]
function = "notebooks.{room}.{module}:study"
entries = ["{room}.{key}.deviation"]
"""


def new_result(room: str, name: str, create: bool = False) -> list[str]:
    """Write the files of a new result, and of a new room what is said of its paper; returns their paths.

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
    words = words_of(room, name)
    key, module = words["key"], words["module"]
    notebook = notebook_file(f"{room}/{name}")
    beside = notebook.with_name(f"{module}.py")
    test = paths.root() / "tests" / room / f"test_{module}.py"
    ledger = paths.data(room, "published.toml")
    before = ledger.read_text(encoding="utf-8") if ledger.exists() else ""
    for file in (notebook, beside, test):
        if file.exists():
            raise InputError(f"{file.relative_to(paths.root())} exists already; choose another name")
    taken = sorted(each.stem for each in notebook.parent.glob("[0-9][0-9]-*.ipynb"))
    if same := [each for each in taken if each[:2] == name[:2]]:
        raise InputError(f"the number {name[:2]} is taken by {same[0]}; the last one is {taken[-1][:2]}")
    if f"[{room}.{key}." in before:
        raise InputError(f"the ledger has entries {room}.{key} already; choose another name")
    written = {
        notebook: notebook_text(_notebook(words)),
        beside: MODULE.format(**words),
        test: TEST.format(**words),
        ledger: (before + ENTRY.format(**words)).lstrip("\n"),
    }
    if create:
        about = {**words, "title": room.replace("_", " ").capitalize()}
        written[paths.data(room, "paper.toml")] = PAPER.format(**about)
    for file, text in written.items():
        replace_file(file, text.encode())
    return [file.relative_to(paths.root()).as_posix() for file in written]


def words_of(room: str, name: str) -> dict[str, str]:
    """What stands in the templates of a result."""
    key = name.partition("-")[2]
    return {
        "room": room,
        "name": name,
        "key": key,
        "module": key.replace("-", "_"),
        "title": key.replace("-", " ").capitalize(),
    }


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
