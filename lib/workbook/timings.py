"""Times that a benchmark measured once: committed tables, because a time taken anew changes at every build."""

import csv
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

from workbook import paths
from workbook.checks import InputError


def measured_times(topic: str, table: str) -> dict[str, dict[str, float]]:
    """Times by what was timed; the machine stands in the ``SOURCE.md`` beside the table.

    Parameters
    ----------
    topic : str
    table : str
        A CSV file below the topic's data. Its first column names what was timed, the others hold numbers.

    Returns
    -------
    dict of str to dict of str to float
        Numbers by the headings of their columns, such as ``median_us``.

    Raises
    ------
    InputError
        When the table is missing.
    """
    file = paths.data(topic, table)
    if not file.exists():
        raise InputError(f"{file} is missing; write it with `python benchmarks/{topic}.py --write`")
    with file.open(encoding="utf-8", newline="") as lines:
        headings, *rows = csv.reader(lines)
    return {name: dict(zip(headings[1:], map(float, row), strict=True)) for name, *row in rows}


@dataclass(frozen=True)
class Benchmark:
    """A table of times and of their ratios to one of them.

    Attributes
    ----------
    topic, title, unit, command, machine : str
        What it is of, and how and where it was measured.
    over : str
        What the ratios are to.
    headings : tuple of str
        Of the columns, such as numbers of unknowns; one that is empty where there is one column.
    rows : tuple of (str, tuple of (float, float))
        What was timed; its time and ratio in each column.
    """

    topic: str
    title: str
    unit: str
    command: str
    machine: str
    over: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, tuple[tuple[float, float], ...]], ...]


def benchmarks() -> list[Benchmark]:
    """The tables whose file is there, in the order of ``benchmarks/tables.toml``; none in a workbook without it."""
    listed = paths.root() / "benchmarks" / "tables.toml"
    tables = tomllib.loads(listed.read_text(encoding="utf-8"))["table"] if listed.exists() else []
    return [_benchmark(**table) for table in tables if paths.data(table["topic"], table["file"]).exists()]


def _benchmark(topic, file, title, unit, over, command, names, across="", rows=()) -> Benchmark:
    times = measured_times(topic, file)
    if across:  # what was timed stands in the rows
        columns = {"": {name: row[across] for name, row in times.items()}}
    else:
        columns = {size: times[size] for size in rows}
    return Benchmark(
        topic,
        title,
        unit,
        command,
        _machine(paths.data(topic, file)),
        names[over],
        tuple(columns),
        tuple(
            (text, tuple((column[name], column[name] / column[over]) for column in columns.values()))
            for name, text in names.items()
        ),
    )


def _machine(table: Path) -> str:
    source = table.parent / "SOURCE.md"
    if found := re.search(r"^Machine: (.+)$", source.read_text(encoding="utf-8"), re.MULTILINE):
        return found[1].rstrip(".")
    raise InputError(f"{source} has no line 'Machine: ...'; state where the times were measured")
