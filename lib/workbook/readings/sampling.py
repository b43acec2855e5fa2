"""Which readings are tried: all of them where they are few, else a sample that fills the space of options."""

import itertools

import numpy as np

from workbook.readings.axes import POINTS, Multiverse

SEED = 20160528  # of the sample; any would do, so long as it stays


def design(multiverse: Multiverse) -> list[tuple[int, ...]]:
    """Points to compute, each an option's place on every axis; the default comes first, none comes twice.

    All combinations where there are at most 64; else as many as the study asks for, from a scrambled Sobol
    sequence with a fixed seed, so that any first part of the list fills the space, too.
    """
    sizes = [len(axis.options) for axis in multiverse.axes]
    first = [multiverse.default_point]
    if multiverse.size <= max(POINTS, multiverse.points):
        return list(dict.fromkeys([*first, *itertools.product(*map(range, sizes))]))
    found = dict.fromkeys(first)
    for drawn in _blocks(len(sizes)):
        for point in np.floor(drawn * sizes).astype(int).tolist():
            found.setdefault(tuple(point))
            if len(found) == multiverse.points:
                return list(found)


def _blocks(dimensions: int):
    """The sequence in blocks of 64, without end."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(SEED))
    while True:
        yield sequence.random(POINTS)  # a power of two, as the sequence wants it
