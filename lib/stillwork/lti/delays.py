"""Delays of discrete models: whole samples, and what a delay holds beside them."""

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Natural, NonNegative
from stillwork.base.checks import InputError, require_memory
from stillwork.base.validation import checked
from stillwork.lti.state_space import StateModel


@checked
def split_delay(samples: NonNegative) -> tuple[int, float]:
    """Whole samples of a delay and the part of one beside them; what is whole but for rounding counts as whole."""
    whole = int(np.floor(samples + 1e-9))
    return whole, max(samples - whole, 0.0) if samples - whole > 1e-9 else 0.0


@checked
def with_input_before(model: StateModel, before: Float64[np.ndarray, "states inputs"]) -> StateModel:
    """The model with the input of the sample before as a state: it drives the states by `before`, and acts in place of d's."""
    n, m = model.b.shape
    a = np.block([[model.a, before], [np.zeros((m, n + m))]])
    b, c = np.vstack([model.b, np.eye(m)]), np.hstack([model.c, model.d])
    return StateModel(a, b, c, np.zeros_like(model.d), model.sample_time)


@checked
def delayed(model: StateModel, samples: Natural) -> StateModel:
    """The model with every output late by a whole number of samples."""
    if not model.sample_time:
        raise InputError("model is in continuous time; discretise it first")
    if not samples:
        return model
    outputs, n = len(model.c), len(model.a)
    size = n + samples * outputs
    require_memory("samples", size, size)
    a, b = np.zeros((size, size)), np.zeros((size, model.b.shape[1]))
    a[:n, :n], b[:n] = model.a, model.b
    a[n : n + outputs, :n], b[n : n + outputs] = model.c, model.d
    a[n + outputs :, n:-outputs] = np.eye((samples - 1) * outputs)
    c = np.eye(outputs, size, k=size - outputs)
    return StateModel(a, b, c, np.zeros_like(model.d), model.sample_time)
