"""Stationary Kalman gains from Riccati equations that are scaled before and checked after they are solved."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import InputError, require_array
from stillwork.base.front_door import checked

# Relative residual above which a solution is refused; a scaled solution leaves about 1e-12.
WORST_RESIDUAL = 1e-8


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
            raise InputError(f"{name} is zero; an observer takes a disturbance and a measurement")
    return a, g @ factors[0], np.linalg.solve(factors[1], c), factors[1]


def _require_observable(a: np.ndarray, c: np.ndarray, stable) -> None:
    """Popov-Belevitch-Hautus test (3.16) of every mode that the observer cannot leave alone."""
    size = np.linalg.norm(a) or 1.0
    for value in linalg.eigvals(a):
        if not stable(value):
            pencil = np.vstack([(a - value * np.eye(len(a))) / size, c / np.linalg.norm(c)])
            columns = np.maximum(np.linalg.norm(pencil, axis=0), 1e-14)
            if np.linalg.svd(pencil / columns, compute_uv=False)[-1] < 1e-10:
                raise InputError(
                    f"the mode at s = {value:.3g} is not observable and not stable; measure it or leave it out"
                )


def _require_driven(a: np.ndarray, g: np.ndarray, on_boundary) -> None:
    """No stabilising solution exists when a mode on the stability boundary gets no noise."""
    size = np.linalg.norm(a) or 1.0
    for value in linalg.eigvals(a):
        if on_boundary(value):
            pencil = np.hstack([(a - value * np.eye(len(a))) / size, g / np.linalg.norm(g)])
            rows = np.maximum(np.linalg.norm(pencil, axis=1), 1e-14)
            if np.linalg.svd(pencil / rows[:, None], compute_uv=False)[-1] < 1e-10:
                raise InputError(
                    f"the mode at s = {value:.3g} is not driven and not stable; let noise_input reach it"
                )


@checked
def continuous_gain(
    a: ArrayLike, noise_input: ArrayLike, c: ArrayLike, process: float | ArrayLike, sensor: float | ArrayLike
) -> KalmanGain:
    r"""Kalman gain :math:`L = PC^TR^{-1}` with :math:`AP + PA^T + GQG^T - PC^TR^{-1}CP = 0` (section 3.1).

    Parameters
    ----------
    a, noise_input, c : array_like
        A, G and C of the model.
    process, sensor : float or array_like
        Intensities Q and R; a number stands for a multiple of the identity.

    Raises
    ------
    InputError
        When an intensity is not positive definite, `noise_input` or `c` is zero, a mode on or right of the
        imaginary axis is not observable, one on the axis is not driven by the noise, or the solution leaves
        too large a residual.
    """
    a, g, c, root = _checked(a, noise_input, c, process, sensor)
    scale = _state_scale(a, g, c)
    rate = np.linalg.norm(a * scale[None, :] / scale[:, None]) or 1.0  # its eigenvalues may all be zero
    for _ in range(2):  # the second time every state is scaled by its own standard deviation
        a_s = a * scale[None, :] / scale[:, None] / rate
        g_s, c_s = g / scale[:, None] / np.sqrt(rate), c * scale / np.sqrt(rate)
        # Divide noise and multiply output alike: the gain stays, the covariance becomes of order one.
        size = np.sqrt(np.linalg.norm(g_s) / np.linalg.norm(c_s))
        g_s, c_s = g_s / size, c_s * size
        _require_observable(a_s, c_s, stable=lambda value: value.real < -1e-12)
        _require_driven(a_s, g_s, on_boundary=lambda value: abs(value.real) <= 1e-12)
        try:
            p = linalg.solve_continuous_are(a_s.T, c_s.T, g_s @ g_s.T, np.eye(len(c)))
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(
                f"the Riccati equation has no stabilising solution ({error}); check the model"
            ) from None
        terms = (a_s @ p, g_s @ g_s.T, p @ c_s.T @ c_s @ p)
        residual = np.abs(terms[0] + terms[0].T + terms[1] - terms[2]).max() / max(
            np.abs(t).max() for t in terms
        )
        gain_s, covariance = p @ c_s.T, p
        gain = scale[:, None] * gain_s * size * np.sqrt(rate)
        full = covariance * size**2 * scale[:, None] * scale
        scale = np.sqrt(np.maximum(np.diag(full), 1e-300))
    if not residual < WORST_RESIDUAL:
        raise InputError(
            f"the Riccati equation left a relative residual of {residual:.1e}; rescale the model or the intensities"
        )
    return KalmanGain(np.linalg.solve(root.T, gain.T).T, full, float(residual))


def _state_scale(a: np.ndarray, g: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Scale of the states that balances A, G and C together; A alone says nothing about a rigid body."""
    n, size = len(a), max(g.shape[1], len(c))
    whole = np.zeros((n + size, n + size))
    whole[:n, :n] = a
    whole[:n, n : n + g.shape[1]] = g / np.linalg.norm(g)
    whole[n : n + len(c), :n] = c / np.linalg.norm(c)
    _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    return scale[:n]


@checked
def discrete_gain(
    a: ArrayLike, noise_input: ArrayLike, c: ArrayLike, process: float | ArrayLike, sensor: float | ArrayLike
) -> KalmanGain:
    r"""Predictor gain :math:`L = APC^T(CPC^T+R)^{-1}` and filter gain :math:`PC^T(CPC^T+R)^{-1}` (section 4.1.3).

    Parameters and errors as for `continuous_gain`; the intensities are now covariances per sample.
    """
    a, g, c, root = _checked(a, noise_input, c, process, sensor)
    scale = _state_scale(a, g, c)
    for _ in range(2):
        a_s = a * scale[None, :] / scale[:, None]
        g_s, c_s = g / scale[:, None], c * scale
        size = np.sqrt(np.linalg.norm(g_s) / np.linalg.norm(c_s))
        g_s, c_s = g_s / size, c_s * size
        _require_observable(a_s, c_s, stable=lambda value: abs(value) < 1 - 1e-12)
        _require_driven(a_s, g_s, on_boundary=lambda value: abs(abs(value) - 1) <= 1e-12)
        try:
            p = linalg.solve_discrete_are(a_s.T, c_s.T, g_s @ g_s.T, np.eye(len(c)))
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(
                f"the Riccati equation has no stabilising solution ({error}); check the model"
            ) from None
        innovation = c_s @ p @ c_s.T + np.eye(len(c))
        update = np.linalg.solve(innovation, c_s @ p).T
        terms = (a_s @ (p - update @ c_s @ p) @ a_s.T, g_s @ g_s.T, p)
        residual = np.abs(terms[0] + terms[1] - terms[2]).max() / max(np.abs(t).max() for t in terms)
        gain = scale[:, None] * update * size
        full = p * size**2 * scale[:, None] * scale
        scale = np.sqrt(np.maximum(np.diag(full), 1e-300))
    if not residual < WORST_RESIDUAL:
        raise InputError(
            f"the Riccati equation left a relative residual of {residual:.1e}; rescale the model or the intensities"
        )
    gain = np.linalg.solve(root.T, gain.T).T
    return KalmanGain(a @ gain, full, float(residual), gain)
