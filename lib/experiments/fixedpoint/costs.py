"""What a sample of each filter costs: the committed table of the benchmark."""

import csv

from stillwork.base import paths
from stillwork.base.checks import InputError


def load_filter_times() -> dict[str, float]:
    """Median nanoseconds a sample by filter, measured once; the machine stands in ``SOURCE.md``.

    Raises
    ------
    InputError
        When the table is missing.
    """
    file = paths.data("fixedpoint", "filter_times.csv")
    if not file.exists():
        raise InputError(f"{file} is missing; write it with `python benchmarks/fixedpoint.py --write`")
    with file.open(encoding="utf-8", newline="") as rows:
        return {row["filter"]: float(row["median_ns"]) for row in csv.DictReader(rows)}
