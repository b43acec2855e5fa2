"""Measures of a scan's error: moving average, moving standard deviation and rms of the error, (1.1)-(1.3)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Positive, Vector
from stillwork.base.checks import InputError, pluralise
from stillwork.base.validation import checked


class Moving(NamedTuple):
    """Moving values over windows of the exposure time; entry k belongs to the window that starts at sample k."""

    average: Float64[np.ndarray, " windows"]  # MA
    deviation: Float64[np.ndarray, " windows"]  # MSD
    rms: Float64[np.ndarray, " windows"]


@checked
def moving(error: Vector, sample_time: Positive, exposure: Positive) -> Moving:
    """MA, MSD and rms of an error over every window of `exposure` seconds (sums for the integrals).

    Parameters
    ----------
    error : array_like, shape (samples,)
    sample_time, exposure : float
        Sample time and exposure time T (s); the exposure must cover at least two samples and fit the record.

    Returns
    -------
    Moving
        `average`, `deviation` and `rms`, each of shape (windows,), in the unit of the error.

    Raises
    ------
    InputError
        When the exposure covers fewer than two samples, or more than there are.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (1.1)-(1.3).

    Examples
    --------
    >>> signals.moving([3.0, 1.0, -1.0, -3.0], sample_time=1e-3, exposure=2e-3).average
    array([ 2.,  0., -2.])
    """
    width = round(exposure / sample_time)
    if not 2 <= width <= len(error):
        raise InputError(
            f"exposure covers {pluralise(width, 'sample')} of {len(error)}; choose at least 2 and at most all"
        )
    # Cumulative sums of small numbers on a large mean lose digits: take the mean out first.
    offset = error.mean()
    sums = np.cumsum(np.append(0.0, error - offset))
    squares = np.cumsum(np.append(0.0, (error - offset) ** 2))
    average = (sums[width:] - sums[:-width]) / width
    square = (squares[width:] - squares[:-width]) / width
    deviation = np.sqrt(np.maximum(square - average**2, 0))
    average = average + offset
    return Moving(average, deviation, np.hypot(average, deviation))


@checked
def rms(error: Vector) -> float:
    """Root mean square along the last axis of a single record."""
    if not len(error):
        raise InputError("error is empty; give at least one sample")
    return float(np.sqrt(np.mean(error**2)))


@checked
def average_filter(omega: Vector, exposure: Positive) -> Float64[np.ndarray, " frequencies"]:
    """Response of the moving average, a sinc with zeros at multiples of 1/T (section 1.5.3)."""
    return np.sinc(omega * exposure / (2 * np.pi))
