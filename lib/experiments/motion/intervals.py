"""A number with its interval over independent runs: what a reading gives an entry of the ledger."""

import numpy as np

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
