"""Proven bounds of a Kalman filter's stationary covariance, by definite matrices of fractions."""

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import inf, lcm

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import require_array
from stillwork.base.validation import by_value, checked

TRIES = 14  # radii, each ten times the one before


@by_value
@dataclass(frozen=True)
class CovarianceEnclosure:
    """Variances between which those of the stabilising solution lie; zero and infinite where nothing is proven."""

    low: Float64[np.ndarray, " states"]
    high: Float64[np.ndarray, " states"]
    proven: bool


@checked(infinite=True)
def enclose_covariance(
    a: ArrayLike,
    noise_input: ArrayLike,
    c: ArrayLike,
    process: float | ArrayLike,
    sensor: float | ArrayLike,
    covariance: ArrayLike,
    discrete: bool = False,
) -> CovarianceEnclosure:
    r"""Bounds of the stationary variances of a Kalman filter, for the very numbers of its Riccati equation.

    Q and R must be symmetric and positive definite, or nothing is proven.

    With Ric(X) its right-hand side, Ric(X) > 0 proves that X lies below the stabilising solution, and Ric(X) < 0,
    with a stable :math:`A - XC^TR^{-1}C`, that it lies above; in discrete time f(X) > X and f(X) < X. Both are put to
    P - E and P + E in fractions, without rounding.

    Parameters
    ----------
    a, noise_input, c : array_like
        A, G and C, shapes (states, states), (states, noises) and (outputs, states).
    process, sensor : float or array_like
        Q and R: intensities, in discrete time covariances a sample; numbers for multiples of the identity.
    covariance : array_like, shape (states, states)
        P as it was found; in discrete time that of the predicted error.
    discrete : bool
        In discrete time.

    Returns
    -------
    CovarianceEnclosure
        `low` and `high`, variances of each state, and `proven`; 0 and infinity where nothing is proven.

    Raises
    ------
    InputError
        When the shapes do not fit together.

    References
    ----------
    Lancaster and Rodman, Algebraic Riccati Equations (1995), chapters 9 and 13.

    Examples
    --------
    >>> found = estimation.enclose_covariance([[-1.0]], [[1.0]], [[1.0]], 3.0, 1.0, covariance=[[1.0]])
    >>> found.proven, found.low.round(9), found.high.round(9)  # 2 P + P^2 = 3
    (True, array([1.]), array([1.]))
    """
    a, c = require_array("a", a, ndim=2), require_array("c", c, ndim=2)
    g = require_array("noise_input", noise_input, ndim=2)
    n = len(a)
    q, r = (
        matrix * np.eye(size) if matrix.ndim == 0 else matrix
        for matrix, size in (
            (require_array("process", process), g.shape[1]),
            (require_array("sensor", sensor), len(c)),
        )
    )
    p = require_array("covariance", covariance, shape=(n, n))
    p = (p + p.T) / 2
    # In units of the standard deviations, by powers of two, all states are alike.
    scale = 2.0 ** np.round(np.log2(np.sqrt(np.maximum(np.diag(p), 1e-300))))
    near = p / scale[:, None] / scale
    innovation = c @ p @ c.T + r if discrete else r
    gain = np.linalg.solve(innovation.T, c @ p.T).T
    closed = a - (a @ gain if discrete else gain) @ c
    closed = closed * scale / scale[:, None]
    solve = linalg.solve_discrete_lyapunov if discrete else linalg.solve_continuous_lyapunov
    try:
        shape = solve(closed, np.eye(n) if discrete else -np.eye(n))
    except (np.linalg.LinAlgError, ValueError):
        shape = np.full((n, n), np.nan)
    failed = CovarianceEnclosure(np.zeros(n), np.full(n, inf), False)
    exact = [_fractions(each) for each in (a, g, c, q, r)]
    noises = np.array_equal(q, q.T) and np.array_equal(r, r.T) and _definite(exact[3]) and _definite(exact[4])
    if not (noises and np.isfinite(shape).all()):
        return failed
    shape = (shape + shape.T) / 2
    grows: Callable[..., np.ndarray] = _discrete if discrete else _continuous
    size, unit = float(np.linalg.norm(near)), float(np.linalg.norm(shape))
    radius = np.finfo(float).eps * max(size, 1.0) / max(unit, 1e-300)
    for _ in range(TRIES):
        spread = radius * shape * scale[:, None] * scale
        middle, width = _fractions(p), _fractions(spread)
        low, high = middle - width, middle + width
        bounded = _definite(exact[2] @ low @ exact[2].T + exact[4]) and _definite(grows(*exact, low))
        if bounded and _definite(-grows(*exact, high)) and _definite(high):
            if discrete or _stable_gain(exact, high, shape * scale[:, None] * scale):
                ends = [np.array([float(each) for each in np.diag(matrix)]) for matrix in (low, high)]
                down, up = (np.nextafter(end, sign * inf) for end, sign in zip(ends, (-1, 1), strict=True))
                return CovarianceEnclosure(np.maximum(down, 0.0), up, True)
        radius *= 10
    return failed


def _fractions(matrix: np.ndarray) -> np.ndarray:
    found = np.empty(matrix.shape, dtype=object)
    for place in np.ndindex(matrix.shape):
        found[place] = Fraction(float(matrix[place]))
    return found


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Gauss and Jordan, of as many rows as there are outputs."""
    n = len(matrix)
    whole = np.hstack([matrix, _fractions(np.eye(n))])
    for k in range(n):
        pivot = next(r for r in range(k, n) if whole[r, k])
        whole[[k, pivot]] = whole[[pivot, k]]
        whole[k] = whole[k] / whole[k, k]
        for r in range(n):
            if r != k:
                whole[r] = whole[r] - whole[r, k] * whole[k]
    return whole[:, n:]


def _continuous(a, g, c, q, r, x) -> np.ndarray:
    """AX + XA' + GQG' - XC'R^-1CX."""
    seen = c @ x
    return a @ x + x @ a.T + g @ q @ g.T - seen.T @ _inverse(r) @ seen


def _discrete(a, g, c, q, r, x) -> np.ndarray:
    """A(X - XC'(CXC' + R)^-1CX)A' + GQG' - X."""
    seen = c @ x
    return a @ (x - seen.T @ _inverse(seen @ c.T + r) @ seen) @ a.T + g @ q @ g.T - x


def _stable_gain(exact, x: np.ndarray, shape: np.ndarray) -> bool:
    """Whether A - XC'R^-1C is stable: an approximate Lyapunov matrix of it is definite, and so is what it leaves."""
    a, _, c, _, r = exact
    closed, form = a - x @ c.T @ _inverse(r) @ c, _fractions(shape)
    return _definite(form) and _definite(-(closed @ form + form @ closed.T))


def _definite(matrix: np.ndarray) -> bool:
    """Whether a symmetric matrix of fractions is positive definite: its leading minors, by Bareiss."""
    scale = lcm(*(each.denominator for each in matrix.ravel()))
    rows = [[int(each * scale) for each in row] for row in matrix]
    before = 1
    for k in range(len(rows)):
        if rows[k][k] <= 0:
            return False
        for i in range(k + 1, len(rows)):
            for j in range(k + 1, len(rows)):
                rows[i][j] = (rows[i][j] * rows[k][k] - rows[i][k] * rows[k][j]) // before
        before = rows[k][k]
    return True
