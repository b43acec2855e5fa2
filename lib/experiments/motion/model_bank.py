"""Multiple-model estimation: a bank of Kalman filters, weighed by how well each predicts the measurement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array
from stillwork.estimation.robust import kalman_gains
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel, estimate


@dataclass(frozen=True)
class BankEstimate:
    """Estimates of a bank and its beliefs."""

    states: Float64[np.ndarray, "runs states samples"]
    weights: Float64[np.ndarray, "models runs samples"]  # posterior probability of each model


def bank_estimate(models: Sequence[TimeVaryingModel], u: ArrayLike, y: ArrayLike) -> BankEstimate:
    """Mean over the models, each with its posterior probability (static multiple-model estimation, Magill 1965)."""
    if not models:
        raise InputError("models is empty; give at least one")
    y, u = require_array("y", y, ndim=3), require_array("u", u, ndim=3)
    states, scores = [], []
    for model in models:
        gains = kalman_gains(model)
        x = estimate(gains, u, y)
        states.append(x)
        scores.append(np.cumsum(log_likelihood(model, gains, u, y, x), axis=1))
    scores = np.array(scores)
    weights = np.exp(scores - scores.max(axis=0))
    weights /= weights.sum(axis=0)
    return BankEstimate(np.einsum("mrk,mrnk->rnk", weights, np.array(states)), weights)


def log_likelihood(
    model: TimeVaryingModel,
    gains: FilterGains,
    u: Float64[np.ndarray, "runs inputs samples"],
    y: Float64[np.ndarray, "runs outputs samples"],
    states: Float64[np.ndarray, "runs states samples"],
) -> Float64[np.ndarray, "runs samples"]:
    """Logarithm of the density of every measurement given those before it; 0 at the first sample."""
    predicted = np.einsum("kij,rjk->rik", gains.forward[1:], states[:, :, :-1])
    predicted += np.einsum("kij,rjk->rik", gains.inputs[1:], u[:, :, :-1])
    innovation = y[:, :, 1:] - np.einsum("koi,rik->rok", gains.outputs[1:], predicted)
    along, driven, seen = model.a[1:], model.g[1:], model.c[1:]
    before = along @ gains.covariance[:-1] @ np.swapaxes(along, 1, 2)
    before += driven @ model.process @ np.swapaxes(driven, 1, 2)
    root = np.linalg.cholesky(seen @ before @ np.swapaxes(seen, 1, 2) + model.sensor)
    white = np.linalg.solve(root[None], np.moveaxis(innovation, 2, 1)[..., None])[..., 0]
    logs = np.log(np.einsum("kii->ki", root)).sum(axis=1)
    out = np.zeros((len(y), y.shape[2]))
    out[:, 1:] = -0.5 * np.sum(white**2, axis=2) - logs - 0.5 * y.shape[1] * np.log(2 * np.pi)
    return out
