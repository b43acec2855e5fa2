"""Slow, obvious twins of the robust filters: costs minimised as they are written, and the printed recursions."""

import numpy as np
from scipy import optimize

from naive.fixedpoint import kalman_step


def sensitivity_cost(best, model_at, epsilons, gamma, q, r, p, x, u, y, step=1e-5):
    """Cost of (5.22) with the sensitivities as central differences of the output error itself."""
    n = len(x)
    state, noise = best[:n], best[n:]

    def error(before, after):
        a, b, g, _ = model_at(before)
        c = model_at(after)[3]
        return y - c @ (a @ state + b @ u + g @ noise)

    zero = np.zeros(epsilons)
    nominal = error(zero, zero)
    cost = gamma * (
        (state - x) @ np.linalg.solve(p, state - x)
        + noise @ np.linalg.solve(q, noise)
        + nominal @ np.linalg.solve(r, nominal)
    )
    for i in range(epsilons):
        bump = step * np.eye(epsilons)[i]
        for pair in ((bump, zero), (zero, bump)):
            up = error(*pair)
            down = error(*(-each for each in pair))
            cost += (1 - gamma) * np.sum(((up - down) / (2 * step)) ** 2)
    return cost


def worst_case_cost(best, a, b, g, c, m, e_a, e_b, e_g, q, r, p, x, u, y):
    """Cost of (5.15): the largest over every error M Delta E with |Delta| <= 1, for one output direction M.

    With one direction, Delta E z is any number within |E z|; the cost is convex in it, so an end is the worst.
    """
    n = len(x)
    state, noise = best[:n], best[n:]
    nominal = y - c @ (a @ state + b @ u + g @ noise)
    reach = np.linalg.norm(e_a @ state + e_b @ u + e_g @ noise)
    worst = max(
        (nominal - end * m[:, 0]) @ np.linalg.solve(r, nominal - end * m[:, 0]) for end in (-reach, reach)
    )
    return (state - x) @ np.linalg.solve(p, state - x) + noise @ np.linalg.solve(q, noise) + worst


def minimise_smooth(cost, start):
    """Minimum of a smooth convex function without derivatives."""
    return optimize.minimize(cost, start, method="Powell", options={"xtol": 1e-10, "ftol": 1e-15}).x


def minimise(cost, start):
    """Minimum of a convex, possibly kinked function without derivatives."""
    best = np.array(start, dtype=float)
    for size in (1.0, 1e-3, 1e-6):
        simplex = np.vstack([best, best + size * np.eye(len(best))])
        found = optimize.minimize(
            cost,
            best,
            method="Nelder-Mead",
            options={
                "initial_simplex": simplex,
                "xatol": 1e-9,
                "fatol": 1e-14,
                "maxiter": 1000,
                "maxfev": 2000,
                "adaptive": True,
            },
        )
        best = found.x
    return best


def printed_step(a, b, g, c, s, t, m, weight, q, r_hat, p, x, u, y):
    """One step of (5.21) and (5.25) as printed, with its misprints mended; returns x(k|k) and P(k|k)."""
    n = len(x)
    p_hat = np.linalg.inv(np.linalg.inv(p) + weight * s.T @ s)
    inner = np.eye(len(s)) - weight * s @ p_hat @ s.T
    q_hat = np.linalg.inv(np.linalg.inv(q) + weight * t.T @ inner @ t)
    g_hat = g - weight * a @ p_hat @ s.T @ t
    a_hat = (a - weight * g_hat @ q_hat @ t.T @ s) @ np.linalg.inv(np.eye(n) + weight * p @ s.T @ s)
    b_hat = b - weight * (a @ p_hat @ s.T + g_hat @ q_hat @ t.T @ inner) @ m
    predicted = a_hat @ x + b_hat @ u
    spread = a @ p_hat @ a.T + g_hat @ q_hat @ g_hat.T
    gain = spread @ c.T @ np.linalg.inv(r_hat + c @ spread @ c.T)
    return predicted + gain @ (y - c @ predicted), (np.eye(n) - gain @ c) @ spread


def kalman(a, b, g, c, q, r, p, u, y):
    """Textbook time-varying Kalman filter in filter form."""
    x, states = np.zeros(len(a)), np.zeros((len(a), len(c)))
    for k in range(1, len(c)):
        ahead = a @ x + b @ u[:, k - 1]
        x, p = kalman_step(x, p, y[:, k], ahead, a, c[k], c[k] @ ahead, g @ q @ g.T, r)
        states[:, k] = x
    return states
