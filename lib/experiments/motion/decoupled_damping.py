"""Damping that leaves the decoupling alone: gains under constraints and dynamic gains (section 4.3.2)."""

from collections.abc import Collection

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg
from scipy.optimize import linear_sum_assignment

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.control.decoupling import WORST_CONDITION, Decoupling
from stillwork.control.feedback import band_pass, per_flexible_mode, stiffening
from stillwork.control.pid import series
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


@checked
def constrained_damping(
    model: ModalModel, increase: float | ArrayLike, undisturbed: Collection[int] | None = None
) -> Float64[np.ndarray, "inputs states"]:
    r"""Damping gain whose force on one mode leaves others alone: Lemma 4.3.3 and Corollary 4.3.1.

    For every damped mode j, :math:`\phi_{aj}^TK_{dj} = -2\zeta_{des,j}\omega_j` (the minus sign is missing in print)
    and :math:`\phi_{ai}^TK_{dj} = 0` for the `undisturbed` modes i other than j; with more actuators than
    constraints, the gain of least norm. A mode with increase 0 gets no feedback. By default as many of the first
    modes are undisturbed as the actuators can leave alone beside the damped one: one rigid-body mode less than all
    with minimal actuation, all of these with one more actuator, all other modes with total actuation.
    """
    increase = per_flexible_mode(model, "increase", increase)
    return _constrained(model, 2 * increase * model.frequencies[model.rigid_modes :], undisturbed, 1)


@checked
def constrained_stiffness(
    model: ModalModel, factor: float | ArrayLike, undisturbed: Collection[int] | None = None
) -> Float64[np.ndarray, "inputs states"]:
    """Gain of active stiffness, (3.42), under the constraints of `constrained_damping` (Remark 4.3.5).

    Parameters and errors as there, with a factor on each resonance frequency; 1 gives no feedback.
    """
    return _constrained(model, stiffening(model, factor), undisturbed, 0)


def _constrained(model: ModalModel, wanted: np.ndarray, undisturbed, state: int) -> np.ndarray:
    modes, actuators = model.input_shapes.shape
    rigid = model.rigid_modes
    chosen = range(modes) if undisturbed is None else undisturbed
    gain = np.zeros((actuators, 2 * modes))
    for j in (rigid + np.flatnonzero(wanted)).tolist():
        others = [i for i in range(modes) if i != j and i in chosen]
        if undisturbed is None:
            others = others[: actuators - 1]
        shapes = model.input_shapes[[*others, j]]
        if np.linalg.cond(shapes / np.linalg.norm(shapes, axis=1)[:, None]) > WORST_CONDITION:
            raise InputError(
                f"input_shapes: the actuators cannot move mode {j} without modes {others}; move an actuator "
                "or leave a mode out of undisturbed"
            )
        gain[:, 2 * j + state] = -np.linalg.pinv(shapes)[:, -1] * wanted[j - rigid]
    return gain


@checked
def band_passed(
    model: ModalModel, gain: Float64[np.ndarray, "inputs states"], selectivity: float, order: int = 2
) -> StateModel:
    r"""Dynamic gain K(s): each fed-back state through a band-pass at its mode's resonance, (4.16), (4.17).

    The gain acts on the modal states of form 1 of the first modes, on no rigid-body mode. The thesis uses Q = 2, and
    two band-passes in a row (order 4) for active stiffness, Remark 4.3.5.
    """
    fed = fed_back_states(gain)
    filters = [series([band_pass(float(model.frequencies[j // 2]), selectivity)] * (order // 2)) for j in fed]
    a, b, c = (linalg.block_diag(*(getattr(one, name) for one in filters)) for name in "abc")
    select = np.eye(gain.shape[1])[fed]
    return StateModel(a, b @ select, gain[:, fed] @ c, np.zeros_like(gain))


def fed_back_states(gain: np.ndarray) -> np.ndarray:
    """Indices of the states that the gain feeds back, of flexible modes only."""
    return np.flatnonzero(np.any(gain, axis=0))


def added_damping(
    plant: ModalModel, system: StateModel
) -> tuple[Float64[np.ndarray, " flexible"], Float64[np.ndarray, " flexible"]]:
    """Damping ratio that feedback adds to each flexible mode, and the shift of its frequency as a part of it.

    The poles of each mode are the ones nearest to where they were without feedback.

    Raises
    ------
    InputError
        Where a mode no longer oscillates.
    """
    upper = system.poles[system.poles.imag > 0]
    rigid = plant.rigid_modes
    before = plant.poles[rigid : len(plant.frequencies)]
    if len(upper) < len(before):
        raise InputError(
            "a damped mode no longer oscillates, so no damping ratio is added to it; lower the increase"
        )
    _, chosen = linear_sum_assignment(np.abs(upper[None, :] - before[:, None]))
    after = upper[chosen]
    return -after.real / np.abs(after) - plant.damping[rigid:], np.abs(after) / plant.frequencies[rigid:] - 1


@checked
def rigid_coupling(
    plant: ModalModel, gain: Float64[np.ndarray, "inputs states"], decoupling: Decoupling
) -> Float64[np.ndarray, "axes axes"]:
    r"""Factor of 1/s from u to q that a velocity feedback on the flexible modes adds: (4.15) for all modes.

    At rest a flexible mode follows u by :math:`\Theta_j/\omega_j^2`; its velocity, fed back, drives the
    rigid-body modes by :math:`\phi_{ai}^T K_{dj}`.
    """
    rigid = plant.rigid_modes
    velocities = gain[:, 2 * rigid + 1 :: 2]
    fed = slice(rigid, rigid + velocities.shape[1])
    static = plant.input_shapes[fed] @ decoupling.actuation / plant.frequencies[fed, None] ** 2
    return plant.input_shapes[:rigid] @ velocities @ static


@checked(infinite=True)
def coupling_onset(
    plant: ModalModel, gain: Float64[np.ndarray, "inputs states"], decoupling: Decoupling
) -> Float64[np.ndarray, "axes axes"]:
    r"""Frequency (rad/s) below which `rigid_coupling` exceeds the compliance of the undamped machine.

    The compliance is :math:`\sum_j\Psi_j\Theta_j/\omega_j^2` of (4.13), off the diagonal what is there without
    damping. The slope -1 shows below the onset only; symmetry brings it to 0.
    """
    coupling, both = np.abs(rigid_coupling(plant, gain, decoupling)), decoupling.apply(plant)
    flexible = slice(plant.rigid_modes, None)
    shapes = both.output_shapes[:, flexible], both.input_shapes[flexible]
    compliance = np.abs(shapes[0] / plant.frequencies[flexible] ** 2 @ shapes[1] + both.feedthrough)
    return np.divide(coupling, compliance, out=np.full_like(coupling, np.inf), where=compliance > 0)
