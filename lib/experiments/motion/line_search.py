"""The regularised filter with the best lambda at every sample: the exact solution of the min-max problem (5.15)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.algebra import add_product, condition, copy_vector, measure
from stillwork.base.checks import require_array, require_finite_run
from stillwork.base.front_door import checked
from stillwork.base.kernels import kernel
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


@kernel
def _cost(logarithm, limit, spread, sample, p0, x, u, y):
    # G(lambda): the sum of squared innovations, each over its variance, is the minimum of the cost.
    step, b, c, rows, rows_u = sample
    penalty = limit * (1 + np.exp(logarithm))
    n, size = step.shape
    sigma, z, v, row = joint_covariance(p0, size - n), np.zeros(size), np.zeros(size), np.zeros((1, size))
    copy_vector(x, z)
    total_cost = 0.0
    for i in range(len(rows) + len(c)):
        if i < len(rows):
            innovation, noise = 0.0, 1 / penalty
            for j in range(size):
                row[0, j] = rows[i, j]
            for j in range(len(u)):
                innovation -= rows_u[i, j] * u[j]
        else:
            o = i - len(rows)
            innovation = y[o]
            # 1 - spread / penalty without cancellation close to the limit.
            noise = ((limit - spread[o]) / limit + np.exp(logarithm)) / (1 + np.exp(logarithm))
            for j in range(size):
                row[0, j] = 0.0
            for q in range(n):
                for j in range(size):
                    row[0, j] += c[o, q] * step[q, j]
                for j in range(len(u)):
                    innovation -= c[o, q] * b[q, j] * u[j]
        s = measure(sigma, row, 0, noise, v)
        for j in range(size):
            innovation -= row[0, j] * z[j]
        for j in range(size):
            z[j] += v[j] / s * innovation
        condition(sigma, v, s)
        total_cost += innovation * innovation / s
    return total_cost


@kernel
def _search_filter(data, limit, spread, u, y, p0, out, ratio):
    (samples, n), nu, no = out.shape, u.shape[1], y.shape[1]
    forward, onward, gain = np.zeros((n, n)), np.zeros((n, nu)), np.zeros((n, no))
    p, noise, innovation = np.zeros((n, n)), np.ones(no), np.empty(no)
    shrink = (np.sqrt(5.0) - 1) / 2
    for k in range(1, samples):
        sample, penalty = sample_at(data, k), 0.0
        for o in range(no):
            noise[o] = 1.0
        if limit[k] > 0:
            low, high = -18.0, 40.0  # of log(lambda / limit - 1); G has one minimum
            left, right = high - shrink * (high - low), low + shrink * (high - low)
            posed = (limit[k], spread[k], sample, p0, out[k - 1], u[k - 1], y[k])
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
                noise[o] = ((limit[k] - spread[k, o]) / limit[k] + over) / (1 + over)
        robust_step(sample, penalty, noise, p0, forward, onward, gain, p)
        add_product(forward, out[k - 1], out[k])
        add_product(onward, u[k - 1], out[k])
        for i in range(n):
            for j in range(n):
                p0[i, j] = p[i, j]
        _correct(out[k], gain, sample[2], y[k], innovation)


@kernel
def _correct(x, gain, c, y, innovation):
    for o in range(len(y)):
        innovation[o] = y[o]
        for i in range(len(x)):
            innovation[o] -= c[o, i] * x[i]
    add_product(gain, innovation, x)
