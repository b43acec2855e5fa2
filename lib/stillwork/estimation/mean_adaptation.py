"""Fixed point, convergence and scatter of a filtered-error adaptation, from spectra alone.

In the mean, FeLMS and FeRLS stop where the filtered error has nothing in common with the filtered regressors,
``E[e psi_N'] = 0``. That is linear in the weights, ``A w + b = 0``, and A determines the convergence, too.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.bounds import NonNegative, Positive, one_of, within
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import by_value, check_fields, checked

ALGORITHMS = ("FeRls", "FeLms")
CrossSpectra = (
    Float64[np.ndarray, "frequencies sensors sensors"] | Complex128[np.ndarray, "frequencies sensors sensors"]
)
# Beyond this condition of the scaled correlation a combination of regressors counts as silent.
SILENT = 1e12


@by_value
@dataclass(frozen=True)
class Responses:
    """Frequency responses of a sampled loop with a self-tuned feedforward, frequencies along the first axis.

    The measured platform acceleration is ``a1 = P1 a0 + P2 u`` and the feedforward ``u = W B (a0 + n0)``, with
    a0 and n0 before the signal conditioner, a1 behind it, and the skyhook part of P1 and P2.
    """

    frequencies_hz: Float64[np.ndarray, " frequencies"]  # below half the sample rate
    primary: Complex128[np.ndarray, "frequencies outputs sensors"]  # P1
    secondary: Complex128[np.ndarray, "frequencies outputs actuators"]  # P2, m/s^2 per N
    # measured platform acceleration per platform noise n1, which enters before the conditioner
    sensitivity: Complex128[np.ndarray, "frequencies outputs outputs"]
    # B: conditioner and weak integrators
    regressors: Complex128[np.ndarray, "frequencies regressors sensors"]
    shaping: Complex128[np.ndarray, " frequencies"]  # N
    error: Complex128[np.ndarray, "frequencies actuators outputs"]  # N P2hat^-1
    conditioning: Complex128[np.ndarray, " frequencies"]

    def __post_init__(self):
        check_fields(self)

    @property
    def path_error(self) -> Complex128[np.ndarray, "frequencies actuators actuators"]:
        """P2hat^-1 P2: the identity for a perfect estimate; a positive definite Hermitian part converges."""
        return self.error @ self.secondary / self.shaping[:, None, None]

    @checked
    def feedforward(self, weights: ArrayLike | None) -> Complex128[np.ndarray, "frequencies outputs sensors"]:
        """P2 W B: response of frozen `weights` W to the floor sensors' readings; zero without weights."""
        shape = (self.secondary.shape[2], self.regressors.shape[1])
        given = require_array("weights", np.zeros(shape) if weights is None else weights, shape=shape)
        return self.secondary @ (given @ self.regressors)

    @checked
    def transmissibility(
        self, weights: ArrayLike | None = None
    ) -> Complex128[np.ndarray, "frequencies outputs sensors"]:
        """T from floor to platform acceleration, with frozen feedforward `weights`."""
        return (self.primary + self.feedforward(weights)) / self.conditioning[:, None, None]


@by_value
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
    rls_eigenvalues: Complex128[np.ndarray, " modes"]
    # of A over the trace of R: a mode settles in 1 / (mu eigenvalue) samples (trace over the regressors)
    lms_eigenvalues: Complex128[np.ndarray, " modes"]

    def __post_init__(self):
        check_fields(self)

    @property
    def rls_update(self) -> Float64[np.ndarray, "modes modes"]:
        """R^-1 A, of which `rls_eigenvalues` are the eigenvalues."""
        return np.kron(np.eye(len(self.weights)), np.linalg.inv(self.correlation)) @ self.update


@checked
def mean_adaptation(
    paths: Responses,
    quadrature: Float64[np.ndarray, " frequencies"],
    floor: CrossSpectra,
    sensor_noise: NonNegative,
    platform_noise: NonNegative,
    forgetting: Annotated[float, within(at_least=0.0, at_most=1.0)],
) -> Steady:
    """Fixed point, covariance and mean convergence of FeLMS and FeRLS.

    Parameters
    ----------
    paths : Responses
    quadrature : ndarray, shape (frequencies,)
        Weights of the sum over frequencies, Hz.
    floor : ndarray, shape (frequencies, sensors, sensors)
        One-sided cross-spectral densities of the floor's acceleration, (m/s^2)^2/Hz.
    sensor_noise, platform_noise : float
        Amplitude densities of each floor and platform sensor, m/s^2/sqrt(Hz).
    forgetting : float
        lambda of the covariance.

    Returns
    -------
    Steady

    Raises
    ------
    InputError
        When a combination of regressors is silent.
    """
    floor_power = floor * quadrature[:, None, None]
    sensor_power = (sensor_noise**2 * quadrature)[:, None, None] * np.eye(floor.shape[1])
    seen = floor_power + sensor_power

    shaped = paths.shaping[:, None, None] * paths.regressors  # psi_N per (a0 + n0)
    response = paths.error @ paths.secondary  # e per u
    disturbance = paths.error @ paths.primary  # e per a0
    correlation = _mean(shaped @ seen, shaped)
    size = np.sqrt(np.diag(correlation))
    if np.min(size) == 0 or np.linalg.cond(correlation / np.outer(size, size)) > SILENT:
        raise InputError("floor leaves a combination of regressors silent; give every sensor some motion")

    # E[e psi_N'] = b + sum_f G W Q with G = e per u and Q = psi (psi_N)^H.
    cross = (paths.regressors @ seen) @ _hermitian(shaped)
    b = _mean(disturbance @ floor_power, shaped)
    mean_update = sum_kronecker(response, cross)
    weights = -np.linalg.solve(mean_update, b.ravel()).reshape(b.shape)

    # Least squares: the gradient of E[e'e] in the weights, G^H e psi^H, vanishes.
    plain = (paths.regressors @ seen) @ _hermitian(paths.regressors)
    normal = sum_kronecker(_hermitian(response) @ response, plain)
    right = _mean(_hermitian(response) @ disturbance @ floor_power, paths.regressors)
    least = -np.linalg.solve(normal, right.ravel()).reshape(b.shape)

    inverse = np.linalg.inv(correlation)
    inverse = (inverse + inverse.T) / 2

    def power(w):
        own, _ = error_spectra(paths, w, floor, sensor_noise, platform_noise)
        return float(np.einsum("f,faa->", quadrature, own).real)

    return Steady(
        weights=weights,
        least_squares=least,
        error_power=power(weights),
        least_error_power=power(least),
        update=mean_update,
        correlation=correlation,
        covariance=(1 - forgetting) * inverse,
        rls_eigenvalues=np.linalg.eigvals(np.kron(np.eye(len(b)), inverse) @ mean_update).astype(complex),
        lms_eigenvalues=(np.linalg.eigvals(mean_update) / np.trace(correlation)).astype(complex),
    )


