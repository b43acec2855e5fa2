"""Noise of numerical differentiation, (18)-(21), and what a Kalman filter's assumptions leave out."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.fixedpoint.noise import Noise
from stillwork.base.checks import InputError, pluralise, require_array, require_count, require_number
from stillwork.estimation.gaussian import require_covariance
from stillwork.estimation.riccati import covariance_root, discrete_gain


def quotient_trial(
    rng: np.random.Generator, noise: Noise, samples: int, sample_time: float
) -> dict[str, float]:
    """One record of noise: mean of the quotient over its deviation, variance over (s / dt)^2, correlation."""
    error = noise.sample(rng, samples)
    quotient = difference_quotient(error, sample_time)
    scale = noise.standard_deviation / sample_time
    return {
        "mean": float(quotient.mean() / (np.sqrt(2) * scale)),
        "variance": float(quotient.var() / scale**2),
        "correlation": float(np.corrcoef(quotient, error[1:])[0, 1]),
    }


def rejects_gaussian(values: ArrayLike, level: float = 1e-3) -> bool:
    """Whether skewness and kurtosis of a record tell it from independent Gaussian noise (Jarque and Bera's test)."""
    from scipy.stats import jarque_bera

    require_number("level", level, above=0, below=1)
    return bool(jarque_bera(require_array("values", values, ndim=1)).pvalue < level)


def difference_quotient(measured: ArrayLike, sample_time: float) -> Float64[np.ndarray, " quotients"]:
    """(z_i - z_{i-1}) / sample_time of a record, shape (samples - 1,), in m/s."""
    require_number("sample_time", sample_time, above=0)
    return np.diff(require_array("measured", measured, ndim=1)) / sample_time


def quotient_covariance(deviation: float, sample_time: float) -> Float64[np.ndarray, "2 2"]:
    """Covariance of the errors of [difference quotient, position] at one instant.

    The first entry is (21), 2 s^2 / dt^2 (a variance, which the paper calls a standard deviation); the
    others follow in the same way: s^2 / dt between the two, s^2 of the position.
    """
    variance = require_number("deviation", deviation, at_least=0) ** 2
    require_number("sample_time", sample_time, above=0)
    return variance * np.array([[2 / sample_time**2, 1 / sample_time], [1 / sample_time, 1.0]])


def quotient_autocorrelation(lag: int) -> float:
    """Correlation of two difference quotients' errors `lag` samples apart: 1, -1/2, 0, 0, ..."""
    return {0: 1.0, 1: -0.5}.get(abs(lag), 0.0)


def quotient_cross_correlation(lag: int) -> float:
    """Correlation of the quotient's error with the position's error `lag` samples later.

    1/sqrt 2 at lag 0, -1/sqrt 2 at lag -1, else 0.
    """
    return {0: 1.0, -1: -1.0}.get(lag, 0.0) / np.sqrt(2)


@dataclass(frozen=True)
class Correlations:
    """Sample correlations of a record of errors at lags -`reach` .. `reach`."""

    lags: np.ndarray
    quotient: Float64[np.ndarray, " lags"]  # of the difference quotient with itself
    cross: Float64[np.ndarray, " lags"]  # of the quotient with the position's error `lag` samples later
    variance: float  # of the quotient, m^2/s^2


def correlations(error: ArrayLike, sample_time: float, reach: int = 4) -> Correlations:
    """Correlations found in a record of measurement errors (m), up to a lag of `reach` samples."""
    error = require_array("error", error, ndim=1)
    require_count("reach", reach, at_least=0)
    if len(error) < reach + 3:
        raise InputError(
            f"error holds {pluralise(len(error), 'sample')}; lags up to {reach} take {reach + 3} at least"
        )
    quotient = difference_quotient(error, sample_time)
    if np.ptp(quotient) == 0:
        raise InputError("error is a straight line; correlations are of what differs from sample to sample")
    position = error[1:] - error[1:].mean()
    centred = quotient - quotient.mean()
    lags = np.arange(-reach, reach + 1)
    return Correlations(
        lags,
        np.array([_correlation(centred, centred, lag) for lag in lags]),
        np.array([_correlation(centred, position, lag) for lag in lags]),
        float(centred.var()),
    )


def _correlation(first, second, lag) -> float:
    """Of first[i] with second[i + lag], normalised by the whole records."""
    samples = len(first)
    early, late = first[max(0, -lag) : samples - max(0, lag)], second[max(0, lag) : samples - max(0, -lag)]
    return float(early @ late / (samples * first.std() * second.std()))


@dataclass(frozen=True)
class SteadyErrors:
    """Steady error covariance of a linear Kalman filter: what it computes, and what is true."""

    gain: Float64[np.ndarray, "states outputs"]
    computed: Float64[np.ndarray, "states states"]
    true: Float64[np.ndarray, "states states"]


def steady_errors(
    transition: ArrayLike,
    process: ArrayLike,
    assumed: ArrayLike,
    deviation: float,
    sample_time: float,
    true_process: ArrayLike | None = None,
) -> SteadyErrors:
    """Steady state of a filter of x = [velocity, position] fed with z = [difference quotient, position].

    The gain comes from the Riccati equation with the process Q and the assumed R (matrices or diagonals), white and
    uncorrelated in time. The true error follows from the fact that both measurements are made of the same two
    position errors, and from `true_process`, what really drives the state.
    """
    from scipy.linalg import solve_discrete_lyapunov

    transition = require_array("transition", transition, shape=(2, 2))
    process = require_covariance("process", process, 2, definite=False)
    assumed = require_covariance("assumed", assumed, 2)
    drives = process if true_process is None else true_process
    drives = require_covariance("true_process", drives, 2, definite=False)
    require_number("deviation", deviation, at_least=0)
    require_number("sample_time", sample_time, above=0)
    try:
        steady = discrete_gain(transition, covariance_root(process), np.eye(2), 1.0, assumed)
    except InputError as error:
        raise InputError(f"process gives the filter no steady gain ({error}); raise its variances") from None
    gain, prior = steady.filter_gain, steady.covariance
    left = np.eye(2) - gain
    # e_k = left (F e_{k-1} + w) - gain v_k with v_k = [(n_k - n_{k-1}) / dt, n_k], and the difference quotient
    # of the true position is the velocity of the semi-implicit model. States: e and n_{k-1}.
    fresh = gain @ np.array([1 / sample_time, 1.0])
    stale = gain @ np.array([-1 / sample_time, 0.0])
    step = np.vstack([np.column_stack([left @ transition, -stale]), np.zeros(3)])
    enters = np.append(-fresh, 1.0)
    drive = deviation**2 * np.outer(enters, enters)
    drive[:2, :2] += left @ drives @ left.T
    true = solve_discrete_lyapunov(step, drive)[:2, :2]
    return SteadyErrors(gain, left @ prior, true)
