"""Thin the dense lines of a figure to the points that its picture can show."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from stillwork.base.kernels import kernel

DENSE = 200  # points; a line with fewer keeps them all
REACH = 0.1  # pixels of the saved picture by which a thinned line may leave the full one
COLUMN = 0.5  # pixels; of the samples within one only the extremes show


@contextmanager
def thin(figure, dpi: float) -> Iterator[None]:
    """Leave out, for a while, the points of dense lines that lie within a tenth of a pixel of a line through the rest.

    Where many samples fall into half a pixel's width, only the lowest and the highest of them come into
    question: they show as a stroke from one to the other. Lines with markers or steps keep every point.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Its lines are thin inside the context and whole again after it; its limits stay as they are.
    dpi : float
        Resolution at which it will be saved, dots per inch.
    """
    whole = []
    try:
        for axes in figure.axes:
            axes.get_xlim(), axes.get_ylim()  # found from the whole lines
            for line in axes.lines:
                if _dense(line):
                    whole.append((line, line.get_data(orig=True)))
                    x, y = line.get_data(orig=False)
                    pixels = line.get_transform().transform(np.c_[x, y]) * (dpi / figure.dpi)
                    kept = np.concatenate([part[kept_points(pixels[part])] for part in _unbroken(pixels)])
                    line.set_data(x[kept], y[kept])
        yield
    finally:
        for line, data in whole:
            line.set_data(*data)


def _dense(line) -> bool:
    plain = line.get_marker() in ("None", "none", "", " ", None) and line.get_drawstyle() == "default"
    return plain and line.get_transform() == line.axes.transData and len(line.get_xdata()) > DENSE


def _unbroken(pixels: np.ndarray) -> list[np.ndarray]:
    """Indices of each part without gaps, and of one missing point in each gap."""
    there = np.isfinite(pixels).all(axis=1)
    parts = np.split(np.arange(len(there)), 1 + np.flatnonzero(np.diff(there)))
    return [part if there[part[0]] else part[:1] for part in parts]


def kept_points(pixels: np.ndarray, reach: float = REACH) -> np.ndarray:
    """Indices of the points that draw a line, in order.

    Parameters
    ----------
    pixels : ndarray, shape (points, 2)
        The line, in pixels.
    reach : float
        How far a point that is left out may lie beside the line that is drawn, and how far beyond an end at which
        the line turns back, in pixels: together at most sqrt(2) times as far from it.
    """
    if len(pixels) < 3 or not np.isfinite(pixels).all():
        return np.arange(len(pixels))
    columns = np.ptp(pixels[:, 0]) / COLUMN
    index = np.arange(len(pixels))
    if len(pixels) > 4 * columns > 0 and np.all(np.diff(pixels[:, 0]) >= 0):
        index = _extremes(pixels, reach)
    return index[_corners(np.ascontiguousarray(pixels[index]), reach)]


def _extremes(pixels: np.ndarray, reach: float) -> np.ndarray:
    """First, last, lowest and highest point of every column; the first of equals, to `reach`."""
    column = np.floor((pixels[:, 0] - pixels[0, 0]) / COLUMN).astype(int)
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    kept = []
    for start, end in zip(starts, [*starts[1:], len(column)], strict=True):
        height = np.rint((pixels[start:end, 1] - pixels[start, 1]) / reach)
        kept += [start, start + height.argmin(), start + height.argmax(), end - 1]
    return np.unique(kept)


@kernel
def _corners(points, reach):
    """Which points a line needs: a straight piece runs on while all it passes lie within `reach` of it.

    From the start of a piece each point leaves a cone of directions that pass it closely enough; the piece ends
    before the first point outside the cones of all others, or where the line turns back.
    """
    kept = np.zeros(len(points), np.bool_)
    kept[0] = kept[-1] = True
    start, farthest, low, high = 0, 0.0, -np.inf, np.inf
    ux, uy = 1.0, 0.0
    k = 1
    while k < len(points):
        dx, dy = points[k, 0] - points[start, 0], points[k, 1] - points[start, 1]
        away = np.hypot(dx, dy)
        if away <= reach and farthest <= reach:
            farthest = max(farthest, away)
            k += 1
            continue
        if farthest <= reach:  # the first point that sets a direction
            ux, uy = dx / away, dy / away
        turn = np.arctan2(ux * dy - uy * dx, ux * dx + uy * dy)
        if away < farthest - reach or turn < low or turn > high:
            start, farthest, low, high = k - 1, 0.0, -np.inf, np.inf
            kept[start] = True
            continue
        half = np.arcsin(min(reach / away, 1.0))
        low, high = max(low, turn - half), min(high, turn + half)
        farthest = max(farthest, away)
        k += 1
    return np.flatnonzero(kept)
