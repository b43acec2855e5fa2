"""Frequencies that a picture needs: a coarse grid, and those that show a curve over a logarithmic axis."""

import numpy as np

# Gives an explorer its weights in time; notebooks take a dense grid.
COARSE_HZ = np.geomspace(0.05, 2400, 500)


def thinned(frequencies_hz: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Indices that paint a curve over a logarithmic axis without losing a peak, at most 480.

    Of 240 bins even in the logarithm the smallest and the largest value are kept, so that a mains line one bin
    wide is seen at its full height.
    """
    positive = np.flatnonzero(frequencies_hz > 0)
    f = frequencies_hz[positive]
    starts = np.unique(np.searchsorted(f, np.geomspace(f[0], f[-1], 240) * (1 - 1e-12)))
    bins = np.split(positive, starts[1:])
    return np.unique([pick(values[each]) + each[0] for each in bins for pick in (np.argmin, np.argmax)])
