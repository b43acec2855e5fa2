"""The plotted numbers of every figure, as a fresh run gives them, against the committed ones.

`make test` runs all notebooks into build/nbval before; STILLWORK_REBUILT names another fresh build.
"""

import csv
import os
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from stillwork import paths

COMMITTED = paths.root() / "figures"
# Of the range that a series spans. Under the kernel's settings builds with AVX2 and FMA and with SSE2 alone
# (numba and numpy held to it) were equal; OpenBLAS's own choice of kernels moved numbers by up to 2.5e-6,
# experiments on rounding aside. The rest is room for another system's libm.
TOLERANCE = 1e-4

REBUILT = Path(os.environ.get("STILLWORK_REBUILT") or paths.root() / "build" / "nbval")


def tables(folder: Path) -> set[str]:
    return {file.relative_to(folder).as_posix() for file in folder.glob("*/*/*.csv")}


def series(file: Path) -> dict[tuple[str, ...], np.ndarray]:
    """Rows of x, y, z by panel and name, in the order of the file."""
    with file.open(newline="", encoding="utf-8") as text:
        rows = list(csv.reader(text))
    assert rows[0] == ["panel", "series", "x", "y", "z"]
    groups = {}
    for name, group in groupby(rows[1:], key=lambda row: tuple(row[:2])):
        values = np.array([[float(value or "nan") for value in row[2:]] for row in group])
        groups.setdefault(name, []).append(values)
    return {name: np.concatenate(parts) for name, parts in groups.items()}


def distance(now: np.ndarray, before: np.ndarray) -> float:
    """Largest difference, as a part of the range that the committed numbers span.

    Positive numbers that span more than a decade are drawn on a logarithmic axis and compared on one.
    """
    known = np.isfinite(before)
    if not np.array_equal(known, np.isfinite(now)):
        return np.inf
    if not known.any():
        return 0.0
    now, before = now[known], before[known]
    if before.min() > 0 and before.max() > 10 * before.min():
        if now.min() <= 0:
            return np.inf
        now, before = np.log(now), np.log(before)
    span = np.ptp(before) or np.abs(before).max() or 1.0
    return float(np.abs(now - before).max() / span)


def test_every_figure_was_rebuilt_and_every_rebuilt_one_is_committed():
    assert tables(COMMITTED)
    assert tables(REBUILT) == tables(COMMITTED)


def test_every_table_has_its_picture():
    for name in tables(COMMITTED):
        assert (COMMITTED / name).with_suffix(".png").read_bytes().startswith(b"\x89PNG"), name


@pytest.mark.parametrize("name", sorted(tables(COMMITTED)))
def test_a_fresh_run_plots_the_committed_numbers(name):
    before, now = series(COMMITTED / name), series(REBUILT / name)
    assert list(now) == list(before)
    for key, values in before.items():
        assert now[key].shape == values.shape, key
        for column, axis in enumerate("xyz"):
            assert distance(now[key][:, column], values[:, column]) <= TOLERANCE, (key, axis)
