"""Kalman filters for people's own models: any number of states, inputs and outputs.

The model functions are plain Python in a file of the user's. They are compiled to C callbacks on first use and
cached beside that file; the filters' kernels take every such model, so nothing is compiled in a second process.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.checks import InputError, require_array, require_count, require_finite_run
from stillwork.base.front_door import check_fields, checked
from stillwork.base.kernels import callback
from stillwork.estimation.gaussian import BLOCKS, COVARIANCE, ESTIMATE, MEANS, require_covariance
from stillwork.estimation.nonlinear_kernels import model_record
from stillwork.estimation.unscented import SigmaPoints

SIGNATURE = "void(float64[::1], float64[::1], float64[::1], float64[::1])"


@dataclass(frozen=True)
class NonlinearModel:
    """x_k = transition(x_{k-1}, u_{k-1}) + w, z_k = measurement(x_k, u_{k-1}) + v: (9)."""

    transition: Callable  # ``transition(state, inputs, parameters, out)`` fills `out` with the next state
    # ``measurement(state, inputs, parameters, out)`` fills `out` with the expected measurement
    measurement: Callable
    states: int  # how many
    inputs: int
    outputs: int
    parameters: ArrayLike = ()  # passed to both; changing them recompiles nothing

    @checked
    def __post_init__(self):
        check_fields(self)
        require_count("states", self.states)
        require_count("inputs", self.inputs, at_least=0)
        require_count("outputs", self.outputs)
        object.__setattr__(self, "parameters", require_array("parameters", self.parameters, ndim=1))
        for name, size in (("transition", self.states), ("measurement", self.outputs)):
            out = np.full(size, np.nan)
            try:
                getattr(self, name)(np.full(self.states, 0.1), np.zeros(self.inputs), self.parameters, out)
            except Exception as error:  # a reader's function may raise anything
                raise InputError(
                    f"{name} fails on {self.states} states, {self.inputs} inputs and {self.outputs} outputs "
                    f"({error}); give it (state, inputs, parameters, out)"
                ) from None
            if np.isnan(out).any():
                raise InputError(f"{name} leaves out[{int(np.isnan(out).argmax())}] unset; fill all {size}")


@dataclass(frozen=True)
class StateEstimate:
    """States after each measurement, and their covariances."""

    mean: Float64[np.ndarray, "states samples"]
    covariance: Float64[np.ndarray, "samples states states"]


@checked
def unscented_filter(
    model: NonlinearModel,
    measurements: ArrayLike,
    inputs: ArrayLike | None = None,
    *,
    process: ArrayLike,
    noise: ArrayLike,
    initial_mean: ArrayLike,
    initial_covariance: ArrayLike,
    points: SigmaPoints | None = None,
) -> StateEstimate:
    """Unscented Kalman filter (12)-(17), points redrawn around the *predicted* mean, over a record.

    Parameters
    ----------
    model : NonlinearModel
        Own model.
    measurements : array_like, shape (outputs, samples)
        z; where one of its outputs is NaN the measurement is missing, and the sample is predicted.
    inputs : array_like, shape (inputs, samples), optional
        ``inputs[:, k]`` acts on the way to sample k; zero without.
    process, noise : array_like, shape (n, n) or (n,)
        Q and R, or their diagonals.
    initial_mean, initial_covariance : array_like, shapes (states,) and (states, states) or (states,)
        Before the first prediction.
    points : SigmaPoints, optional
        Scaling; alpha = 1, beta = 0, kappa = 0 without, which loses no digits.

    Raises
    ------
    InputError
        When a covariance is not positive definite, at the start or on the way.
    """
    points = SigmaPoints(alpha=1.0, beta=0.0) if points is None else points
    prepared = _prepare(model, measurements, inputs, process, noise, initial_mean, initial_covariance)
    return _run(True, model, prepared, points.weights(model.states))


@checked
def extended_filter(
    model: NonlinearModel,
    measurements: ArrayLike,
    inputs: ArrayLike | None = None,
    *,
    process: ArrayLike,
    noise: ArrayLike,
    initial_mean: ArrayLike,
    initial_covariance: ArrayLike,
) -> StateEstimate:
    """Extended Kalman filter over a record; arguments as in `unscented_filter`.

    Jacobians come from central differences (relative error about 1e-12, felt by the gain alone).
    """
    prepared = _prepare(model, measurements, inputs, process, noise, initial_mean, initial_covariance)
    return _run(False, model, prepared, np.zeros(4))


def _prepare(model, measurements, inputs, process, noise, mean, covariance):
    measurements = require_array("measurements", measurements, shape=(model.outputs, None), missing=True)
    samples = measurements.shape[1]
    if inputs is None:
        inputs = np.zeros((model.inputs, samples))
    inputs = require_array("inputs", inputs, shape=(model.inputs, samples))
    width = max(model.states, model.outputs)
    work = np.zeros((BLOCKS, max(2 * width + 1, 5), width))
    work[MEANS, ESTIMATE, : model.states] = require_array("initial_mean", mean, shape=(model.states,))
    work[COVARIANCE, : model.states, : model.states] = require_covariance(
        "initial_covariance", covariance, model.states
    )
    process = require_covariance("process", process, model.states, definite=False)
    noise = require_covariance("noise", noise, model.outputs)
    return np.ascontiguousarray(measurements.T), np.ascontiguousarray(inputs.T), process, noise, work


def _run(unscented, model, prepared, weights):
    samples, n = len(prepared[0]), model.states
    means, covariances = np.empty((samples, n)), np.empty((samples, n, n))
    functions = callback(model.transition, SIGNATURE), callback(model.measurement, SIGNATURE)
    done = model_record(unscented, *functions, model.parameters, *prepared, weights, means, covariances)
    if done < samples:
        raise InputError(
            f"the covariance stops being positive definite at sample {done}; raise process or noise"
        )
    for name, values in (("mean", means), ("covariance", covariances)):
        require_finite_run(f"the {name}", values, "check the model's functions and the size of the record")
    return StateEstimate(np.ascontiguousarray(means.T), covariances)
