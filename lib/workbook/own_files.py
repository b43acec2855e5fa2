"""What the workbook has to do with a file of one's own: the notebooks that take it as a machine."""

import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from workbook import paths
from workbook.checks import is_refusal, read_toml
from workbook.notebook_source import comments
from workbook.notebooks import select


def machines() -> dict[str, tuple[str, str]]:
    """The reader of your own machine from TOML, ``module:function`` by topic, and the file to copy."""
    files = {topic: paths.data(topic, "paper.toml") for topic in paths.topics()}
    found = {topic: read_toml(file).get("machine", {}) for topic, file in files.items() if file.is_file()}
    return {topic: (each["read"], each["copy"]) for topic, each in found.items() if each}


def model_file(path: Path) -> Iterator[str | tuple[str, dict]]:
    """The topics that can use a TOML file as a machine, and their notebooks, each with its settings."""
    lacking, known = {}, machines()
    for topic, (reader, _) in known.items():
        module, _, function = reader.partition(":")
        try:
            getattr(import_module(module), function)(path)
        except ValueError as error:
            if not is_refusal(error):
                raise
            lacking[topic] = error
        else:
            yield f"a machine of the topic {topic}: {module}.{function}({str(path)!r})"
            yield from _takers(path, topic)
    if len(lacking) == len(known):
        templates = (paths.data(topic, name).relative_to(paths.root()) for topic, (_, name) in known.items())
        yield f"matches the machine of no notebook; start from a copy of {' or '.join(map(str, templates))}"
        yield from (f"not a machine of the topic {topic}: {error}" for topic, error in lacking.items())


def _takers(path: Path, topic: str) -> Iterator[tuple[str, dict]]:
    """Each notebook of a topic with a parameter that is the path of a TOML file by its comment."""
    for notebook in select(topic):
        for name, comment in comments(notebook).items():
            if re.search(r"\bpath\b.*\bTOML\b", comment):
                yield notebook.name, {name: path.resolve()}
