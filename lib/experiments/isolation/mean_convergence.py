"""Expected course of the weights from the oracle alone, and whether it is stable."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from experiments.isolation.convergence import ALGORITHMS
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array, require_choice
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
