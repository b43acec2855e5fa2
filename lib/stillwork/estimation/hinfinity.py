"""H-infinity filter in discrete time: bounds the energy gain from noise to the estimation error."""

from collections.abc import Callable
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.algebra import add_square, condition, congruence, copy_matrix, measure, take_in_turn
from stillwork.base.bounds import Positive, within
from stillwork.base.checks import InputError, require_array
from stillwork.base.kernels import kernel
from stillwork.base.validation import checked
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel


@checked(missing=True)
def hinfinity_gains(model: TimeVaryingModel, wanted: ArrayLike, level: Positive) -> FilterGains:
    r"""A-posteriori H-infinity filter of z = L x (Hassibi, Sayed and Kailath, 1999, ch. 4).

    It is the Kalman filter on a covariance that every step inflates to :math:`(P^{-1}-\gamma^{-2}L^TL)^{-1}`. L,
    `wanted`, is in units in which all errors count alike; the level :math:`\gamma` bounds the ratio of error energy
    to noise energy, both in units of their deviations. Where no filter keeps it, the error names the sample.
    """
    wanted = require_array("wanted", wanted, shape=(None, model.a.shape[1]))
    gains, failed = _design(model, wanted, level)
    if failed:
        raise InputError(f"no filter keeps level {level:.3g} beyond sample {failed}; give a larger level")
    return gains


@checked
def smallest_level(
    model: TimeVaryingModel, wanted: ArrayLike, tolerance: Annotated[float, within(at_least=1e-12)] = 1e-3
) -> float:
    """Smallest level for which `hinfinity_gains` exists, from above, by bisection to a relative tolerance."""
    wanted = require_array("wanted", wanted, shape=(None, model.a.shape[1]))
    square = np.linalg.norm(wanted @ model.initial_covariance @ wanted.T, 2) if len(wanted) else 0.0
    if not 0 < square < np.inf:
        raise InputError(
            "wanted is zero, or its square is; every level is kept: give what is to be estimated"
        )
    attempt = _attempts(model)
    high = np.sqrt(square)
    for _ in range(200):
        if not attempt(wanted / high):
            break
        high *= 2
    else:
        raise InputError("wanted cannot be estimated at any level; is the model detectable?")
    low = high
    while not attempt(wanted / low):
        high, low = low, low / 2
    while high / low > 1 + tolerance:
        middle = np.sqrt(low * high)
        if attempt(wanted / middle):
            low = middle
        else:
            high = middle
    return float(high)


def _design(model: TimeVaryingModel, wanted: np.ndarray, level: float) -> tuple[FilterGains, int]:
    samples, outputs, states = model.c.shape
    gain = np.zeros((samples, states, outputs))
    covariance = np.zeros((samples, states, states))
    failed = _attempts(model, gain, covariance)(wanted / level)
    whiten = np.linalg.inv(np.linalg.cholesky(model.sensor))
    gains = FilterGains(model.a, model.b, gain @ whiten, np.ascontiguousarray(model.c), covariance)
    return gains, failed


def _attempts(model, gain: np.ndarray | None = None, covariance: np.ndarray | None = None) -> Callable:
    """A function that fills gains and covariances for `wanted` at a level and returns the sample at which no filter keeps it; 0 for none."""
    samples, outputs, states = model.c.shape
    gain = np.zeros((samples, states, outputs)) if gain is None else gain
    covariance = np.zeros((samples, states, states)) if covariance is None else covariance
    covariance[0] = model.initial_covariance
    whiten = np.linalg.inv(np.linalg.cholesky(model.sensor))
    g, c = model.g @ np.linalg.cholesky(model.process), whiten @ model.c
    a, g, c = (np.ascontiguousarray(each) for each in (model.a, g, c))

    def attempt(wanted):
        return _riccati(a, g, c, np.ascontiguousarray(wanted), gain, covariance)

    return attempt


@kernel
def _riccati(a, g, c, wanted, gain, covariance):
    n = a.shape[1]
    p, half, v, noise = covariance[0].copy(), np.empty((n, n)), np.empty(n), np.ones(c.shape[1])
    for k in range(1, len(a) + 1):
        # A negative measurement of `wanted`: certainty is reduced where errors matter most. The last one
        # changes no gain, but decides whether the level is kept at the last sample as well.
        for o in range(len(wanted)):
            variance = measure(p, wanted, o, -1.0, v)
            if not variance < 0:
                return k
            condition(p, v, variance)
        if k == len(a):
            break
        congruence(a[k], p, half, p)
        add_square(g[k], p)
        take_in_turn(p, c[k], noise, gain[k], v)
        copy_matrix(p, covariance[k])
    return 0
