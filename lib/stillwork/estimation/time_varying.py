r"""Discrete-time filters whose gains do not depend on the data: designed once, run over any number of records.

    x(k|k-1) = A_hat x(k-1|k-1) + B_hat u(k-1),   x(k|k) = x(k|k-1) + K (y(k) - C x(k|k-1))

Kalman and robust filters differ in the three matrices only, (5.21) and (5.25) of the observer thesis.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import Converted, InputError, pluralise, require_array, require_finite_run
from stillwork.base.kernels import kernel
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.estimation.gaussian import require_covariance

RESCALE = "rescale the model, its noises or the penalty"  # where a filter's matrices overflow


@checked
def require_per_sample(
    name: str, value: ArrayLike, samples: int, shape: tuple[int | None, ...]
) -> np.ndarray:
    """Return a matrix for each sample; one without the leading axis stands for all of them."""
    matrix = require_array(name, value)
    if matrix.ndim == 2:
        matrix = np.broadcast_to(matrix, (samples, *matrix.shape))
    return require_array(name, matrix, shape=(samples, *shape))


@by_value
@dataclass(frozen=True)
class TimeVaryingModel:
    r"""Model :math:`x_k = A_k x_{k-1} + B_k u_{k-1} + G_k w_{k-1},\; y_k = C_k x_k + v_k`, (5.20).

    Index k holds what leads to sample k; index 0 of A, B and G is not used. A feedthrough is the caller's: take
    :math:`D u` off the measurement first. Matrices without the leading axis stand for all samples.
    """

    a: Converted  # (samples, states, states)
    b: Converted  # (samples, states, inputs)
    g: Converted  # (samples, states, disturbances)
    c: Converted  # (samples, outputs, states); sets the number of samples
    process: Converted  # Q, covariance of w, (disturbances, disturbances)
    sensor: Converted  # R, covariance of v, (outputs, outputs)
    initial_covariance: Converted  # P(0|0), (states, states)

    @checked
    def __post_init__(self):
        check_fields(self)
        c = require_array("c", self.c, ndim=3)
        samples, outputs, states = c.shape
        if samples < 2:
            raise InputError(
                f"c holds {pluralise(samples, 'sample')}; give the start and at least one measurement"
            )
        a = require_per_sample("a", self.a, samples, (states, states))
        b = require_per_sample("b", self.b, samples, (states, None))
        g = require_per_sample("g", self.g, samples, (states, None))
        for name, array in (("a", a), ("b", b), ("c", c), ("g", g)):
            object.__setattr__(self, name, array)
        sizes = {"process": g.shape[2], "sensor": outputs, "initial_covariance": states}
        for name, size in sizes.items():
            matrix = require_covariance(name, getattr(self, name), size)
            object.__setattr__(self, name, matrix)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.c)

    @checked
    def with_process(self, g: ArrayLike, process: ArrayLike) -> "TimeVaryingModel":
        """The same model with other process noise: fictitious noise represents model errors."""
        return replace(self, g=g, process=process)


@by_value
@dataclass(frozen=True)
class FilterGains:
    """Matrices of a filter at every sample."""

    forward: Float64[np.ndarray, "samples states states"]  # A_hat
    inputs: Float64[np.ndarray, "samples states inputs"]  # B_hat
    gain: Float64[np.ndarray, "samples states outputs"]  # K
    outputs: Float64[np.ndarray, "samples outputs states"]  # C
    covariance: Float64[np.ndarray, "samples states states"] | None = None  # P(k|k) of a Riccati equation

    @checked
    def __post_init__(self):
        try:
            check_fields(self)
        except InputError:
            for name in ("gain", "covariance"):
                value = getattr(self, name)
                if isinstance(value, np.ndarray) and value.dtype.kind == "f":
                    require_finite_run(f"the filter's {name}", value, RESCALE)
            raise

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.forward)


@checked(missing=True)
def estimate(
    gains: FilterGains, u: ArrayLike, y: ArrayLike, initial: ArrayLike | None = None
) -> Float64[np.ndarray, "*runs states samples"]:
    """Filtered estimates x(k|k) of one record (states, samples) or of many (runs, states, samples).

    The known input is held from sample to sample, x(0|0) zero by default; the measurement at sample 0 is not used.
    """
    samples, states, inputs = gains.inputs.shape
    y = require_array("y", y)
    single = y.ndim == 2
    y = y[None] if single else y
    u = require_array("u", u)
    u = u[None] if single else u
    y = require_array("y", y, shape=(None, gains.outputs.shape[1], samples))
    u = require_array("u", u, shape=(len(y), inputs, samples))
    initial = np.zeros(states) if initial is None else require_array("initial", initial, shape=(states,))
    out = np.empty((len(y), states, samples))
    _estimate(gains.forward, gains.inputs, gains.gain, gains.outputs, u, y, initial, out)
    require_finite_run("the estimate", out, "check the gains and the size of the record", axis=2)
    return out[0] if single else out


@kernel
def _estimate(forward, inputs, gain, outputs, u, y, initial, out):
    runs, n, samples = out.shape
    x, predicted, innovation = np.empty(n), np.empty(n), np.empty(y.shape[1])
    for run in range(runs):
        for i in range(n):
            x[i] = out[run, i, 0] = initial[i]
        for k in range(1, samples):
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += forward[k, i, j] * x[j]
                for j in range(u.shape[1]):
                    total += inputs[k, i, j] * u[run, j, k - 1]
                predicted[i] = total
            for j in range(y.shape[1]):
                total = y[run, j, k]
                for i in range(n):
                    total -= outputs[k, j, i] * predicted[i]
                innovation[j] = total
            for i in range(n):
                total = predicted[i]
                for j in range(y.shape[1]):
                    total += gain[k, i, j] * innovation[j]
                x[i] = out[run, i, k] = total
