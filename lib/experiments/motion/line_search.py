"""The regularised filter with the best lambda at every sample: the exact solution of the min-max problem (5.15)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.algebra import (
    add_product,
    condition,
    copy_vector,
    measure,
    minus_row,
    multiply,
    set_product,
)
from stillwork.base.checks import require_array, require_finite_run
from stillwork.base.front_door import checked
from stillwork.base.kernels import kernel, pasted_kernel
from stillwork.estimation.robust import (
    NormBound,
    bound_rows,
    joint_covariance,
    lower_limit,
    principal,
    robust_step,
    sample_at,
    step_data,
)
from stillwork.estimation.time_varying import TimeVaryingModel


@dataclass(frozen=True)
class LineSearch:
    """Estimates of the regularised filter that solves for lambda at every sample."""

    states: Float64[np.ndarray, "states samples"]
    # optimal lambda over its lower limit; 1 where nothing is uncertain
    ratio: Float64[np.ndarray, " samples"]


@checked
def regularised_line_search(
    model: TimeVaryingModel, bound: NormBound, u: ArrayLike, y: ArrayLike, initial: ArrayLike | None = None
) -> LineSearch:
    r"""Regularised least-squares filter with the optimal :math:`\hat\lambda = \arg\min G(\lambda)` at every sample.

    :math:`G` is the minimum over (x, w) of the cost above; the optimum depends on the data, so there are no
    gains beforehand. It is the exact solution of the min-max problem (5.15) at every step.
    """
    rows, m = bound_rows(model, bound)
    samples, outputs, states = model.c.shape
    u = require_array("u", u, shape=(model.b.shape[2], samples))
    y = require_array("y", y, shape=(outputs, samples))
    initial = np.zeros(states) if initial is None else require_array("initial", initial, shape=(states,))
    turn, spread = principal(model, m)
    turned = np.einsum("koi,ik->ko", turn, y)
    out, ratio = np.zeros((samples, states)), np.ones(samples)
    out[0] = initial
    limit, start = lower_limit(model, rows, m), model.initial_covariance.copy()
    data = step_data(model, rows, turn)
    _search_filter(data, limit, spread, np.ascontiguousarray(u.T), turned, start, out, ratio)
    require_finite_run("the estimate", out, "rescale the model or the record")
    return LineSearch(np.ascontiguousarray(out.T), ratio)


@pasted_kernel
def _noise(limit, spread, over):
    """Variance 1 - spread / lambda of an output for lambda = limit (1 + over), without cancellation close to the limit."""
    return ((limit - spread) / limit + over) / (1 + over)


@kernel
def _pose(sample, u, y, sight, told):
    # The penalty's rows and the outputs as measurements `told` of the last state and the disturbance.
    step, b, c, rows, rows_u = sample
    multiply(c, step, sight[len(rows) :])
    for i in range(len(rows)):
        copy_vector(rows[i], sight[i])
        told[i] = minus_row(0.0, rows_u, i, u)
    for o in range(len(c)):
        known = y[o]
        for q in range(len(b)):
            for j in range(len(u)):
                known -= c[o, q] * b[q, j] * u[j]
        told[len(rows) + o] = known


@kernel
def _cost(logarithm, limit, spread, sight, told, p0, x):
    # G(lambda): the sum of squared innovations, each over its variance, is the minimum of the cost.
    over, size, rows = np.exp(logarithm), sight.shape[1], len(told) - len(spread)
    sigma, z, v = joint_covariance(p0, size - len(x)), np.zeros(size), np.zeros(size)
    copy_vector(x, z)
    cost = 0.0
    for i in range(len(told)):
        noise = 1 / (limit * (1 + over)) if i < rows else _noise(limit, spread[i - rows], over)
        s = measure(sigma, sight, i, noise, v)
        innovation = minus_row(told[i], sight, i, z)
        for j in range(size):
            z[j] += v[j] / s * innovation
        condition(sigma, v, s)
        cost += innovation * innovation / s
    return cost


@kernel
def _search_filter(data, limit, spread, u, y, p0, out, ratio):
    (samples, n), nu, no = out.shape, u.shape[1], y.shape[1]
    forward, onward, gain = np.zeros((n, n)), np.zeros((n, nu)), np.zeros((n, no))
    p, noise, innovation = np.zeros((n, n)), np.ones(no), np.empty(no)
    measurements = data[3].shape[1] + no
    sight, told = np.empty((measurements, data[0].shape[2])), np.empty(measurements)
    shrink = (np.sqrt(5.0) - 1) / 2
    for k in range(1, samples):
        sample, penalty = sample_at(data, k), 0.0
        noise[:] = 1.0
        if limit[k] > 0:
            _pose(sample, u[k - 1], y[k], sight, told)
            posed = (limit[k], spread[k], sight, told, p0, out[k - 1])
            low, high = -18.0, 40.0  # of log(lambda / limit - 1); G has one minimum
            left, right = high - shrink * (high - low), low + shrink * (high - low)
            at_left, at_right = _cost(left, *posed), _cost(right, *posed)
            while high - low > 1e-7:
                if at_left <= at_right:
                    high, right, at_right = right, left, at_left
                    left = high - shrink * (high - low)
                    at_left = _cost(left, *posed)
                else:
                    low, left, at_left = left, right, at_right
                    right = low + shrink * (high - low)
                    at_right = _cost(right, *posed)
            over = np.exp((low + high) / 2)
            ratio[k] = 1 + over
            penalty = limit[k] * (1 + over)
            for o in range(no):
                noise[o] = _noise(limit[k], spread[k, o], over)
        robust_step(sample, penalty, noise, p0, forward, onward, gain, p)
        set_product(forward, out[k - 1], out[k])
        add_product(onward, u[k - 1], out[k])
        for o in range(no):
            innovation[o] = minus_row(y[k, o], sample[2], o, out[k])
        add_product(gain, innovation, out[k])
        p0, p = p, p0
