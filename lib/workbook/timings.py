"""Times that a benchmark measured once: committed tables, because a time taken anew changes at every build."""

import csv
import re
import tomllib
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


def benchmarks() -> list[dict]:
    """The tables whose file is there, in the order of ``benchmarks/tables.toml``; none in a workbook without it.

    Each has its fields of that file and the ``machine``; the ``headings`` of its columns, such as numbers of unknowns (an empty one
    where there is one column); and ``rows``: what was timed, and of each column its time and the ratio to `over`.
    """
    listed = paths.root() / "benchmarks" / "tables.toml"
    tables = tomllib.loads(listed.read_text(encoding="utf-8"))["table"] if listed.exists() else []
    return [_benchmark(table) for table in tables if paths.data(table["topic"], table["file"]).exists()]


def _benchmark(table: dict) -> dict:
    times = measured_times(table["topic"], table["file"])
    if across := table.get("across"):  # what was timed stands in the rows
        columns = {"": {name: row[across] for name, row in times.items()}}
    else:
        columns = {size: times[size] for size in table["rows"]}
    over, names = table["over"], table["names"]
    rows = [
        (text, [(column[name], column[name] / column[over]) for column in columns.values()])
        for name, text in names.items()
    ]
    machine = _machine(paths.data(table["topic"], table["file"]))
    return {**table, "over": names[over], "headings": list(columns), "rows": rows, "machine": machine}


def _machine(table: Path) -> str:
    source = table.parent / "SOURCE.md"
    if found := re.search(r"^Machine: (.+)$", source.read_text(encoding="utf-8"), re.MULTILINE):
        return found[1].rstrip(".")
    raise InputError(f"{source} has no line 'Machine: ...'; state where the times were measured")
