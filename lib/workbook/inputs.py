"""What a notebook's results depend on, and what of it changed since they were built.

All of it is known before anything runs: code cells and parameters, the files that these name, the code and data that the
cells lead to (`workbook.dependencies`), the pins of environment.txt of the packages that a kernel loads, and the
processor's settings. Only of the ledger it is the build that says which entries the notebook claims.
"""

import platform
from functools import cache, lru_cache
from pathlib import Path

from workbook import paths
from workbook.checks import InputError
from workbook.claims import load_entries
from workbook.dependencies import dependencies, file_digest, names_ledger, normal, packages
from workbook.environment import pins
from workbook.notebooks import Notebook
from workbook.pinned import passed_inputs, settings
from workbook.publish import digest

ENVIRONMENT = ("environment: ", "setting ")
LEDGER = "ledger "
VALUES = ("parameter ", *ENVIRONMENT)  # inputs kept as they are; of the others a digest


def environment_inputs(loaded: set[str] | None = None) -> dict[str, str]:
    """The pins of the packages that are loaded (all without a set), Python, and the processor's settings."""
    pinned = _pins(paths.root())
    found = {f"environment: {name}": pin for name, pin in pinned.items() if loaded is None or name in loaded}
    found["environment: Python"] = platform.python_version()
    return found | {f"setting {name}": value for name, value in {**passed_inputs(), **settings()}.items()}


@cache
def _pins(root: Path) -> dict[str, str]:
    """Of the workbook at `root`, the present one."""
    return {normal(name): version for name, version in pins().items()}


def notebook_inputs(notebook: Notebook, values: dict[str, object]) -> dict[str, str]:
    """All that a notebook's results depend on but the entries of the ledger that it claims."""
    sources = tuple(notebook.cells.values())
    found = {f"cell {name}": digest(source.encode()) for name, source in notebook.cells.items()}
    found["order of the cells"] = digest("\n".join(notebook.cells).encode())
    for name, parameter in notebook.parameters.items():
        value = values.get(name, parameter.value)
        found[f"parameter {name}"] = repr(value)
        if isinstance(value, str) and (now := _file_of(value)) is not None:
            found[f"file {value}"] = now
    found |= dependencies(sources) | environment_inputs(packages(sources))
    return found | (ledger_inputs(notebook.topic) if names_ledger(sources) else {})


def _file_of(value: str) -> str | None:
    """Digest of the file that a parameter names; None where it names none."""
    try:
        path = paths.root() / value
        return file_digest(path) if path.is_file() else None
    except ValueError:  # no path, such as a text with a null
        return None


def present_again(before: dict[str, str]) -> dict[str, str]:
    """Of the inputs that a build saw, the entries of the ledger as they are now."""
    return claimed_inputs({name.removeprefix(LEDGER) for name in before if name.startswith(LEDGER)})


def claimed_inputs(claimed: set[str]) -> dict[str, str]:
    """The entries of the ledger with these ids; all that can be said of a topic whose file is malformed."""
    return {
        name: value
        for topic in {each.partition(".")[0] for each in claimed}
        for name, value in ledger_inputs(topic).items()
        if name.removeprefix(LEDGER) in claimed or "." not in name
    }


def changes(before: dict[str, str], now: dict[str, str]) -> list[str]:
    """One reason for each input that differs."""
    reasons = []
    for name in [*now, *(name for name in before if name not in now)]:
        if name not in before:
            reasons.append(f"{name} added")
        elif name not in now:
            reasons.append(f"{name} removed")
        elif before[name] != now[name]:
            shown = f"{before[name]} -> {now[name]}" if name.startswith(VALUES) else "changed"
            space = ": " if name.startswith("parameter ") else " "
            reasons.append(f"{name}{space}{shown}")
    if len(reasons) > 1:  # a cell that came or went moved the order, too
        reasons = [reason for reason in reasons if not reason.startswith("order of the cells")]
    return reasons


def ledger_inputs(topic: str) -> dict[str, str]:
    """A digest of every entry of a topic; of the whole file where it is malformed."""
    file = paths.data(topic, "published.toml")
    return dict(_entries(topic, file.read_bytes())) if file.is_file() else {}


@lru_cache(maxsize=32)  # needed by every notebook of a topic
def _entries(topic: str, text: bytes) -> dict[str, str]:
    try:
        return {
            f"{LEDGER}{name}": digest(repr(entry).encode()) for name, entry in load_entries(topic).items()
        }
    except InputError:  # the notebooks will report what is wrong with it
        return {f"{LEDGER}{topic}": digest(text)}
