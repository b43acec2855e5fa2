"""Outputs of discrete models, sample by sample."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.algebra import add_product, copy_vector
from stillwork.base.checks import InputError, require_array, require_finite_run
from stillwork.base.kernels import kernel
from stillwork.base.validation import checked
from stillwork.lti.state_space import StateModel


@checked
def simulate(
    model: StateModel, inputs: ArrayLike, initial: ArrayLike | None = None
) -> Float64[np.ndarray, "outputs samples"]:
    """Outputs of a discrete model for given inputs, from an initial state (zero by default).

    The states are decoupled once, so that a sample costs two multiplications a state instead of a product
    of matrices; a model with ill-conditioned eigenvectors is stepped as it is.

    Parameters
    ----------
    model : StateModel
        In discrete time.
    inputs : array_like, shape (inputs, samples), of one input (samples,)
    initial : array_like, shape (states,), optional

    Returns
    -------
    ndarray, shape (outputs, samples)

    Raises
    ------
    InputError
        When the model is in continuous time, or its outputs overflow; the message names the sample.

    Examples
    --------
    >>> lag = lti.zoh(lti.StateModel([[-100.0]], [[100.0]], [[1.0]], [[0.0]]), sample_time=0.01)
    >>> lti.simulate(lag, np.ones((1, 4))).round(3)
    array([[0.   , 0.632, 0.865, 0.95 ]])
    """
    if not model.sample_time:
        raise InputError("model is in continuous time; discretise it with zoh first")
    inputs = [inputs] if np.ndim(inputs) == 1 else inputs
    inputs = require_array("inputs", inputs, shape=(model.b.shape[1], None))
    initial = np.zeros(len(model.a)) if initial is None else initial
    initial = require_array("initial", initial, shape=(len(model.a),))
    outputs = model.d @ inputs
    if len(model.a):
        outputs = outputs + _moved(model, inputs, initial)
    require_finite_run("the output", outputs, "the model is unstable, or the input too large", axis=1)
    return outputs


def _moved(model: StateModel, inputs: np.ndarray, initial: np.ndarray) -> np.ndarray:
    """What the states add to the outputs."""
    scale, a, _, _ = model._decomposed
    if model._residues[1] is None:
        driven = np.ascontiguousarray((model.b / scale[:, None] @ inputs).T)
        return _step_dense(a, driven, model.c * scale, initial / scale)
    left, parts = model._recursion
    start = left @ initial
    halves = [np.ascontiguousarray(half) for half in (start.real, start.imag)]
    return _step_decoupled(*parts, *halves, np.ascontiguousarray(inputs.T))


@kernel
def _step_dense(a, driven, c, start):
    samples = len(driven)
    y = np.zeros((len(c), samples))
    x, following = start.copy(), np.empty(len(a))
    for k in range(samples):
        add_product(c, x, y[:, k])
        copy_vector(driven[k], following)
        add_product(a, x, following)
        copy_vector(following, x)
    return y


@kernel
def _step_decoupled(pole_re, pole_im, drive_re, drive_im, read_re, read_im, start_re, start_im, u):
    n, samples, inputs, outputs = pole_re.shape[0], u.shape[0], u.shape[1], read_re.shape[0]
    y = np.zeros((outputs, samples))
    re, im = start_re.copy(), start_im.copy()
    for k in range(samples):
        for o in range(outputs):
            # Four sums side by side: one alone would wait for each of its additions.
            even_re, even_im, odd_re, odd_im = 0.0, 0.0, 0.0, 0.0
            for i in range(0, n - 1, 2):
                even_re += read_re[o, i] * re[i]
                even_im += read_im[o, i] * im[i]
                odd_re += read_re[o, i + 1] * re[i + 1]
                odd_im += read_im[o, i + 1] * im[i + 1]
            if n % 2:
                even_re += read_re[o, n - 1] * re[n - 1]
                even_im += read_im[o, n - 1] * im[n - 1]
            y[o, k] = (even_re + odd_re) - (even_im + odd_im)
        for i in range(n):
            next_re = pole_re[i] * re[i] - pole_im[i] * im[i]
            im[i] = pole_re[i] * im[i] + pole_im[i] * re[i]
            re[i] = next_re
        for j in range(inputs):
            force = u[k, j]
            for i in range(n):
                re[i] += drive_re[j, i] * force
                im[i] += drive_im[j, i] * force
    return y
