"""Where adaptation ends and how it gets there, from spectra alone: an oracle for the simulation.

In the mean, both algorithms stop where the filtered error has nothing in common with the filtered regressors,
``E[e psi_N'] = 0``. That is linear in the weights, ``A w + b = 0``, and A tells the convergence as well.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike

from experiments.isolation.floors import ShapedFloor
from experiments.isolation.recorded_floors import SpectralFloor
from experiments.isolation.responses import responses
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array, require_number

FORGETTING = float(np.exp(-2e-4 / 10))  # exp(-Ts / 10 s), Section 5.1.1


@dataclass(frozen=True)
class Steady:
    """Mean behaviour of the adaptation on a stationary floor."""

    weights: Float64[np.ndarray, "actuators regressors"]  # fixed point of both algorithms, E[e psi_N'] = 0
    # weights with the smallest E[e'e]: Wiener's solution. Equal to the fixed point for a perfect estimate
    least_squares: Float64[np.ndarray, "actuators regressors"]
    error_power: float  # E[e'e] at the two, N^2
    least_error_power: float
    # A, on the rows of W one after another: mean of e psi_N' per deviation of W from the fixed point
    update: Float64[np.ndarray, "modes modes"]
    correlation: Float64[np.ndarray, "regressors regressors"]  # R = E[psi_N psi_N']
    covariance: Float64[np.ndarray, "regressors regressors"]  # P that FeRLS settles at, (1 - lambda) R^-1
    # of R^-1 A. Convergence is stable when all real parts are positive; all are 1 for a perfect estimate,
    # and a mode settles with the forgetting's time constant over its eigenvalue
    rls_eigenvalues: Complex128[np.ndarray, "modes"]
    # of A over the trace of R: a mode settles in 1 / (mu eigenvalue) samples (trace over the regressors)
    lms_eigenvalues: Complex128[np.ndarray, "modes"]


def steady_state(
    twin: Twin,
    floor: ShapedFloor | SpectralFloor,
    *,
    forgetting: float = FORGETTING,
    noise: bool = True,
    frequencies_hz: ArrayLike | None = None,
) -> Steady:
    """Fixed point, covariance and mean convergence of FeLMS and FeRLS on a floor with independent sensors.

    Mains lines are left out: N has a notch at each.
    """
    require_number("forgetting", forgetting, above=0.0, below=1.0)
    f = require_array(
        "frequencies_hz", default_grid(twin) if frequencies_hz is None else frequencies_hz, ndim=1
    )
    paths = responses(twin, f)
    quadrature = _trapezoid(f)
    floor_power = floor.density(f).T * quadrature[:, None]
    sensor_power = noise * twin.instruments.floor_noise**2 * quadrature[:, None]
    output_power = noise * twin.instruments.platform_noise**2

    shaped = paths.shaping[:, None, None] * paths.regressors  # psi_N per (a0 + n0)
    response = paths.error @ paths.secondary  # e per u
    disturbance = paths.error @ paths.primary  # e per a0
    seen = (floor_power + sensor_power)[:, None, :]
    correlation = _mean(shaped * seen, shaped)
    size = np.sqrt(np.diag(correlation))
    if np.min(size) == 0 or np.linalg.cond(correlation / np.outer(size, size)) > 1e12:
        raise InputError("floor leaves a combination of regressors silent; give every sensor some motion")

    # E[e psi_N'] = b + sum_f G W Q with G = e per u and Q = psi (psi_N)^H.
    cross = (paths.regressors * seen) @ np.conj(shaped.transpose(0, 2, 1))
    b = _mean(disturbance * floor_power[:, None, :], shaped)
    mean_update = _kronecker(response, cross)
    weights = -np.linalg.solve(mean_update, b.ravel()).reshape(b.shape)

    # Least squares: the gradient of E[e'e] in the weights, G^H e psi^H, vanishes.
    hermitian = np.conj(response.transpose(0, 2, 1))
    plain = (paths.regressors * seen) @ np.conj(paths.regressors.transpose(0, 2, 1))
    normal = _kronecker(hermitian @ response, plain)
    right = _mean(hermitian @ disturbance * floor_power[:, None, :], paths.regressors)
    least = -np.linalg.solve(normal, right.ravel()).reshape(b.shape)

    def power(w):
        by_floor = disturbance + response @ (w @ paths.regressors)
        by_sensors = response @ (w @ paths.regressors)
        by_output = paths.error @ paths.sensitivity
        return float(
            np.sum(np.abs(by_floor) ** 2 * floor_power[:, None, :])
            + np.sum(np.abs(by_sensors) ** 2 * sensor_power[:, None, :])
            + np.sum(np.abs(by_output) ** 2 * (output_power * quadrature)[:, None, None])
        )

    inverse = np.linalg.inv(correlation)
    inverse = (inverse + inverse.T) / 2
    actuators = twin.actuators
    return Steady(
        weights=weights,
        least_squares=least,
        error_power=power(weights),
        least_error_power=power(least),
        update=mean_update,
        correlation=correlation,
        covariance=(1 - forgetting) * inverse,
        rls_eigenvalues=np.linalg.eigvals(np.kron(np.eye(actuators), inverse) @ mean_update).astype(complex),
        lms_eigenvalues=(np.linalg.eigvals(mean_update) / np.trace(correlation)).astype(complex),
    )


def default_grid(twin: Twin) -> Float64[np.ndarray, "frequencies"]:
    """Frequencies dense enough for the weak integrators, the suspension and the notches."""
    half = twin.instruments.sample_rate / 2
    return np.unique(
        np.concatenate([np.geomspace(1e-5, 0.9999, 2000) * half, np.linspace(0.0005, 0.9999, 2000) * half])
    )


def _trapezoid(f: np.ndarray) -> np.ndarray:
    """Weights of the trapezoidal rule on a grid."""
    step = np.diff(f)
    return (np.append(step, 0) + np.append(0, step)) / 2


def _mean(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Real part of the sum over frequencies of left right^H: a correlation, from one-sided spectra."""
    return np.einsum("fis,fjs->ij", left, np.conj(right), optimize=True).real


def _kronecker(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Matrix of W -> Re sum_f left W right on the rows of W, one after another."""
    rows, columns = left.shape[1], right.shape[1]
    flat = left.reshape(len(left), -1).T @ right.reshape(len(right), -1)
    blocks = flat.real.reshape(rows, rows, columns, columns)
    # (left W right)_ij = sum_kl left_ik W_kl right_lj
    return blocks.transpose(0, 3, 1, 2).reshape(rows * columns, rows * columns)
