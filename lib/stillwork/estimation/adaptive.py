"""Self-tuning of feedforward weights with a filtered error: FeLMS and FeRLS (Section 4).

    u = W psi,   e = N P2^-1 a1,   psi_N = N psi

The weights W have one row an actuator; every row sees the same regressors, so that one covariance P of the
regressors serves all of them, eq. (27).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from stillwork.base.checks import Converted, InputError, require_array, require_choice, require_number
from stillwork.base.front_door import checked
from stillwork.base.kernels import inlined_kernel, kernel


@dataclass(frozen=True)
class FeLms:
    """Settings of filtered-error LMS, eq. (18)-(19); the defaults are the published ones.

    Attributes
    ----------
    step_size : float
        mu, of the normalised update.
    regularisation : float
        epsilon, in squared units of the regressors.
    trace : str
        ``regressors``: the trace over the n regressors, which fits the published curves. ``literal``: the trace
        that eq. (18) prints, which counts them once for every actuator and is that many times slower.

    Examples
    --------
    >>> floor = np.random.default_rng(1).standard_normal((2, 5000))  # m/s^2
    >>> estimation.identify(estimation.FeLms(step_size=0.2), floor, [[-3.0, 5.0]] @ floor).weights.round(3)
    array([[ 3., -5.]])
    """

    step_size: float = 1e-4
    regularisation: float = 1e-5
    trace: str = "regressors"

    def __post_init__(self):
        require_number("step_size", self.step_size, above=0.0)
        require_number("regularisation", self.regularisation, above=0.0)
        require_choice("trace", self.trace, ("regressors", "literal"))

    def trace_copies(self, actuators: int) -> float:
        """How often the trace counts the power of the regressors."""
        return float(actuators) if self.trace == "literal" else 1.0


@dataclass(frozen=True)
class FeRls:
    """Settings of filtered-error RLS, eq. (29)-(30).

    The defaults are the published forgetting and the safe form of the covariance: without `growth_limit` a
    direction that the floor does not excite winds P up as exp(t / T), and its return breaks the loop.

    Attributes
    ----------
    initial_covariance : array_like, shape (), (n,) or (n, n)
        P(-1), or its diagonal, or one number for all of it. `steady_covariance` tells the steady value; the
        paper starts at ten times its diagonal.
    forgetting : float
        lambda in (0, 1]; exp(-sample time / time constant).
    growth_limit : float
        How far an element of the diagonal of P may grow beyond its initial value, at least 1; ``inf`` for the
        printed algorithm. A floor that gets quieter by more than this, in power, is followed more slowly.

    Examples
    --------
    >>> settings = estimation.FeRls(initial_covariance=10.0, forgetting=float(np.exp(-2e-4 / 5)))  # 5 s at 5 kHz
    >>> settings.start(regressors=2)[1]  # limits of the diagonal of P
    array([100., 100.])
    """

    initial_covariance: Converted
    forgetting: float = float(np.exp(-2e-4 / 10))
    growth_limit: float = 10.0

    @checked
    def __post_init__(self):
        require_number("forgetting", self.forgetting, above=0.0, at_most=1.0)
        if self.growth_limit != np.inf:
            require_number("growth_limit", self.growth_limit, at_least=1.0)
        initial = require_array("initial_covariance", self.initial_covariance)
        if initial.ndim > 2 or (initial.ndim == 2 and initial.shape[0] != initial.shape[1]):
            raise InputError(
                f"initial_covariance has shape {initial.shape}; give a number, its diagonal or a square matrix"
            )
        if initial.ndim == 2 and not np.allclose(initial, initial.T, rtol=1e-9, atol=0):
            raise InputError("initial_covariance is not symmetric; give a covariance")
        if np.min(np.linalg.eigvalsh(initial) if initial.ndim == 2 else initial) <= 0:
            raise InputError("initial_covariance is not positive definite; give a covariance")
        object.__setattr__(self, "initial_covariance", initial)

    @checked(infinite=True)
    def start(self, regressors: int) -> tuple[Float64[np.ndarray, "n n"], Float64[np.ndarray, "n"]]:
        """P(-1), exactly symmetric, and the limits of its diagonal for a number of regressors."""
        initial = self.initial_covariance
        if initial.ndim and len(initial) != regressors:
            raise InputError(
                f"initial_covariance has shape {initial.shape} but there are {regressors} regressors; "
                "give one value for each, or a single number"
            )
        covariance = initial if initial.ndim == 2 else np.diag(np.broadcast_to(initial, regressors))
        return (covariance + covariance.T) / 2, self.growth_limit * np.diag(covariance)


@inlined_kernel
def update_covariance(covariance, regressor, forgetting, gain):
    """P <- (P - P psi psi' P / (lambda + psi' P psi)) / lambda in place; `gain` becomes P psi of before.

    One triangle is computed and mirrored: rounding that differs between the two grows as 1 / lambda^t.
    Returns lambda + psi' P psi and its inverse, which takes `gain` to P psi with the new P.
    """
    n = len(regressor)
    denominator = forgetting
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += covariance[i, j] * regressor[j]
        gain[i] = total
        denominator += total * regressor[i]
    shrink = 1.0 / denominator
    forget = 1.0 / forgetting
    for i in range(n):
        scaled = gain[i] * shrink
        for j in range(i + 1):
            value = (covariance[i, j] - scaled * gain[j]) * forget
            covariance[i, j] = value
            covariance[j, i] = value
    return denominator, shrink


@inlined_kernel
def ferls_update(weights, covariance, regressor, error, forgetting, limits, gain):
    """One sample of FeRLS in place, eq. (29)-(30).

    Parameters
    ----------
    weights : (actuators, n)
        W.
    covariance : (n, n)
        P, exactly symmetric; one triangle is computed and mirrored, so it stays so.
    regressor : (n,)
        psi_N.
    error : (actuators or more,)
        e.
    forgetting : float
        lambda.
    limits : (n,)
        The diagonal of P may not exceed them; infinite for the printed algorithm.
    gain : (n,)
        Scratch.

    Returns
    -------
    float
        lambda + psi' P psi; below lambda, or NaN, when P was no longer positive definite.
    """
    n = len(regressor)
    denominator, shrink = update_covariance(covariance, regressor, forgetting, gain)
    for i in range(n):
        gain[i] *= shrink  # P(k-1) psi over the denominator is P(k) psi
    for a in range(weights.shape[0]):
        scaled = error[a]
        for i in range(n):
            weights[a, i] -= scaled * gain[i]
    for i in range(n):
        if covariance[i, i] > limits[i]:
            limit_covariance(covariance, limits, gain)
            break
    return denominator


@kernel
def limit_covariance(covariance, limits, scratch):
    """Bring the diagonal of P back to its limits in place, as if the regressor had been seen once more."""
    for i in range(len(limits)):
        if covariance[i, i] > limits[i]:
            add_information(covariance, i, 1.0 / limits[i] - 1.0 / covariance[i, i], scratch)


@kernel
def add_information(covariance, axis, information, scratch):
    """Add to one diagonal element of the inverse of P, in place, by the matrix inversion lemma.

    P stays symmetric, and positive definite for information above zero.
    """
    n = len(covariance)
    for j in range(n):
        scratch[j] = covariance[axis, j]
    share = information / (1.0 + information * scratch[axis])
    for j in range(n):
        scaled = scratch[j] * share
        for k in range(j + 1):
            value = covariance[j, k] - scaled * scratch[k]
            covariance[j, k] = value
            covariance[k, j] = value


@kernel
def felms_update(weights, regressor, error, step_size, regularisation, trace_copies):
    """One sample of FeLMS in place, eq. (18)-(19).

    Parameters
    ----------
    weights : (actuators, n)
        W.
    regressor : (n,)
        psi_N.
    error : (actuators or more,)
        e.
    step_size, regularisation : float
        mu and epsilon.
    trace_copies : float
        How often the trace counts psi_N' psi_N: the number of actuators for the literal trace of eq. (18), 1 for
        the trace over the regressors.
    """
    n = len(regressor)
    power = 0.0
    for i in range(n):
        power += regressor[i] * regressor[i]
    rate = step_size / (regularisation + trace_copies * power)
    for a in range(weights.shape[0]):
        scaled = rate * error[a]
        for i in range(n):
            weights[a, i] -= scaled * regressor[i]
