"""Exact zero-order-hold discretisation, of modes in closed form and of any state-space model."""

import numpy as np
from scipy import linalg

from stillwork.checks import InputError, require_number
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


def zoh_modes(model: ModalModel, step: float) -> StateModel:
    """Exact zero-order-hold discretisation in closed form, mode by mode, in modal form 1.

    The transition matrix is (2.29) of the observer thesis taken to the modal states; the input matrix keeps
    the damping that (2.33) leaves out.
    """
    require_number("step", step, above=0.0)
    w, z = model.frequencies, model.damping
    s = np.sqrt(1 - z**2)
    angle, decay = w * s * step, np.exp(-z * w * step)
    ratio, cosine = z / s, np.cos(angle)
    # sin(wd T)/wd, with its limit T for a rigid body
    sinc = step * np.sinc(angle / np.pi)
    sine = np.sin(angle)
    blocks = np.empty((len(w), 2, 2))
    blocks[:, 0, 0] = decay * (cosine + ratio * sine)
    blocks[:, 0, 1] = decay * sinc
    blocks[:, 1, 0] = -decay * w**2 * sinc
    blocks[:, 1, 1] = decay * (cosine - ratio * sine)
    flexible = w > 0
    lifted = -np.expm1(-z * w * step) + decay * (2 * np.sin(angle / 2) ** 2 - ratio * sine)
    gains = np.empty((len(w), 2))
    gains[:, 0] = np.divide(lifted, w**2, out=np.full(len(w), step**2 / 2), where=flexible)
    gains[:, 1] = decay * sinc
    b = (gains[:, :, None] * model.input_shapes[:, None, :]).reshape(2 * len(w), -1)
    continuous = model.state_space()
    return StateModel(linalg.block_diag(*blocks), b, continuous.c, continuous.d, step)


def zoh(model: StateModel, step: float) -> StateModel:
    """Zero-order-hold discretisation by the exponential of the balanced [A B; 0 0]."""
    require_number("step", step, above=0.0)
    if model.step:
        raise InputError("model is in discrete time already; give the continuous model")
    n, m = model.b.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = model.a * step, model.b * step
    # Unbalanced, the exponential of a stiff motion system is silently wrong.
    balanced, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    held = linalg.expm(balanced) * scale[:, None] / scale
    return StateModel(held[:n, :n], held[:n, n:], model.c, model.d, step)
