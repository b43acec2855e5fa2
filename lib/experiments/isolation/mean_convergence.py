"""Expected course of the weights from the oracle alone, and whether it is stable."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg, signal

from experiments.isolation.convergence import ALGORITHMS
from experiments.isolation.floors import FLAT_LEVEL, ShapedFloor
from experiments.isolation.simulation import simulate
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array, require_choice
from stillwork.estimation.adaptive import FeRls
from stillwork.estimation.mean_adaptation import Steady


def mean_course(
    twin: Twin,
    steady: Steady,
    algorithm: str,
    time_s: ArrayLike,
    *,
    step_size: float = 1e-4,
    memory_s: float = 10.0,
    initial_covariance: float = 1.0,
    start: Steady | None = None,
) -> Float64[np.ndarray, "times parameters"]:
    """Expected weights of the first actuator, for slow adaptation, without a simulation.

    FeLMS (trace over the regressors): ``w' = -mu / (T tr R) A (w - w*)``. FeRLS: the same with P(t) in place of the
    gain, ``P^-1 = exp(-t / memory) P0^-1 + (1 - exp(-t / memory)) R memory / T``. On `start` the algorithm has
    settled before; without it weights start from zero.
    """
    require_choice("algorithm", algorithm, ALGORITHMS)
    time_s = require_array("time_s", time_s, ndim=1)
    if np.any(np.diff(time_s, prepend=0.0) <= 0):
        raise InputError("time_s must rise from above zero")
    actuators, n = steady.weights.shape
    target = steady.weights.ravel()
    off = (0.0 if start is None else start.weights.ravel()) - target
    if algorithm == "FeLMS":
        rate = step_size / (twin.sample_time * np.trace(steady.correlation))
        values, vectors = np.linalg.eig(steady.update)
        modes = np.linalg.solve(vectors, off.astype(complex))
        course = vectors[:n] @ (np.exp(-rate * np.outer(values, time_s)) * modes[:, None])
        return target[:n] + course.real.T
    samples = memory_s / twin.sample_time  # of the memory: (1 - lambda) R^-1 is the inverse of samples R
    information = steady.correlation * samples
    if start is None:
        before = np.diag(1 / (initial_covariance * np.diag(np.linalg.inv(information))))
    else:
        before = start.correlation * samples
    course = []
    now = 0.0
    for end in time_s:
        # Over a short step P hardly changes, and the exponential of the rest is exact.
        fade = np.exp(-(now + end) / 2 / memory_s)
        covariance = np.linalg.inv(fade * before + (1 - fade) * information)
        gain = np.kron(np.eye(actuators), covariance) @ steady.update / twin.sample_time
        off = linalg.expm(-(end - now) * gain) @ off
        course.append(target[:n] + off[:n])
        now = end
    return np.array(course)


@dataclass(frozen=True)
class Sideways:
    """Course of a weight error that pushes the platform along its x axis, which the floor does not excite."""

    time_s: Float64[np.ndarray, " kept"]
    # size, predicted: root mean square shaped command along the pattern, N: simulated, and from the mean
    # update R^-1 A alone
    size: Float64[np.ndarray, " kept"]
    predicted: Float64[np.ndarray, " kept"]
    # smallest real part of the eigenvalues of R^-1 A: the rate of decay in the end, times the memory
    eigenvalue: float


def narrow_floor(twin: Twin, low_hz: float, high_hz: float) -> ShapedFloor:
    """Floor confined to a band, second-order Butterworth, m/s^2/sqrt(Hz) inside; sensors independent."""
    rate = twin.instruments.sample_rate
    sections = signal.butter(2, [low_hz, high_hz], "bandpass", fs=rate, output="sos")
    return ShapedFloor(
        np.repeat(sections[None], twin.sensors, axis=0),
        np.full(twin.sensors, FLAT_LEVEL * np.sqrt(rate / 2)),
        rate,
    )


def follow_sideways(
    twin: Twin, floor: ShapedFloor, duration_s: float, memory_s: float, seed: int
) -> Sideways:
    """Run FeRLS without noise from the optimum plus a sideways error of the weights."""
    if twin.rig is None:
        raise InputError("the model has no geometry, so no sideways motion; take one with a body and struts")
    forgetting = float(np.exp(-twin.sample_time / memory_s))
    steady = steady_state(twin, floor, noise=False, forgetting=forgetting)
    pattern = twin.rig.actuators.jacobian[:, 0]
    pattern = pattern / np.linalg.norm(pattern)
    error = 1e-3 * np.outer(pattern, np.ones(twin.regressors))
    adaptation = FeRls(steady.covariance, forgetting, growth_limit=np.inf)
    settings = {"adaptation": adaptation, "weights": steady.weights + error, "noise": False, "seed": seed}
    run = simulate(twin, floor, duration_s, **settings)
    update = np.kron(np.eye(twin.actuators), np.linalg.inv(steady.correlation)) @ steady.update
    values, vectors = np.linalg.eig(update)
    modes = np.linalg.solve(vectors, error.ravel().astype(complex))
    mean = (vectors @ (np.exp(-np.outer(values, run.time_s) / memory_s) * modes[:, None])).real.T

    def size(off):
        along = np.einsum("a,kar->kr", pattern, off)
        return np.sqrt(np.einsum("ki,ij,kj->k", along, steady.correlation, along))

    return Sideways(
        run.time_s,
        size(run.weights - steady.weights),
        size(mean.reshape(-1, *error.shape)),
        float(steady.rls_eigenvalues.real.min()),
    )
