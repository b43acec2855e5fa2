"""What the workbook has to do with a file of one's own: the commands that take it."""

import re
import shlex
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from stillwork.base.checks import InputError, pluralise
from stillwork.base.toml_files import read_toml
from workbook import paths
from workbook.notebook_source import comments
from workbook.notebooks import select


def machines() -> dict[str, tuple[str, str]]:
    """The reader of your own machine from TOML, ``module:function`` by topic, and the file to copy."""
    files = {topic: paths.data(topic, "paper.toml") for topic in paths.topics()}
    found = {topic: read_toml(file).get("machine", {}) for topic, file in files.items() if file.is_file()}
    return {topic: (each["read"], each["copy"]) for topic, each in found.items() if each}


def model_file(path: Path) -> Iterator[str]:
    """What a TOML file holds, and the topics and commands that can use it as a machine."""
    table = read_toml(path)
    yield f"{path.name}: {pluralise(len(table), 'entry')}"
    for name, value in table.items():
        shown = f"table of {', '.join(value)}" if isinstance(value, dict) else repr(value)
        yield f"  {name}: {shown}"
    if not in_checkout():
        yield "run this in the cloned repository to check whether it is a machine of the workbook"
        return
    lacking, known = {}, machines()
    for topic, (reader, _) in known.items():
        module, _, function = reader.partition(":")
        try:
            getattr(import_module(module), function)(path)
        except InputError as error:
            lacking[topic] = error
        else:
            yield f"a machine of the topic {topic}: {module}.{function}({str(path)!r})"
            yield from _takers(path, topic)
    if len(lacking) == len(known):
        templates = {topic: paths.data(topic, name) for topic, (_, name) in known.items()}
        meant = [
            topic for topic, file in templates.items() if table.keys() & read_toml(file).keys() - {"name"}
        ]
        if len(meant) == 1:
            yield f"not a machine of the topic {meant[0]}: {lacking[meant[0]]}"
        else:
            begin = " or ".join(file.relative_to(paths.root()).as_posix() for file in templates.values())
            yield f"matches the machine of no notebook; start from a copy of {begin}"


def _takers(path: Path, topic: str) -> Iterator[str]:
    """The command for each notebook of a topic with a parameter that is the path of a TOML file by its comment."""
    for notebook in select(topic):
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
            return f"no command {purpose if purpose.startswith('for ') else 'for ' + purpose}: {held} holds characters that cannot be typed; rename it and run this again"
    return f"{purpose}: {shlex.join(['python', '-m', 'stillwork', *words])}"


def in_checkout() -> bool:
    """Whether the experiments and the notebooks are at hand, which a wheel does not hold."""
    try:
        return find_spec("experiments") is not None and (paths.root() / "notebooks").is_dir()
    except FileNotFoundError:
        return False
