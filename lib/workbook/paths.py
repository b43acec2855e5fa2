"""Where things stand: the workbook's root folder, its topics, and where a notebook writes."""

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from workbook.checks import InputError, nearest, read_toml, require_number, short_repr

OUTPUT_VARIABLE, ROOT_VARIABLE = "STILLWORK_OUTPUT", "STILLWORK_ROOT"


def root() -> Path:
    """Folder that holds `notebooks/`, `data/` and `figures/`.

    It is what the environment variable `STILLWORK_ROOT` names, else the folder at or above the present one with a
    ledger, else the checkout that this package runs from.
    """
    named = os.environ.get(ROOT_VARIABLE)
    folder = Path(named) if named else _around(os.getcwd()) or Path(__file__).parents[2]
    if not (folder / "data").is_dir():
        raise FileNotFoundError(
            f"no workbook at {folder if named else os.getcwd()} (no data/ folder); run this in one, set "
            f"{ROOT_VARIABLE} to one, or begin one: python -m workbook init DIR"
        )
    return folder


@cache
def _around(folder: str) -> Path | None:
    places = (Path(folder), *Path(folder).parents)
    return next((place for place in places if any(place.glob("data/*/published.toml"))), None)


@contextmanager
def under(variables: Mapping[str, str]) -> Iterator[None]:
    """Let these be all variables of the environment for a while."""
    before = dict(os.environ)
    os.environ.clear()
    os.environ.update(variables)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def rooted(folder: Path):
    """Let the root be another folder for a while."""
    return under({**os.environ, ROOT_VARIABLE: str(folder)})


def topics() -> tuple[str, ...]:
    """The topics, which are the folders of ``data/`` with a ledger, by the `order` in their ``paper.toml``, then by name.

    It reads what belongs to every topic. What a notebook calls uses `require_topic`, which reads nothing: else a topic
    that is added would make the results of the others stale.
    """
    there = [file.parent.name for file in (root() / "data").glob("*/published.toml")]
    return tuple(sorted(filter(is_topic, there), key=lambda topic: (_order(topic), topic)))


def _order(topic: str) -> float:
    file = data(topic, "paper.toml")
    given = read_toml(file) if file.is_file() else {}
    return require_number(f"{file}: order", given["order"]) if "order" in given else math.inf


def is_topic(name: str) -> bool:
    """Whether there is such a topic."""
    return name.isidentifier() and os.path.isfile(data(name, "published.toml"))  # however long the name


def require_topic(name: str) -> str:
    """Return `name` when it is a topic's, else raise `InputError` with the nearest one."""
    if not isinstance(name, str) or not is_topic(name):
        raise InputError(
            f"topic is {short_repr(name)}; use one of {', '.join(topics())}{nearest(name, topics())}"
        )
    return name


def data(topic: str, name: str = "") -> Path:
    """Path of a shipped data file of a topic, e.g. ``data("isolation", "rigid_body.toml")``."""
    return root() / "data" / topic / name


def own_settings() -> dict:
    """``[tool.workbook]`` of pyproject.toml; empty if it is missing."""
    file = root() / "pyproject.toml"
    return read_toml(file).get("tool", {}).get("workbook", {}) if file.is_file() else {}


def packages() -> tuple[str, ...]:
    """Folders of modules that pyproject.toml names, besides those beside notebooks and in ``experiments``."""
    return tuple(own_settings().get("packages", ()))


def in_batch() -> bool:
    """Whether the runner or the tests, not a person, execute the notebook."""
    return OUTPUT_VARIABLE in os.environ


def output(notebook: str) -> Path:
    """Folder that `notebook` (``topic/name``) writes to: the runner's, or ``build/interactive``."""
    base = os.environ.get(OUTPUT_VARIABLE)
    return (Path(base) if base else root() / "build" / "interactive") / notebook
