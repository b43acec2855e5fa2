"""Slow, obvious twins of the robust filters: costs minimised as they are written, and the printed recursions."""

import numpy as np
from scipy import optimize


def penalised_step(a, b, g, c, s, t, m, weight, q, r_hat, p, x, u, y):
    """Minimise the quadratic cost over (x, w) as one stacked least-squares problem; step on with the model."""
    n, nw = a.shape[0], g.shape[1]

    def root(inverse_of):
        return np.linalg.inv(np.linalg.cholesky(inverse_of))

    rows = [
        (np.hstack([root(p), np.zeros((n, nw))]), root(p) @ x),
        (np.hstack([np.zeros((nw, n)), root(q)]), np.zeros(nw)),
        (np.sqrt(weight) * np.hstack([s, t]), -np.sqrt(weight) * m @ u),
        (root(r_hat) @ c @ np.hstack([a, g]), root(r_hat) @ (y - c @ b @ u)),
    ]
    best = np.linalg.lstsq(np.vstack([f for f, _ in rows]), np.concatenate([d for _, d in rows]), rcond=None)[
        0
    ]
    return a @ best[:n] + b @ u + g @ best[n:]


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
    """Textbook time-varying Kalman filter in filter form; Joseph's form of the covariance."""
    samples, n = len(c), a.shape[0]
    x, states = np.zeros(n), np.zeros((n, samples))
    for k in range(1, samples):
        x = a @ x + b @ u[:, k - 1]
        p = a @ p @ a.T + g @ q @ g.T
        gain = np.linalg.solve(c[k] @ p @ c[k].T + r, c[k] @ p).T
        x = x + gain @ (y[:, k] - c[k] @ x)
        rest = np.eye(n) - gain @ c[k]
        p = rest @ p @ rest.T + gain @ r @ gain.T
        states[:, k] = x
    return states
