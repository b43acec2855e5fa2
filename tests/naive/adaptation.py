"""Slow, obvious twins of the adaptation kernels, in the words of the FeRLS paper's equations."""

import numpy as np


def regression_matrix(regressor, actuators):
    """Psi of eq. (14): the regressors of every actuator in its own block of columns."""
    return np.kron(np.eye(actuators), regressor[None, :])


def full_inverse_ferls(regressors, disturbance, epsilon, forgetting):
    """Eq. (25)-(26) as printed: the information matrix of all parameters, inverted at every sample.

    Returns the weights after every sample, (samples, actuators, n), and the last adaptation gain matrix.
    """
    n, samples = regressors.shape
    actuators = len(disturbance)
    w = np.zeros(actuators * n)
    total = np.zeros((actuators * n, actuators * n))
    history = []
    for k in range(samples):
        psi = regression_matrix(regressors[:, k], actuators)
        e = disturbance[:, k] + psi @ w
        total = forgetting * total + psi.T @ psi
        gain = np.linalg.inv(forgetting ** (k + 1) * epsilon * np.eye(len(w)) + total)
        w = w - gain @ psi.T @ e
        history.append(w.reshape(actuators, n).copy())
    return np.array(history), gain


def felms(regressors, disturbance, step_size, regularisation, literal):
    """Eq. (18)-(19) with the regression matrix written out; without `literal` the trace of one block."""
    actuators, (n, samples) = len(disturbance), regressors.shape
    w = np.zeros(actuators * n)
    for k in range(samples):
        psi = regression_matrix(regressors[:, k], actuators)
        e = disturbance[:, k] + psi @ w
        trace = np.trace(psi.T @ psi) / (1 if literal else actuators)
        w = w - step_size / (regularisation + trace) * psi.T @ e
    return w.reshape(actuators, n)


def weighted_least_squares(regressors, disturbance, initial_covariance, forgetting):
    """W that minimises sum of lambda^(K-k) |d + W psi|^2 + lambda^(K+1) tr(W P0^-1 W'), and its covariance."""
    samples = regressors.shape[1]
    weights = forgetting ** np.arange(samples - 1, -1, -1)
    information = forgetting**samples * np.linalg.inv(initial_covariance)
    information = information + (weights * regressors) @ regressors.T
    return -np.linalg.solve(information, (weights * regressors) @ disturbance.T).T, np.linalg.inv(information)


def limited(covariance, limits):
    """P after adding information along the axis whose variance exceeds its limit most, in turn, by explicit inverses."""
    left = list(range(len(limits)))
    while left:
        excess = np.diag(covariance)[left] / limits[left]
        i = left.pop(int(np.argmax(excess)))
        if excess.max() > 1:
            information = np.zeros_like(covariance)
            information[i, i] = 1 / limits[i] - 1 / covariance[i, i]
            covariance = np.linalg.inv(np.linalg.inv(covariance) + information)
    return covariance


def modified(update, regressors, errors, commands, delay, actuators):
    """The modified filtered error sample by sample: e(k) - c(k - d) + W psi(k - d), with `update(W, psi, e)` giving the next W."""
    n, samples = regressors.shape
    w, history = np.zeros((actuators, n)), []
    for k in range(samples):
        psi = regressors[:, k - delay] if k >= delay else np.zeros(n)
        sent = commands[:, k - delay] if k >= delay else np.zeros(actuators)
        w = update(w, psi, errors[:, k] - sent + w @ psi)
        history.append(w)
    return np.array(history)


def felms_step(step_size, regularisation):
    """Eq. (18)-(19) of one sample, for `modified`."""
    return lambda w, psi, e: w - step_size / (regularisation + psi @ psi) * np.outer(e, psi)


def ferls_step(initial, forgetting):
    """Eq. (29)-(30) of one sample by the information matrix, for `modified`."""
    information = np.linalg.inv(initial)

    def step(w, psi, e):
        nonlocal information
        information = forgetting * information + np.outer(psi, psi)
        return w - np.outer(e, np.linalg.solve(information, psi))

    return step
