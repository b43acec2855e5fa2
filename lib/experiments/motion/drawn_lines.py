"""Numbers read off the lines of a panel, as one reads them off a printed figure."""

import numpy as np


def labelled_lines(axis) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What a panel shows: x and y of its labelled lines, by label."""
    return {
        label: tuple(np.asarray(values, dtype=float) for values in line.get_data())
        for line in axis.lines
        if not (label := str(line.get_label())).startswith("_")
    }


def turning_points(x: np.ndarray, level: np.ndarray, kind: str) -> np.ndarray:
    """Where a line in dB has its ``peaks`` or ``dips`` of at least 0.1 dB."""
    from scipy.signal import find_peaks

    return x[find_peaks(level if kind == "peaks" else -level, prominence=0.1)[0]]


def depth(axis, label: str, at: float) -> float:
    """How far a line dips within 3 % of `at`, below its lower value at 10 % to either side (dB)."""
    x, level = labelled_lines(axis)[label]
    beside = np.interp([0.9 * at, 1.1 * at], x, level).min()
    return float(beside - level[np.abs(x / at - 1) < 0.03].min())


def highest(axis, low: float = 0.0, high: float = np.inf) -> np.ndarray:
    """Place and height of the largest value of each line of a panel, for x from `low` to `high`: (lines, 2)."""
    parts = [(x, np.where((x >= low) & (x <= high), y, -np.inf)) for x, y in labelled_lines(axis).values()]
    return np.array([(x[y.argmax()], y.max()) for x, y in parts])
