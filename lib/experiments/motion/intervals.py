"""A number with its interval over independent runs: what a reading gives an entry of the ledger."""

import numpy as np
from numpy.typing import ArrayLike

from workbook.studies import proportion_interval

Values = dict[str, float | tuple[float, tuple[float, float]]]  # by entry


def key(case: str) -> str:
    """A case as the ledger writes it."""
    return case.lower().replace(",", "").replace(" ", "-")


def central(sample: np.ndarray) -> float | tuple[float, tuple[float, float]]:
    """Median and the central 95 % of the runs; NaN where one of them gave no number, or there is none."""
    if not len(sample) or np.isnan(sample).any():
        return float("nan")
    low, middle, high = np.quantile(sample, [0.025, 0.5, 0.975])
    return float(middle), (float(low), float(high))


def share(holds: ArrayLike) -> tuple[float, tuple[float, float]]:
    """Share of what holds, with Wilson's interval over the runs (first axis).

    Parts of a run are not independent: they make its share, and the runs alone are counted.
    """
    holds = np.asarray(holds, float)
    runs = len(holds)
    return float(holds.mean()), proportion_interval(int(np.floor(holds.mean() * runs + 1e-9)), runs)
