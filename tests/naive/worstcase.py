"""Slow, obvious twins of the worstcase topic: normal equations, bisection, Theorem 2 letter by letter."""

import numpy as np
from scipy.optimize import brentq


def secular_value(A, b, bound, alpha):
    """f(alpha), eqs. (5)-(6): regularised solution, then eta |A x - b| / |x|."""
    x = np.linalg.solve(A.T @ A + alpha * np.eye(A.shape[1]), A.T @ b)
    return bound * np.linalg.norm(A @ x - b) / np.linalg.norm(x)


def secular_root(A, b, bound):
    """Positive root of alpha = f(alpha) by bisection over twenty-four decades."""
    scale = np.linalg.norm(A) ** 2

    def gap(exponent):
        alpha = scale * 10.0**exponent
        return np.log(secular_value(A, b, bound, alpha) / alpha)

    return scale * 10.0 ** brentq(gap, -12, 12, xtol=1e-15, rtol=9e-16, maxiter=500)


def min_max(A, b, bound):
    """Theorem 1 for a full-rank A with b outside its column space: (x, alpha)."""
    if bound >= np.linalg.norm(A.T @ b) / np.linalg.norm(b):
        return np.zeros(A.shape[1]), np.inf
    alpha = secular_root(A, b, bound)
    return np.linalg.solve(A.T @ A + alpha * np.eye(A.shape[1]), A.T @ b), alpha


def weighted(rows, outputs, forgetting):
    """Rows and outputs with the exponential weights of Section 4 written out."""
    weights = np.sqrt(forgetting) ** np.arange(len(outputs) - 1, -1, -1)
    return rows * weights[:, None], outputs * weights


def batch_estimates(rows, outputs, forgetting, bounds):
    """Min-max solution of all data so far, solved anew at every step; zero up to n samples."""
    samples, n = rows.shape
    estimates, alphas = np.zeros((samples, n)), np.full(samples, np.inf)
    for t in range(n, samples):
        A, b = weighted(rows[: t + 1], outputs[: t + 1], forgetting)
        estimates[t], alphas[t] = min_max(A, b, bounds[t])
    return estimates, alphas


def iterative_algorithm(rows, outputs, forgetting, bound, iterations):
    """Algorithm (20) with P^-1, z, p and q as written (h with lam alpha); further iterations call f again."""
    samples, n = rows.shape
    estimates, alphas = np.zeros((samples, n)), np.full(samples, np.inf)
    inverse = None
    z = 0.0
    R, s = np.zeros((n, n)), np.zeros(n)
    for t in range(samples):
        a, y = rows[t], outputs[t]
        z = forgetting * z + y**2
        R = forgetting * R + np.outer(a, a)
        s = forgetting * s + a * y
        if t < n:
            continue
        A, b = weighted(rows[: t + 1], outputs[: t + 1], forgetting)
        if bound >= np.linalg.norm(A.T @ b) / np.linalg.norm(b):
            inverse = None
            continue
        if inverse is None:
            estimates[t], alphas[t] = min_max(A, b, bound)
        else:
            P, x, old = np.linalg.inv(inverse), estimates[t - 1], alphas[t - 1]
            h = x + P @ a * (y - a @ x) / (forgetting + a @ P @ a)
            p = h @ (forgetting * inverse + np.outer(a, a) - forgetting * old * np.eye(n)) @ h
            q = 2 * h @ (forgetting * inverse @ x + a * y)
            alpha = bound / np.linalg.norm(h) * np.sqrt(max(z + p - q, 0.0))
            for _ in range(iterations - 1):
                alpha = secular_value(A, b, bound, alpha)
            alphas[t] = alpha
            estimates[t] = np.linalg.solve(R + alpha * np.eye(n), s)
        inverse = R + alphas[t] * np.eye(n)
    return estimates, alphas


def recursive_least_squares(rows, outputs, forgetting, initial_covariance):
    """RLS as the weighted least-squares problem with its prior, solved anew at every step."""
    samples, n = rows.shape
    estimates = np.zeros((samples, n))
    for t in range(samples):
        A, b = weighted(rows[: t + 1], outputs[: t + 1], forgetting)
        prior = np.sqrt(forgetting ** (t + 1) / initial_covariance) * np.eye(n)
        estimates[t] = np.linalg.lstsq(np.vstack([A, prior]), np.append(b, np.zeros(n)), rcond=None)[0]
    return estimates


def ridge(rows, outputs, forgetting, penalty):
    """Ridge regression as an augmented least-squares problem, solved anew at every step."""
    samples, n = rows.shape
    estimates = np.zeros((samples, n))
    for t in range(samples):
        A, b = weighted(rows[: t + 1], outputs[: t + 1], forgetting)
        stacked = np.vstack([A, np.sqrt(penalty) * np.eye(n)])
        estimates[t] = np.linalg.lstsq(stacked, np.append(b, np.zeros(n)), rcond=None)[0]
    return estimates