@checked
def error_spectra(
    paths: Responses,
    weights: Float64[np.ndarray, "actuators regressors"],
    floor: CrossSpectra,
    sensor_noise: NonNegative,
    platform_noise: NonNegative,
) -> tuple[
    Complex128[np.ndarray, "frequencies actuators actuators"],
    Complex128[np.ndarray, "frequencies actuators regressors"],
]:
    """One-sided densities of e and of e with psi_N for frozen `weights`."""
    by_sensors = paths.error @ paths.feedforward(weights)
    by_floor = paths.error @ paths.primary + by_sensors
    by_output = platform_noise * paths.error @ paths.sensitivity
    shaped = paths.shaping[:, None, None] * paths.regressors
    driven, heard = by_floor @ floor, sensor_noise**2 * by_sensors
    own = driven @ _hermitian(by_floor) + heard @ _hermitian(by_sensors) + by_output @ _hermitian(by_output)
    return own.astype(complex), ((driven + heard) @ _hermitian(shaped)).astype(complex)


@checked
def scatter(
    paths: Responses,
    steady: Steady,
    quadrature: Float64[np.ndarray, " frequencies"],
    floor: CrossSpectra,
    sensor_noise: NonNegative,
    platform_noise: NonNegative,
    sample_rate: Positive,
    algorithm: Annotated[str, one_of(ALGORITHMS)] = "FeRls",
) -> Float64[np.ndarray, "modes modes"]:
    """Covariance of the weights about the fixed point, for one unit of a small step: 1 - lambda of `FeRls`, mu of `FeLms`.

    It is S of B S + S B' = C O C', from v+ = v - step (B v + C xi) with xi = e psi_N' about its mean, of whose correlations O is
    the sum over all lags: on Gaussian signals a sum over frequency. The step of FeLMS is that of the trace over the regressors.
    """
    own, mixed = error_spectra(paths, steady.weights, floor, sensor_noise, platform_noise)
    shaped = paths.shaping[:, None, None] * paths.regressors
    seen = floor + sensor_noise**2 * np.eye(floor.shape[1])
    regressors = shaped @ seen @ _hermitian(shaped)
    half = quadrature * sample_rate / 2
    size = steady.weights.size
    total = np.einsum("f,fab,fij->aibj", half, own, np.conj(regressors), optimize=True)
    total = total + np.einsum("f,faj,fbi->aibj", half, mixed, mixed, optimize=True)
    total = total.real.reshape(size, size)
    if algorithm == "FeRls":
        inverse = np.kron(np.eye(len(steady.weights)), np.linalg.inv(steady.correlation))
        moves, total = inverse @ steady.update, inverse @ total @ inverse.T
    else:
        trace = np.trace(steady.correlation)
        moves, total = steady.update / trace, total / trace**2
    found = linalg.solve_continuous_lyapunov(moves, total)
    return (found + found.T) / 2


def _hermitian(matrices: np.ndarray) -> np.ndarray:
    return np.conj(matrices.transpose(0, 2, 1))


def _mean(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Real part of the sum over frequencies of left right^H: a correlation, from one-sided spectra."""
    return np.einsum("fis,fjs->ij", left, np.conj(right), optimize=True).real


@checked
def sum_kronecker(
    left: Complex128[np.ndarray, "frequencies rows rows"], right: Complex128[np.ndarray, "frequencies n n"]
) -> Float64[np.ndarray, "modes modes"]:
    """Matrix of W -> Re sum_f left W right on the rows of W, one after another."""
    rows, columns = left.shape[1], right.shape[1]
    flat = left.reshape(len(left), -1).T @ right.reshape(len(right), -1)
    blocks = flat.real.reshape(rows, rows, columns, columns)
    # (left W right)_ij = sum_kl left_ik W_kl right_lj
    return blocks.transpose(0, 3, 1, 2).reshape(rows * columns, rows * columns)
