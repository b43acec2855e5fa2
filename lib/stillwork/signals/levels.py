"""How large a random signal becomes: its peak, and its rms and peak over another stretch as long as its record."""

import numpy as np
from jaxtyping import Float64
from scipy import stats

from stillwork.base.bounds import Fraction, Positive
from stillwork.base.validation import checked

STRETCHES = 8  # of a record, whose powers are compared


@checked
def expected_peak(
    rms: Float64[np.ndarray, " signals"], rate_hz: Float64[np.ndarray, " signals"], duration: Positive
) -> Float64[np.ndarray, " signals"]:
    """Largest size that a Gaussian signal is expected to reach, by Rice's crossings.

    The crossings count as independent: the peak of a narrow-band signal is a few per cent lower.

    Parameters
    ----------
    rms : array_like, shape (signals,)
    rate_hz : array_like, shape (signals,)
        Upward crossings of zero a second: root of the mean of f^2 over the spectrum.
    duration : float
        s.

    Returns
    -------
    ndarray, shape (signals,)

    References
    ----------
    Davenport, Note on the distribution of the largest value of a random function (1964).

    Examples
    --------
    >>> from stillwork.signals.levels import expected_peak
    >>> expected_peak([1.0], [10.0], 60.0).round(2)  # of 600 crossings upwards and as many downwards
    array([3.92])
    """
    count = np.sqrt(2 * np.log(np.maximum(2 * rate_hz * duration, np.e)))
    return rms * (count + np.euler_gamma / count)


@checked
def next_rms(
    rows: Float64[np.ndarray, "signals samples"], probability: Fraction
) -> Float64[np.ndarray, " signals"]:
    r"""Rms of another stretch as long as a record, over the record's: not exceeded with a probability.

    Both powers scatter: their ratio is F-distributed, with as many degrees of freedom on either side. These are
    the smaller of two estimates: from the lines, :math:`2 P^2 / \int S^2 df` for each second, right for a stationary
    Gaussian signal however narrow its peaks; and from the scatter of the powers of `STRETCHES` parts, for one whose
    strength changes, with Student's law for so few parts.

    Parameters
    ----------
    rows : array_like, shape (signals, samples)
        Signals; their means do not count.
    probability : float
        Above 0.5.

    Returns
    -------
    ndarray, shape (signals,)
        At least 1.

    References
    ----------
    Bendat and Piersol, Random Data (2010), section 8.3.

    Examples
    --------
    >>> from stillwork.signals.levels import next_rms
    >>> noise = np.random.default_rng(0).standard_normal((1, 20_000))
    >>> bool(1.01 < next_rms(noise, 0.99)[0] < 1.05)
    True
    """
    moved = rows - rows.mean(axis=1, keepdims=True)
    lines = np.abs(np.fft.rfft(moved, axis=1)[:, 1:]) ** 2
    tiny = np.finfo(float).tiny
    # A line's power is exponentially distributed: the mean of its square is twice that of a known spectrum's.
    freedom = np.maximum(4 * lines.sum(axis=1) ** 2 / np.maximum((lines**2).sum(axis=1), tiny) - 2, 1.0)
    whole = moved.shape[1] // STRETCHES * STRETCHES
    powers = np.mean(moved[:, :whole].reshape(len(rows), STRETCHES, -1) ** 2, axis=2)
    scatter = powers.var(axis=1, ddof=1) / STRETCHES / np.maximum(powers.mean(axis=1) ** 2, tiny)
    student = stats.t.ppf(probability, STRETCHES - 1) / stats.norm.ppf(probability)
    parts = np.maximum(2 / np.maximum(scatter, 1e-9), 1.0)
    logs = np.log([stats.f.ppf(probability, n, n) for n in (freedom, parts)])
    return np.exp(np.maximum(logs[0], student * logs[1]) / 2)


@checked
def next_peak(
    rows: Float64[np.ndarray, "signals samples"], probability: Fraction
) -> Float64[np.ndarray, " signals"]:
    r"""Peak of another stretch as long as a record, not exceeded with a probability.

    The peak of N independent extremes of a Gaussian signal has about Gumbel's law with a scale of 1 / c in rms values,
    :math:`c = \sqrt{2 \ln N}`, and the difference of two of them a logistic one: another peak is
    :math:`1 + \ln(p / (1 - p)) / c^2` times the record's. `next_rms` of it takes in that the strength scatters, too.

    Heavier tails exceed it more often: of footfalls whose strengths are lognormal 7 in 100 did for p = 0.99.

    Parameters
    ----------
    rows : array_like, shape (signals, samples)
        Signals without a mean.
    probability : float
        Above 0.5.

    Returns
    -------
    ndarray, shape (signals,)
        In the signals' unit.

    References
    ----------
    Davenport, Note on the distribution of the largest value of a random function (1964).

    Examples
    --------
    >>> from stillwork.signals.levels import next_peak
    >>> noise = np.random.default_rng(0).standard_normal((1, 20_000))
    >>> bool(1.2 < next_peak(noise, 0.99)[0] / np.abs(noise).max() < 1.4)
    True
    """
    count = np.count_nonzero(np.diff(np.signbit(rows), axis=1), axis=1)
    again = 1 + np.log(probability / (1 - probability)) / (2 * np.log(np.maximum(count, np.e)))
    return np.abs(rows).max(axis=1) * next_rms(rows, probability) * again
