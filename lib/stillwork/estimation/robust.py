r"""Robust filters with control input: regularised least squares (5.21) and sensitivity penalisation (5.25).

Both minimise, over the last state x and the disturbance w, one cost (with :math:`\|x\|^2_W = x^T W x`)

.. math:: \|x - \hat x\|^2_{P^{-1}} + \|w\|^2_{Q^{-1}} + \lambda\|S x + T w + M u\|^2
          + \|y - C(Ax + Bu + Gw)\|^2_{\hat R^{-1}}

and step on with :math:`A\hat x + Bu + G\hat w`. They are thus Kalman filters with one more measurement,
:math:`0 = Sx + Tw + Mu` with covariance :math:`I/\lambda`; that is how they are computed here, row by row and
without the inverse covariances of the printed equations.
"""

from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np
from jaxtyping import Float64

from stillwork.base.algebra import (
    add_scaled,
    condition,
    congruence,
    copy_matrix,
    measure,
    multiply,
    plus_column,
    plus_row,
    take_in_turn,
)
from stillwork.base.bounds import within
from stillwork.base.checks import InputError, require_array, require_finite_run
from stillwork.base.kernels import inlined_kernel, kernel, pasted_kernel
from stillwork.base.validation import by_value, check_fields, checked, made
from stillwork.estimation.time_varying import RESCALE, FilterGains, TimeVaryingModel, require_per_sample


@by_value
@dataclass(frozen=True)
class NormBound:
    r"""Norm-bounded errors :math:`[\delta(C_kA)\;\delta(C_kB)\;\delta(C_kG)] = M_k\Delta[E_A\;E_B\;E_G]`, |Δ| ≤ 1.

    Every array has the samples first; without that axis it stands for all of them.
    """

    m: Float64[np.ndarray, "..."]  # (samples, outputs, directions), m
    e_a: Float64[np.ndarray, "..."]  # (samples, rows, states)
    e_b: Float64[np.ndarray, "..."]  # (samples, rows, inputs)
    e_g: Float64[np.ndarray, "..."]  # (samples, rows, disturbances)

    def __post_init__(self):
        check_fields(self)


@by_value
@dataclass(frozen=True)
class Derivatives:
    """Derivatives of A, B, G and C by every uncertain parameter, (5.22) and after."""

    a: Float64[np.ndarray, "_ _ _"]  # (parameters, states, states)
    b: Float64[np.ndarray, "_ _ _"]  # (parameters, states, inputs)
    g: Float64[np.ndarray, "_ _ _"]  # (parameters, states, disturbances)
    c: Float64[np.ndarray, "_ _ _ _"]  # (samples, parameters, outputs, states)

    def __post_init__(self):
        check_fields(self)

    @checked
    def rows(self, model: TimeVaryingModel):
        """S, T and M of (5.24), with the rows of all parameters stacked: both kinds, all outputs."""
        samples, outputs, states = model.c.shape
        inputs, disturbances = model.b.shape[2], model.g.shape[2]
        a = require_array("derivatives.a", self.a, shape=(None, states, states))
        count = len(a)
        b = require_array("derivatives.b", self.b, shape=(count, states, inputs))
        g = require_array("derivatives.g", self.g, shape=(count, states, disturbances))
        c = require_array("derivatives.c", self.c, shape=(samples, count, outputs, states))
        stacks = []
        for nominal, derivative in ((model.a, a), (model.g, g), (model.b, b)):
            before = np.einsum("kon,pnm->kpom", model.c, derivative)
            after = np.einsum("kpon,knm->kpom", c, nominal)
            both = np.concatenate([before, after], axis=1)
            stacks.append(both.reshape(samples, 2 * count * outputs, -1))
        return tuple(stacks)


@checked(missing=True)
def kalman_gains(model: TimeVaryingModel) -> FilterGains:
    """Time-varying Kalman filter: the common limit of both robust filters."""
    samples, outputs, states = model.c.shape
    gain = np.empty((samples, states, outputs))
    covariance = np.empty((samples, states, states))
    gain[0], covariance[0] = 0.0, model.initial_covariance
    colour, whiten = np.linalg.cholesky(model.process), np.linalg.inv(np.linalg.cholesky(model.sensor))
    _kalman_kernel(states, outputs)(model.a, model.g, model.c, colour, whiten, gain, covariance)
    require_finite_run("the filter's gain", gain, RESCALE)
    if not np.isfinite(covariance[-1]).all():  # what overflows does not come back
        require_finite_run("the filter's covariance", covariance, RESCALE)
    # It shares the model's matrices: of a long record to copy them takes longer.
    return made(
        FilterGains, forward=model.a, inputs=model.b, gain=gain, outputs=model.c, covariance=covariance
    )


