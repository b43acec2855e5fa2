"""Self-tuning of feedforward weights with a filtered error: FeLMS and FeRLS (Section 4).

    u = W psi,   e = N P2^-1 a1,   psi_N = N psi

The weights W have one row an actuator; every row sees the same regressors, so that one covariance P of the
regressors serves all of them, eq. (27).
"""

from stillwork.kernels import kernel


@kernel
def _ferls_update(weights, covariance, regressor, error, forgetting, limits, gain):
    """One sample of FeRLS in place, eq. (29)-(30).

    Parameters
    ----------
    weights : (actuators, n)
        W.
    covariance : (n, n)
        P, exactly symmetric; one triangle is computed and mirrored, so it stays so.
    regressor : (n,)
        psi_N.
    error : (actuators,)
        e.
    forgetting : float
        lambda.
    limits : (n,)
        The diagonal of P may not exceed them; infinite for the printed algorithm.
    gain : (n,)
        Scratch.
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
    excess = False
    for i in range(n):
        scaled = gain[i] * shrink
        for j in range(i + 1):
            value = (covariance[i, j] - scaled * gain[j]) * forget
            covariance[i, j] = value
            covariance[j, i] = value
        excess |= covariance[i, i] > limits[i]
    for i in range(n):
        gain[i] *= shrink  # P(k-1) psi over the denominator is P(k) psi
    for a in range(len(error)):
        for i in range(n):
            weights[a, i] -= error[a] * gain[i]
    if excess:
        _limit(covariance, limits, gain)


@kernel
def _limit(covariance, limits, scratch):
    """Bring the diagonal of P back to its limits in place, as if the regressor had been seen once more.

    Adding c e_i e_i' to the inverse of P takes a multiple of p_i p_i' off P (matrix inversion lemma); c is
    chosen such that P_ii lands on its limit. P stays symmetric and positive definite.
    """
    n = len(limits)
    for i in range(n):
        if covariance[i, i] > limits[i]:
            for j in range(n):
                scratch[j] = covariance[i, j]
            share = (scratch[i] - limits[i]) / (scratch[i] * scratch[i])
            for j in range(n):
                scaled = scratch[j] * share
                for k in range(j + 1):
                    value = covariance[j, k] - scaled * scratch[k]
                    covariance[j, k] = value
                    covariance[k, j] = value


@kernel
def _felms_update(weights, regressor, error, step_size, regularisation, trace_copies):
    """One sample of FeLMS in place, eq. (18)-(19).

    Parameters
    ----------
    weights : (actuators, n)
        W.
    regressor : (n,)
        psi_N.
    error : (actuators,)
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
    for a in range(len(error)):
        scaled = rate * error[a]
        for i in range(n):
            weights[a, i] -= scaled * regressor[i]
