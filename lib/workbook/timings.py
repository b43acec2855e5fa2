"""Times that a benchmark measured once: committed tables, because a time taken anew changes at every build."""

import csv

from stillwork.base.checks import InputError
from workbook import paths


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