@checked(missing=True)
def sensitivity_gains(
    model: TimeVaryingModel,
    derivatives: Derivatives,
    weight: Annotated[float, within(above=0.0, at_most=1.0)],
) -> FilterGains:
    r"""Sensitivity-penalised filter (5.25).

    The weight :math:`\gamma` in (0, 1] is 1 for the Kalman filter, small values punish sensitivity. It weighs squares of
    sensitivities (m) against variances: the larger the sensitivities, the larger a weight acts already.
    """
    rows = derivatives.rows(model)
    penalty = np.full(model.samples, (1 - weight) / weight)
    return _penalised(model, rows, penalty, np.zeros((model.samples, model.c.shape[1], 0)))


@checked(missing=True)
def regularised_gains(model: TimeVaryingModel, bound: NormBound) -> FilterGains:
    r"""Robust regularised least-squares filter (5.21) with the rule of thumb :math:`\lambda = (1+\alpha)\lambda_l`, :math:`\alpha=1`.

    The rule does not see how large E is: with one output
    it halves R even for errors that vanish. Only the exact search, or no uncertainty, returns to the Kalman
    filter.
    """
    rows, m = bound_rows(model, bound)
    return _penalised(model, rows, 2 * lower_limit(model, rows, m), m)


@checked
def bound_rows(model: TimeVaryingModel, bound: NormBound):
    """S, T and M of a norm bound at every sample, as `Derivatives.rows` gives them, and its directions."""
    samples, outputs, states = model.c.shape

    def spread(name, shape):
        return require_per_sample(f"bound.{name}", getattr(bound, name), samples, shape)

    m = spread("m", (outputs, None))
    e_a = spread("e_a", (None, states))
    e_b = spread("e_b", (e_a.shape[1], model.b.shape[2]))
    e_g = spread("e_g", (e_a.shape[1], model.g.shape[2]))
    return (e_a, e_g, e_b), m


