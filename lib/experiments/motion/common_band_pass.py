"""One band-pass for all damped modes (Remark 4.3.2), and what a dynamic gain comes to."""

import numpy as np
from jaxtyping import Float64
from scipy import linalg

from experiments.motion.decoupled_damping import fed_back_states
from stillwork.base.checks import InputError
from stillwork.base.front_door import checked
from stillwork.control.feedback import band_pass
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


def common_centre(model: ModalModel, gain: Float64[np.ndarray, "inputs states"]) -> float:
    """Centre of a band-pass for all damped modes, rad/s: the geometric mean of the first and the last.

    Remark 4.3.2, whose index of the last mode is read as that of the last damped flexible mode.
    """
    damped = model.frequencies[[j // 2 for j in fed_back_states(model, gain)]]
    return float(np.sqrt(damped.min() * damped.max()))


def half_power_selectivity(model: ModalModel, gain: Float64[np.ndarray, "inputs states"]) -> float:
    """Q that puts the half-power points of the common band-pass on the first and the last damped mode."""
    damped = model.frequencies[[j // 2 for j in fed_back_states(model, gain)]]
    if damped.min() == damped.max():
        raise InputError("gain feeds back one mode only; its own band-pass serves it")
    return float(common_centre(model, gain) / (damped.max() - damped.min()))


@checked
def common_band_passed(
    model: ModalModel, gain: Float64[np.ndarray, "inputs states"], selectivity: float
) -> StateModel:
    """Dynamic gain K(s) with one band-pass for all damped modes (Remark 4.3.2).

    The gains make up for the magnitude of the filter at each resonance, not for its phase. One filter an
    actuator or one a fed-back state, whichever is fewer: a single filter serves a gain of rank one only.
    """
    fed = fed_back_states(model, gain)
    centre = common_centre(model, gain)
    one = band_pass(centre, selectivity)
    magnitude = np.abs(one.frequency_response(model.frequencies[[j // 2 for j in fed]])[0, 0])
    mended = gain.copy()
    mended[:, fed] /= magnitude
    on_states = len(fed) <= len(gain)
    a, b, c = (np.kron(np.eye(len(fed) if on_states else len(gain)), getattr(one, name)) for name in "abc")
    if on_states:
        b, c = b @ np.eye(gain.shape[1])[fed], mended[:, fed] @ c
    else:
        b = b @ mended
    return StateModel(a, b, c, np.zeros_like(gain))


def minimal_order(gain: StateModel) -> int:
    """Order of a minimal realisation of a stable model, by the rank of its Hankel operator."""
    if gain.step or not gain.is_stable:
        raise InputError("gain must be stable and in continuous time; its order is counted by Gramians")
    rate = np.abs(gain.poles).max()
    a = gain.a / rate
    # Of unit size: the rank is judged against rounding.
    b, c = (matrix / np.linalg.norm(matrix) for matrix in (gain.b, gain.c))
    reach = linalg.solve_continuous_lyapunov(a, -b @ b.T)
    seen = linalg.solve_continuous_lyapunov(a.T, -c.T @ c)
    hankel = np.sqrt(np.maximum(linalg.eigvals(reach @ seen).real, 0))
    return int(np.count_nonzero(hankel > 1e-6 * hankel.max()))
