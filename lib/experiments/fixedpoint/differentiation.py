"""Noise of numerical differentiation, (18)-(21), and what a Kalman filter's assumptions leave out."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array, require_number
from stillwork.estimation.gaussian import require_covariance
from stillwork.estimation.riccati import covariance_root, discrete_gain


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
