"""Which axes move a quantity: shares of its variance over the combinations, of first order and total (Sobol, 1993)."""

import itertools
from dataclasses import dataclass

import numpy as np

SAME = 1e-6  # relative spread below which the digits that are kept mean nothing
SIGNIFICANCE = 0.01  # of a pair of axes' joint effect in a sample, over all pairs
SEED = "seed"


@dataclass(frozen=True)
class Shares:
    """Shares of variance by axis.

    Attributes
    ----------
    first : dict of str to float
        What the axis moves by itself: variance of the mean given its option, over the whole variance.
    total : dict of str to float
        With its part in joint effects: mean variance when all but this axis are held.
    """

    first: dict[str, float]
    total: dict[str, float]


def variance_shares(values, design, sizes: dict[str, int], seeded: bool) -> Shares | None:
    """Shares of variance over the product of all options, each as likely as any other.

    Exact where every combination was computed. From a sample they come from a model of main effects and of those
    pairs of axes whose joint effect is significant, less what noise alone would give.

    Parameters
    ----------
    values : ndarray, shape (points, seeds)
        NaN where there is none.
    design : list of tuple of int
        Place of the option on each axis, by point.
    sizes : dict of str to int
        Number of options of each axis, in the order of the design's columns.
    seeded : bool
        Whether the seeds are an axis, too.

    Returns
    -------
    Shares or None
        None where nothing varies, or there are too few values to decide.
    """
    finite = np.isfinite(values)
    there = values[finite]
    if there.size < 3 or np.ptp(there) <= SAME * np.abs(there).max():
        return None
    values = values / np.abs(there).max()  # squares of the smallest numbers would vanish
    if finite.all() and len(design) == len(set(design)) == np.prod([*sizes.values()]):
        return _exact(values, design, sizes, seeded)
    return _from_sample(values, np.array(design), sizes, seeded)


def _exact(values, design, sizes, seeded) -> Shares:
    table = np.empty((*sizes.values(), values.shape[1]))
    for point, row in zip(design, values, strict=True):
        table[point] = row
    whole = table.var()
    names = [*sizes, *[SEED] * seeded]
    first, total = {}, {}
    for axis, name in enumerate(names):
        others = tuple(k for k in range(table.ndim) if k != axis)
        first[name] = float(table.mean(axis=others).var() / whole)
        total[name] = max(float(table.var(axis=axis).mean() / whole), first[name])
    return Shares(first, total)


def _from_sample(values, design, sizes, seeded) -> Shares | None:
    with np.errstate(invalid="ignore"):
        some = np.isfinite(values).any(axis=1)
        kept = values[some]
    mean = np.nanmean(kept, axis=1)
    counts = np.isfinite(kept).sum(axis=1)
    within = float(np.nanvar(kept, axis=1).sum() / max((counts - 1).sum() / counts.mean(), 1.0))
    noise = within / counts.mean()  # that the seeds leave in the mean of a point
    options = design[some]
    order = sorted(range(len(sizes)), key=list(sizes).__getitem__)  # not by the order of declaration
    blocks = {}
    for k in order:
        name, size = list(sizes)[k], list(sizes.values())[k]
        blocks[(name,)] = _contrasts(size)[options[:, k]]
    fitted = _fit(mean, blocks)
    if fitted is None:
        return None
    parts, unexplained = fitted
    lack = max(unexplained - noise, 0.0)
    whole = sum(parts.values()) + lack + within
    first = {name: parts[(name,)] / whole for name in sizes}
    total = {name: sum(part for pair, part in parts.items() if name in pair) / whole for name in sizes}
    if seeded:
        by_seed = float(np.nanmean(kept - mean[:, None], axis=0).var())
        total[SEED] = within / whole
        first[SEED] = min(by_seed / whole, total[SEED])
    return Shares(first, total)


def _contrasts(size: int) -> np.ndarray:
    """Columns of zero mean and unit variance over the options, uncorrelated: (options, options - 1)."""
    whole = np.linalg.qr(np.c_[np.ones(size), np.eye(size)[:, : size - 1]])[0]
    return whole[:, 1:] * np.sqrt(size)


def _fit(mean, blocks) -> tuple[dict, float] | None:
    """Variance of each effect over the product of the options, and variance that no effect explains."""
    chosen = dict(blocks)
    pairs = list(itertools.combinations(blocks, 2))
    while True:
        matrix = np.column_stack([np.ones(len(mean)), *chosen.values()])
        free = len(mean) - matrix.shape[1]
        if free < 2:
            return None
        weights, _, rank, _ = np.linalg.lstsq(matrix, mean, rcond=None)
        if rank < matrix.shape[1]:
            return None
        residual = mean - matrix @ weights
        left = float(residual @ residual)
        best = None
        if left > (SAME * np.abs(mean).max()) ** 2 * len(mean):
            candidates = {
                (*a, *b): _product(blocks[a], blocks[b]) for a, b in pairs if (*a, *b) not in chosen
            }
            best = _most_significant(candidates, matrix, residual, left, free, len(pairs))
        if best is None:
            break
        chosen[best[0]] = best[1]
    spread = np.linalg.inv(matrix.T @ matrix).diagonal() * left / free
    parts, at = {}, 1
    for name, block in chosen.items():
        own = slice(at, at + block.shape[1])
        parts[name] = max(float((weights[own] ** 2).sum() - spread[own].sum()), 0.0)
        at = own.stop
    return parts, left / free


def _product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return (one[:, :, None] * other[:, None, :]).reshape(len(one), -1)


def _most_significant(candidates, matrix, residual, left, free, tests):
    """The block whose joint effect is least likely by chance, if it is significant (F test)."""
    from scipy.special import fdtrc

    best, smallest = None, SIGNIFICANCE / max(tests, 1)
    basis = np.linalg.qr(matrix)[0]
    for name, block in candidates.items():
        more = block.shape[1]
        if free - more < 2:
            continue
        own, size, _ = np.linalg.svd(block - basis @ (basis.T @ block), full_matrices=False)
        if size[-1] < 1e-8 * size[0]:  # the sample does not distinguish it from the others
            continue
        gain = float(((own.T @ residual) ** 2).sum())
        rest = max(left - gain, 1e-12 * left)
        chance = fdtrc(more, free - more, (gain / more) / (rest / (free - more)))
        if chance < smallest or (best is None and rest <= 1e-9 * left):
            best, smallest = (name, block), chance
    return best