@checked
def principal(model: TimeVaryingModel, m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn the whitened measurement so that R_hat = R - M M' / lambda is diagonal: I - spread / lambda."""
    whiten = np.linalg.inv(np.linalg.cholesky(model.sensor))
    whitened = whiten @ m
    values, vectors = np.linalg.eigh(whitened @ np.swapaxes(whitened, 1, 2))
    return np.swapaxes(vectors, 1, 2) @ whiten, np.maximum(values, 0)


@checked
def lower_limit(model: TimeVaryingModel, rows: tuple[np.ndarray, ...], m: np.ndarray) -> np.ndarray:
    """lambda_l = |M' R^-1 M| at every sample; 0 where there is no uncertainty."""
    certain = np.ones(model.samples, bool)
    for row in rows:
        certain &= ~np.any(row, axis=(1, 2))
    return np.where(certain, 0.0, principal(model, m)[1].max(axis=1))


@checked
def step_data(
    model: TimeVaryingModel, rows: tuple[np.ndarray, ...], turn: np.ndarray
) -> tuple[np.ndarray, ...]:
    """[A G], B, C, [S T] and M of every sample as the step takes them: unit process noise, outputs turned."""
    rows_x, rows_w, rows_u = rows
    root = np.linalg.cholesky(model.process)
    step, joint = np.dstack([model.a, model.g @ root]), np.dstack([rows_x, rows_w @ root])
    return tuple(np.ascontiguousarray(each) for each in (step, model.b, turn @ model.c, joint, rows_u))


def _penalised(model: TimeVaryingModel, rows, penalty, m) -> FilterGains:
    samples, outputs, states = model.c.shape
    inputs = model.b.shape[2]
    turn, spread = principal(model, m)
    known = penalty[:, None] > 0
    noise = 1 - np.divide(spread, penalty[:, None], out=np.zeros_like(spread), where=known)
    if np.any(noise[1:] <= 0):
        raise InputError("lambda lies at or below its lower limit; give a larger margin")
    out = tuple(np.zeros((samples, states, k)) for k in (states, inputs, outputs, states))
    forward, onward, gain, covariance = out
    covariance[0] = model.initial_covariance
    _gains(step_data(model, rows, turn), penalty, noise, *out)
    return FilterGains(forward, onward, gain @ turn, model.c, covariance)


@cache
def _kalman_kernel(states: int, outputs: int):
    """The Kalman filter's recursion for numbers of states and outputs that are compiled in.

    Sums over the states have this fixed length and unroll. What runs beside them goes to `n`, the same number
    as a variable: a loop of known short length would unroll too, and leave nothing to vectorise.
    """

    @kernel
    def recursion(a, g, c, colour, whiten, gain, covariance):
        # One Riccati step a sample: predict, then take in the whitened outputs one after the other.
        samples, n = c.shape[0], c.shape[2]
        causes = g.shape[2]
        p, half, turned = covariance[0].copy(), np.empty((n, n)), np.empty((n, n))
        driven, white, share = np.empty((causes, n)), np.empty((outputs, n)), np.empty((outputs, n))
        v = np.empty(n)
        for k in range(1, samples):
            for q in range(causes):
                for i in range(n):
                    driven[q, i] = 0.0
                    for m in range(q, causes):
                        driven[q, i] += g[k, i, m] * colour[m, q]
            for o in range(outputs):
                for i in range(n):
                    white[o, i] = 0.0
                for m in range(o + 1):
                    for i in range(n):
                        white[o, i] += whiten[o, m] * c[k, m, i]
            for i in range(n):
                for j in range(n):
                    turned[j, i] = a[k, i, j]
                for j in range(n):
                    total = 0.0
                    for q in range(states):
                        total += a[k, i, q] * p[q, j]
                    half[i, j] = total
            for i in range(n):
                for j in range(n):
                    total = 0.0
                    for q in range(states):
                        total += half[i, q] * turned[q, j]
                    p[i, j] = total
                for q in range(causes):
                    for j in range(n):
                        p[i, j] += driven[q, i] * driven[q, j]
            for i in range(n):
                for j in range(i):
                    p[j, i] = p[i, j]
            for o in range(outputs):
                for i in range(n):
                    total = 0.0
                    for q in range(states):
                        total += white[o, q] * p[q, i]
                    v[i] = total
                s = 1.0
                for i in range(n):
                    s += v[i] * white[o, i]
                for i in range(n):
                    share[o, i] = v[i] / s
                for j in range(o):
                    total = 0.0
                    for i in range(n):
                        total += white[o, i] * share[j, i]
                    for i in range(n):
                        share[j, i] -= share[o, i] * total
                for i in range(n):
                    for j in range(n):
                        p[i, j] -= share[o, i] * v[j]
            for i in range(n):
                for o in range(outputs):
                    total = 0.0
                    for m in range(o, outputs):
                        total += share[m, i] * whiten[m, o]
                    gain[k, i, o] = total
                for j in range(n):
                    covariance[k, i, j] = p[i, j]

    return recursion


@pasted_kernel
def _regularise(sigma, map_x, map_u, rows, rows_u, variance, v):
    # The penalty as measurements 0 = S x + T w + M u, one row after the other: z = map_x x_hat + map_u u.
    for i in range(rows.shape[0]):
        s = measure(sigma, rows, i, variance, v)
        condition(sigma, v, s)
        for p in range(len(v)):
            v[p] /= s
        for q in range(map_x.shape[1]):
            seen = plus_column(0.0, map_x, q, rows[i])
            add_scaled(-seen, v, map_x[:, q])
        for q in range(map_u.shape[1]):
            seen = plus_column(rows_u[i, q], map_u, q, rows[i])
            add_scaled(-seen, v, map_u[:, q])


@inlined_kernel
def sample_at(data, k):
    """Of `step_data`, what belongs to sample k."""
    step, b, c, rows, rows_u = data
    return step[k], b[k], c[k], rows[k], rows_u[k]


@kernel
def joint_covariance(p0, causes):
    """Of the last state and the disturbance, which has unit covariance here."""
    n = len(p0)
    sigma = np.eye(n + causes)
    copy_matrix(p0, sigma)
    return sigma


@kernel
def robust_step(sample, penalty, noise, p0, forward, onward, gain, p):
    """One sample: matrices and covariance `p` of the filter from the last covariance `p0`."""
    step, b, c, rows, rows_u = sample
    (n, size), nu = step.shape, b.shape[1]
    sigma, map_x, map_u = joint_covariance(p0, size - n), np.zeros((size, n)), np.zeros((size, nu))
    for i in range(n):
        map_x[i, i] = 1.0
    if penalty > 0:
        _regularise(sigma, map_x, map_u, rows, rows_u, 1 / penalty, np.empty(size))
    multiply(step, map_x, forward)
    for i in range(n):
        for j in range(nu):
            onward[i, j] = plus_row(b[i, j], step, i, map_u[:, j])
    congruence(step, sigma, np.empty((n, size)), p)
    take_in_turn(p, c, noise, gain, np.empty(n))


@kernel
def _gains(data, penalty, noise, forward, onward, gain, covariance):
    for k in range(1, len(forward)):
        p0, p = covariance[k - 1], covariance[k]
        robust_step(sample_at(data, k), penalty[k], noise[k], p0, forward[k], onward[k], gain[k], p)
