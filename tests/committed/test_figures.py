"""The plotted numbers of every figure, as a fresh run gives them, against the committed ones.

`make test` runs all notebooks into build/nbval before; STILLWORK_REBUILT names another fresh build.
"""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from stillwork import paths
from stillwork.figures import read_table

COMMITTED = paths.root() / "figures"
# Of the range that a series spans. Under the kernel's settings builds with AVX2 and FMA and with SSE2 alone
# (numba and numpy held to it) were equal; OpenBLAS's own choice of kernels moved numbers by up to 2.5e-6,
# experiments on rounding aside. The rest is room for another system's libm.
TOLERANCE = 1e-4

# A line that was thinned may have kept other points of the same curve where a value lay on the edge: then the
# points of each must lie on the other, to what the thinning may leave out and the tolerance.
THINNED = 1e-3

REBUILT = Path(os.environ.get("STILLWORK_REBUILT") or paths.root() / "build" / "nbval")


def tables(folder: Path) -> set[str]:
    return {file.relative_to(folder).as_posix() for file in folder.glob("*/*/*.csv")}


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


def apart(now: np.ndarray, before: np.ndarray) -> float:
    """Largest distance of a point of either line from the other line, as a part of the committed one's range.

    A table does not say whether an axis was logarithmic; the scale in which the lines are closest counts.
    """
    found = []
    for scales in itertools.product((np.array, np.log), repeat=2):
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (np.c_[scales[0](line[:, 0]), scales[1](line[:, 1])] for line in (now, before))
        if np.isfinite(first).sum() == np.isfinite(now[:, :2]).sum():
            span = np.nanmax(second, axis=0) - np.nanmin(second, axis=0)
            first, second = first / np.where(span > 0, span, 1.0), second / np.where(span > 0, span, 1.0)
            found.append(max(_off(first, second), _off(second, first)))
    return min(found, default=np.inf)


def _off(points: np.ndarray, line: np.ndarray) -> float:
    """Largest distance of the finite points from the line."""
    points = points[np.isfinite(points).all(axis=1)]
    start, step = line[:-1], np.diff(line, axis=0)
    there = np.isfinite(step).all(axis=1)
    start, step = start[there], step[there]
    if not len(points) or not len(start):
        return 0.0 if len(points) == len(start) else np.inf
    length = np.maximum((step**2).sum(axis=1), 1e-300)
    worst = 0.0
    for point in points:
        share = np.clip(((point - start) * step).sum(axis=1) / length, 0, 1)
        worst = max(worst, np.hypot(*(start + share[:, None] * step - point).T).min())
    return worst


def test_every_figure_was_rebuilt_and_every_rebuilt_one_is_committed():
    assert tables(COMMITTED)
    assert tables(REBUILT) == tables(COMMITTED)


def test_every_table_has_its_picture():
    for name in tables(COMMITTED):
        assert (COMMITTED / name).with_suffix(".png").read_bytes().startswith(b"\x89PNG"), name


@pytest.mark.parametrize("name", sorted(tables(COMMITTED)))
def test_a_fresh_run_plots_the_committed_numbers(name):
    before, now = read_table(COMMITTED / name), read_table(REBUILT / name)
    assert list(now) == list(before)
    for key, values in before.items():
        if now[key].shape == values.shape:
            off = [distance(now[key][:, column], values[:, column]) for column in range(3)]
            if max(off) <= TOLERANCE:
                continue
        assert np.isnan(values[:, 2]).all() and np.isnan(now[key][:, 2]).all(), key
        assert apart(now[key], values) <= THINNED, key
