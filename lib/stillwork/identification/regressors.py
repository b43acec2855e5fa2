"""Regressors of FIR models from measured records, and bounds from what is known of their noise."""

from typing import Annotated

import numpy as np

from stillwork.base.bounds import Count, Fraction, NonNegative, Vector, within
from stillwork.base.checks import (
    require_memory,
)
from stillwork.base.validation import checked


@checked
def fir_regressors(signal: Vector, taps: Count) -> np.ndarray:
    """Columns (u_t, u_(t-1), ..., u_(t-taps+1)), for y_t = sum over k of x_k u_(t-k).

    Parameters
    ----------
    signal : array_like, shape (samples,)
        Input u; taken as zero before the record.
    taps : int
        Length of the impulse response.

    Returns
    -------
    ndarray, shape (taps, samples)

    Raises
    ------
    InputError
        When the signal is not a finite list of numbers.

    References
    ----------
    Ljung, System Identification (1999), section 4.2.

    Examples
    --------
    >>> identification.fir_regressors([1.0, 2.0, 3.0], taps=2)
    array([[1., 2., 3.],
           [0., 1., 2.]])
    """
    require_memory("taps", taps, len(signal))
    columns = np.zeros((taps, len(signal)))
    for lag, row in enumerate(columns):
        row[lag:] = signal[: max(len(signal) - lag, 0)]
    return columns


@checked
def exponential_bound(row: NonNegative, forgetting: Fraction, samples: Count | None = None) -> float:
    """Bound eta on the 2-norm of the exponentially weighted perturbation, Section 5.

    epsilon sqrt(sum of forgetting^j over the samples); without `samples` its limit epsilon / sqrt(1 - forgetting).
    """
    memory = 1 / (1 - forgetting)
    if samples is not None:
        memory *= 1 - forgetting**samples
    return float(row * np.sqrt(memory))


@checked
def exponential_weights(
    rows: Count, forgetting: Annotated[float, within(above=0.0, at_most=1.0)]
) -> np.ndarray:
    """Weights of the rows of A and b, oldest first: forgetting^((t - j) / 2)."""
    require_memory("rows", rows)
    return forgetting ** (np.arange(rows - 1, -1, -1) / 2)


@checked
def noise_bound(deviation: NonNegative, unknowns: Count, forgetting: Fraction) -> float:
    """Typical 2-norm of the weighted perturbation when its entries are independent noise.

    deviation (sqrt(m) + sqrt(unknowns)) with m = 1 / (1 - forgetting) effective rows: the expected norm
    of a random matrix (Davidson and Szarek 2001, Theorem II.13, an upper bound on it). The guaranteed
    bound of `exponential_bound` grows as sqrt(m unknowns) and is then needlessly large.
    """
    return float(deviation * (1 / np.sqrt(1 - forgetting) + np.sqrt(unknowns)))
