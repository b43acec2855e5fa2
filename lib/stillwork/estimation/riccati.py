"""Stationary Kalman gains from Riccati equations that are scaled before and checked after they are solved."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import by_value, checked
from stillwork.lti.scaling import state_scale

# Relative residual above which a solution is refused; a scaled solution leaves about 1e-12.
WORST_RESIDUAL = 1e-8


@by_value
@dataclass(frozen=True)
class KalmanGain:
    """Stationary Kalman filter of a model."""

    gain: Float64[np.ndarray, "states outputs"]  # L; in discrete time that of the predictor
    covariance: Float64[np.ndarray, "states states"]  # P, of the (predicted) estimation error
    residual: float  # of the Riccati equation, relative to its largest term
    filter_gain: Float64[np.ndarray, "states outputs"] | None = None  # discrete time only: measurement update


def _checked(a, g, c, q, r):
    a = require_array("a", a, ndim=2)
    n = len(a)
    a = require_array("a", a, shape=(n, n))
    g = require_array("noise_input", g, shape=(n, None))
    c = require_array("c", c, shape=(None, n))
    factors = []
    for name, matrix, size in (("process", q, g.shape[1]), ("sensor", r, len(c))):
        matrix = require_array(name, matrix)
        matrix = (
            matrix * np.eye(size) if matrix.ndim == 0 else require_array(name, matrix, shape=(size, size))
        )
        if not np.allclose(matrix, matrix.T, rtol=1e-9, atol=0):
            raise InputError(f"{name} is not symmetric; give a covariance, such as (X + X.T) / 2")
        try:
            factors.append(np.linalg.cholesky(matrix))
        except np.linalg.LinAlgError:
            raise InputError(f"{name} is not positive definite; give the intensity of real noise") from None
    for name, matrix in (("noise_input", g), ("c", c)):
        if not np.any(matrix):
            raise InputError(f"{name} is zero; an observer needs a disturbance and a measurement")
    return a, g @ factors[0], np.linalg.solve(factors[1], c), factors[1]


def _require_seen(a: np.ndarray, c: np.ndarray, values: np.ndarray, advice: str) -> None:
    """Popov-Belevitch-Hautus test (3.16) of modes with these eigenvalues; of A' and G' whether they are driven."""
    size = np.linalg.norm(a) or 1.0
    for value in values:
        pencil = np.vstack([(a - value * np.eye(len(a))) / size, c / np.linalg.norm(c)])
        columns = np.maximum(np.linalg.norm(pencil, axis=0), 1e-14)
        if np.linalg.svd(pencil / columns, compute_uv=False)[-1] < 1e-10:
            raise InputError(f"the mode at s = {value:.3g} is not {advice}")


@checked
def continuous_gain(
    a: ArrayLike, noise_input: ArrayLike, c: ArrayLike, process: float | ArrayLike, sensor: float | ArrayLike
) -> KalmanGain:
    r"""Kalman gain :math:`L = PC^TR^{-1}` with :math:`AP + PA^T + GQG^T - PC^TR^{-1}CP = 0` (section 3.1).

    The intensities Q and R are matrices, or numbers for a multiple of the identity. An error names the reason why there is no
    accurate solution: an intensity that is not positive definite, a mode on or right of the imaginary axis that is not
    observable, one on the axis that the noise does not drive, a large residual or an unstable observer.
    """
    return KalmanGain(*_stationary(a, noise_input, c, process, sensor, discrete=False))


def _stationary(
    a, noise_input, c, process, sensor, *, discrete: bool
) -> tuple[np.ndarray, np.ndarray, float]:
    """Gain that corrects, covariance and residual."""
    a, g, c, root = _checked(a, noise_input, c, process, sensor)
    scale = state_scale(a, g / np.linalg.norm(g), c / np.linalg.norm(c))
    # The eigenvalues may all be zero.
    rate = 1.0 if discrete else np.linalg.norm(a * scale[None, :] / scale[:, None]) or 1.0
    solve = linalg.solve_discrete_are if discrete else linalg.solve_continuous_are
    check = _discrete_check if discrete else _continuous_check
    for last in (False, True):  # the second time every state is scaled by its own standard deviation
        a_s = a * scale[None, :] / scale[:, None] / rate
        g_s, c_s = g / scale[:, None] / np.sqrt(rate), c * scale / np.sqrt(rate)
        # Divide noise and multiply output alike: the gain stays, the covariance becomes of order one.
        size = np.sqrt(np.linalg.norm(g_s) / np.linalg.norm(c_s))
        g_s, c_s = g_s / size, c_s * size
        values = linalg.eigvals(a_s)
        values = values[values.imag >= 0]  # of a pair one
        beyond = np.abs(values) - 1 if discrete else values.real  # the boundary of stability
        measured = "observable and not stable; measure it or leave it out"
        _require_seen(a_s, c_s, values[~(beyond < -1e-12)], measured)
        driven = "driven and not stable; let noise_input reach it"
        _require_seen(a_s.T, g_s.T, values[np.abs(beyond) <= 1e-12], driven)
        p = _solved(solve, a_s, g_s, c_s)
        if last:
            update, residual, stable = check(a_s, g_s, c_s, p)
            if not (stable and residual < WORST_RESIDUAL):
                p = _doubled(*((a_s.T, c_s.T @ c_s, g_s @ g_s.T) if discrete else _cayley(a_s, g_s, c_s)))
                update, residual, stable = check(a_s, g_s, c_s, p)
            gain = scale[:, None] * update * size * np.sqrt(rate)
        full = p * size**2 * scale[:, None] * scale
        if np.isfinite(full).all():
            scale = np.sqrt(np.maximum(np.diag(full), 1e-300))
    _require_solved(residual, stable)
    return np.linalg.solve(root.T, gain.T).T, full, float(residual)


def _solved(solve, a: np.ndarray, g: np.ndarray, c: np.ndarray) -> np.ndarray:
    """A library's solution of the filter's Riccati equation for unit noises; NaN where it finds none."""
    try:
        return solve(a.T, c.T, g @ g.T, np.eye(len(c)))
    except (np.linalg.LinAlgError, ValueError):
        return np.full_like(a, np.nan)


def _continuous_check(a, g, c, p) -> tuple[np.ndarray, float, bool]:
    """The gain of a solution, its relative residual, and whether its observer is stable: neither follows from the other."""
    if not np.isfinite(p).all():
        return np.zeros_like(c.T), np.inf, False
    terms = (a @ p, g @ g.T, p @ c.T @ c @ p)
    residual = np.abs(terms[0] + terms[0].T + terms[1] - terms[2]).max() / max(np.abs(t).max() for t in terms)
    return p @ c.T, residual, bool(np.all(linalg.eigvals(a - p @ c.T @ c).real < 0))


def _discrete_check(a, g, c, p) -> tuple[np.ndarray, float, bool]:
    """Likewise in discrete time, of the filter."""
    if not np.isfinite(p).all():
        return np.zeros_like(c.T), np.inf, False
    innovation = c @ p @ c.T + np.eye(len(c))
    update = np.linalg.solve(innovation, c @ p).T
    terms = (a @ (p - update @ c @ p) @ a.T, g @ g.T, p)
    residual = np.abs(terms[0] + terms[1] - terms[2]).max() / max(np.abs(t).max() for t in terms)
    return update, residual, bool(np.all(np.abs(linalg.eigvals(a - a @ update @ c)) < 1))


def _require_solved(residual: float, stable: bool) -> None:
    if not residual < WORST_RESIDUAL:
        found = (
            "has no stabilising solution"
            if residual == np.inf
            else f"left a relative residual of {residual:.1e}"
        )
        raise InputError(f"the Riccati equation {found}; check the model, or rescale it or the intensities")
    if not stable:
        raise InputError(
            "the solution of the Riccati equation gives an unstable observer: process and sensor span more decades "
            "than floating-point numbers resolve; raise the smallest of them or lower the largest"
        )


def _doubled(transition: np.ndarray, gram: np.ndarray, p: np.ndarray) -> np.ndarray:
    r"""Limit from zero of :math:`P \leftarrow F^TP(I+GP)^{-1}F+H`, 2^k of its steps at a time.

    Without the ordering of eigenvalues that fails where a pair of them straddles the stability boundary by less
    than rounding. Chu, Fan, Lin and Wang, "Structure-preserving algorithms for periodic discrete-time algebraic
    Riccati equations", Int. J. Control 77 (2004).
    """
    n = len(p)
    for _ in range(60):
        inner = np.linalg.solve(np.eye(n) + gram @ p, np.hstack([transition, gram]))
        added = transition.T @ p @ inner[:, :n]
        gram = gram + transition @ inner[:, n:] @ transition.T
        transition = transition @ inner[:, :n]
        p, gram = p + (added + added.T) / 2, (gram + gram.T) / 2
        if not np.isfinite(p).all() or np.abs(added).max() <= np.finfo(float).eps * np.abs(p).max():
            break
    return p


def _cayley(a: np.ndarray, g: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """F, G and H of the discrete equation with the solution of the continuous one (Chu, Fan and Lin, 2005)."""
    shift = 2 * np.linalg.norm(a, 2) + 1e-3  # above every eigenvalue
    shifted, gram, noise = a.T - shift * np.eye(len(a)), c.T @ c, g @ g.T
    mixed = np.linalg.inv(shifted + gram @ np.linalg.solve(shifted.T, noise))
    f = np.eye(len(a)) + 2 * shift * mixed
    return (
        f,
        2 * shift * np.linalg.solve(shifted, gram) @ mixed.T,
        2 * shift * mixed.T @ noise @ np.linalg.inv(shifted),
    )


@checked
def covariance_root(covariance: Float64[np.ndarray, "n n"]) -> Float64[np.ndarray, "n n"]:
    """G of G G' = a covariance that may be semidefinite, to enter `discrete_gain` as the input of unit noises."""
    values, vectors = linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))


@checked
def discrete_gain(
    a: ArrayLike, noise_input: ArrayLike, c: ArrayLike, process: float | ArrayLike, sensor: float | ArrayLike
) -> KalmanGain:
    r"""Predictor gain :math:`L = APC^T(CPC^T+R)^{-1}` and filter gain :math:`PC^T(CPC^T+R)^{-1}` (section 4.1.3).

    Parameters and errors as for `continuous_gain`; the intensities are now covariances per sample.
    """
    gain, covariance, residual = _stationary(a, noise_input, c, process, sensor, discrete=True)
    return KalmanGain(require_array("a", a) @ gain, covariance, residual, gain)
