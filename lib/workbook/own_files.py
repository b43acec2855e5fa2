"""What the workbook has to do with a file of one's own: whether it wrote it, and the commands that take it."""

import re
import shlex
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from stillwork.base.checks import InputError, counted
from stillwork.base.toml_files import read_toml
from workbook import paths
from workbook.figures import HEADER, read_table
from workbook.notebook_source import comments
from workbook.notebooks import select


def own_file(path: Path) -> str:
    """What a file that the workbook itself wrote or reads is, in a sentence; empty for other files."""
    if path.suffix.lower() == ".csv":
        with path.open(encoding="utf-8", errors="replace") as file:
            first = file.readline().strip()
        if tuple(first.split(",")) == HEADER:
            table = read_table(path)
            panels, points = len({panel for panel, _ in table}), sum(map(len, table.values()))
            held = f"{counted(points, 'point')} of {len(table)} series in {counted(panels, 'panel')}"
            notebook = "/".join(path.resolve().parts[-3:-1])
            known = in_checkout() and notebook in {each.name for each in select()}
            again = f"; to build it anew: python -m stillwork figures {notebook} --force" if known else ""
            return f"the numbers that the picture {path.stem}.png shows, {held}{again}"
        if first.startswith("# study "):
            return "what the ledger's entries come to under each reading; see python -m stillwork claims --entry ID"
    if path.name in ("published.toml", "readings.toml") and len(table := read_toml(path)) > 0:
        room = next(iter(table))
        if path.name == "readings.toml" and "studies" in table:
            return f"the {len(table[room])} choices that the work of the room {room} leaves open; to try them: python -m stillwork readings {room}"
        if paths.is_room(room):
            return (
                f"the published numbers of the room {room}; how they stand: python -m stillwork claims {room}"
            )
    return ""


def machines() -> dict[str, tuple[str, str]]:
    """What reads a machine of one's own from TOML, ``module:function`` by room, and the file to copy."""
    said = {room: paths.data(room, "paper.toml") for room in paths.rooms()}
    found = {room: read_toml(file).get("machine", {}) for room, file in said.items() if file.is_file()}
    return {room: (each["read"], each["copy"]) for room, each in found.items() if each}


def model_file(path: Path) -> Iterator[str]:
    """What a TOML file holds, and the rooms and commands that take it as a machine."""
    table = read_toml(path)
    yield f"{path.name}: {counted(len(table), 'entry')}"
    for name, value in table.items():
        shown = f"table of {', '.join(value)}" if isinstance(value, dict) else repr(value)
        yield f"  {name}: {shown}"
    if not in_checkout():
        yield "whether it is a machine of the workbook, a checkout of stillwork can tell: run this there"
        return
    lacking, known = {}, machines()
    for room, (reader, _) in known.items():
        module, _, function = reader.partition(":")
        try:
            getattr(import_module(module), function)(path)
        except InputError as error:
            lacking[room] = error
        else:
            yield f"a machine of the room {room}: {module}.{function}({str(path)!r})"
            yield from _takers(path, room)
    if len(lacking) == len(known):
        templates = {room: paths.data(room, name) for room, (_, name) in known.items()}
        meant = [room for room, file in templates.items() if table.keys() & read_toml(file).keys() - {"name"}]
        if len(meant) == 1:
            yield f"not a machine of the room {meant[0]}: {lacking[meant[0]]}"
        else:
            begin = " or ".join(file.relative_to(paths.root()).as_posix() for file in templates.values())
            yield f"no machine that a notebook takes; begin with a copy of {begin}"


def _takers(path: Path, room: str) -> Iterator[str]:
    """The command for each notebook of a room with a parameter whose comment asks for the path of a TOML file."""
    for notebook in select(room):
        for name, comment in comments(notebook).items():
            if re.search(r"\bpath\b.*\bTOML\b", comment):
                yield figures_command(notebook.name, {name: path.resolve()})


def figures_command(notebook: str, settings: dict) -> str:
    """The line for a shell that runs a notebook with these settings."""
    words = [word for key, value in settings.items() for word in ("-p", f"{key}={value}")]
    return command(f"for {notebook}", ["figures", notebook, *words])


def command(purpose: str, words: list[str]) -> str:
    """A line for a shell, with every name as one word of it."""
    for word in words:
        if not word.isprintable():  # a terminal acts on a control code that is pasted, quoted or not
            held = word.partition("=")[2] or word
            return f"no command {purpose if purpose.startswith('for ') else 'for ' + purpose}: {held} holds what cannot be typed; rename it and ask again"
    return f"{purpose}: {shlex.join(['python', '-m', 'stillwork', *words])}"


def in_checkout() -> bool:
    """Whether the experiments and the notebooks are at hand, which a wheel does not hold."""
    try:
        return find_spec("experiments") is not None and (paths.root() / "notebooks").is_dir()
    except FileNotFoundError:
        return False
