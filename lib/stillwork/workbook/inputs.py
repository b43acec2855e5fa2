"""What a notebook's results depend on, and what of it changed since they were built."""

import hashlib
import json
import platform
import tomllib
from pathlib import Path

import stillwork
from stillwork import paths
from stillwork.workbook.environment import pins
from stillwork.workbook.jupyter_kernel import KERNEL_SETTINGS
from stillwork.workbook.notebooks import Notebook

LIBRARY = Path(stillwork.__file__).parent
NOTEBOOKS_OWN = ("cell ", "order ", "parameter ", "file ")  # first words of `notebook_inputs`
VALUES = ("parameter ", "environment: ", "setting ")  # inputs kept as they are; of the others a digest


def room_inputs(room: str) -> dict[str, str]:
    """Inputs that all notebooks of a room share, by a name that a person understands.

    They are: the room's library, the shared modules, the room's data, the pins of environment.txt, the Python
    and the kernel's settings. Of the ledger, what the last accepted build gave (``ours``) is left out: it
    follows from the results.
    """
    found = {}
    for file in sorted([*shared_modules(), *(LIBRARY / room).rglob("*.py")]):
        found[f"lib/stillwork/{file.relative_to(LIBRARY).as_posix()}"] = digest(file.read_bytes())
    folder = paths.data(room)
    for file in sorted(folder.rglob("*")):
        if file.name == "published.toml" and file.parent == folder:
            found |= _ledger(file)
        elif file.is_file() and not file.name.startswith("."):
            found[f"data/{room}/{file.relative_to(folder).as_posix()}"] = digest(file.read_bytes())
    found |= {f"environment: {name}": version for name, version in pins().items()}
    found["environment: Python"] = platform.python_version()
    found |= {f"setting {name}": value for name, value in KERNEL_SETTINGS.items()}
    return found


def shared_modules() -> list[Path]:
    """The modules that every room may use: all but the command line, the builder, the site and the rooms."""
    others = ("__main__.py", "workbook", "site", *paths.ROOMS)
    return sorted(file for file in LIBRARY.rglob("*.py") if file.relative_to(LIBRARY).parts[0] not in others)


def notebook_inputs(notebook: Notebook, settings: dict[str, object]) -> dict[str, str]:
    """Inputs of one notebook alone: its code cells, its parameters, and the files that parameters name."""
    found = {f"cell {name}": digest(source.encode()) for name, source in notebook.cells.items()}
    found["order of the cells"] = digest("\n".join(notebook.cells).encode())
    for name, parameter in notebook.parameters.items():
        value = settings.get(name, parameter.value)
        found[f"parameter {name}"] = repr(value)
        if isinstance(value, str) and (file := paths.root() / value).is_file():
            found[f"file {value}"] = digest(file.read_bytes())
    return found


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


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _ledger(file: Path) -> dict[str, str]:
    try:
        tree = tomllib.loads(file.read_text(encoding="utf-8"))
    except tomllib.TOMLDecodeError:  # the notebooks will say what is wrong with it
        return {f"ledger {file.parent.name}": digest(file.read_bytes())}
    found = {}

    def walk(branch, path):
        if not isinstance(branch, dict) or "place" in branch:
            kept = {k: v for k, v in branch.items() if k != "ours"} if isinstance(branch, dict) else branch
            found[f"ledger {'.'.join(path)}"] = digest(json.dumps(kept, default=str).encode())
        else:
            for name, twig in branch.items():
                walk(twig, (*path, name))

    walk(tree, ())
    return found
