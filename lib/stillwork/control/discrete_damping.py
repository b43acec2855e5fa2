"""Active damping in discrete time: gains by pole placement, (4.2) and (4.3)."""

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import checked
from stillwork.control.feedback import DampedModes, damped_modes, per_flexible_mode, require_reach
from stillwork.lti.delays import delayed
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


@checked
def damped_poles(model: ModalModel, increase: float | ArrayLike) -> Complex128[np.ndarray, " flexible_modes"]:
    """Continuous upper poles of the flexible modes with `increase` added to each damping ratio, (3.33)."""
    increase = per_flexible_mode(model, "increase", increase)
    rigid = model.rigid_modes
    ratio = model.damping[rigid:] + increase
    if np.any(ratio <= 0) or np.any(ratio >= 1):
        raise InputError(
            f"increase leads to damping ratios from {ratio.min():.3g} to {ratio.max():.3g}; keep them between 0 and 1"
        )
    return model.frequencies[rigid:] * (-ratio + 1j * np.sqrt(1 - ratio**2))


@checked
def discrete_damping_gain(
    model: ModalModel, increase: float | ArrayLike, sample_time: Positive
) -> Float64[np.ndarray, "1 states"]:
    r"""Gain K of (4.3): :math:`\lambda(A^d + B^dK) = e^{p^*T_s}` with the damped continuous poles :math:`p^*`.

    With one input the gain is unique. It follows in closed form from the characteristic polynomial
    :math:`\prod_j(z-\lambda_j)(1 - \sum_i k_ib_i/(z-\lambda_i))` in modal coordinates. Written with
    :math:`\delta = (z-1)/T_s`, no difference of nearly equal poles remains, so that the numerical problem of
    Remark 4.1.1 does not arise at any sampling rate. The rigid body is unchanged.
    """
    if model.input_shapes.shape[1] != 1:
        raise InputError(f"model has {model.input_shapes.shape[1]} inputs; this formula is for one")
    wanted = damped_poles(model, increase)
    rigid = model.rigid_modes
    w, z, shapes = model.frequencies[rigid:], model.damping[rigid:], model.input_shapes[rigid:, 0]
    require_reach(model)
    if w[-1] * sample_time >= np.pi:
        raise InputError(
            f"sample_time is {sample_time:g} s, too long for a mode at {w[-1] / (2 * np.pi):.4g} Hz; sample more than twice per period"
        )
    if np.any(np.diff(w) < 1e-9 * w[-1]):
        raise InputError("model has two modes of one frequency; one input cannot damp both")
    upper = w * (-z + 1j * np.sqrt(1 - z**2))
    poles = np.concatenate([upper, upper.conj()])
    here, there = (
        np.expm1(p * sample_time) / sample_time for p in (poles, np.concatenate([wanted, wanted.conj()]))
    )
    drive = shapes * here[: len(w)] / upper  # left eigenvectors (-conj(p), 1) on B^d, over the sample time
    gain = np.zeros((1, 2 * len(model.frequencies)))
    for i, pole in enumerate(upper):
        others = np.delete(here, i)
        # Numerator and denominator factor by factor: their products alone would overflow for many modes.
        factors = (here[i] - np.delete(there, i)) / (here[i] - others)
        k = -(here[i] - there[i]) * np.prod(factors) / drive[i]
        place = 2 * (rigid + i)
        gain[0, place], gain[0, place + 1] = 2 * (-pole.conj() * k).real, 2 * k.real
    return gain


@checked
def sampled_feedback(model: ModalModel, gain: ArrayLike, sample_time: float, delay: int = 0) -> DampedModes:
    """Damping ratios and frequencies of the sampled machine with a gain, (4.2), for perfect estimates.

    The eigenvalues z are read as those of a continuous machine, ln(z)/T_s. The force is delayed by `delay` samples.
    """
    gain = require_array("gain", gain, shape=(model.input_shapes.shape[1], 2 * len(model.frequencies)))
    still = 2 * model.rigid_modes
    if np.any(gain[:, :still]):
        raise InputError("gain acts on the rigid body; set those columns to zero")
    flexible = zoh_modes(model.modes(slice(model.rigid_modes, None)), sample_time)
    n, inputs = flexible.b.shape
    read = StateModel(flexible.a, flexible.b, gain[:, still:], np.zeros((inputs, inputs)), sample_time)
    late = delayed(read, delay)
    poles = linalg.eigvals(late.a + late.b @ late.c)
    # A delayed force adds poles near z = 0, real or far beyond the modes: they belong to none.
    poles = np.log(poles[poles != 0].astype(complex)) / sample_time
    upper = poles[(poles.imag > 1e-6 * np.abs(poles)) & (poles.imag < (1 - 1e-9) * np.pi / sample_time)]
    upper = upper[np.argsort(np.abs(upper))][: n // 2]
    if len(upper) < n // 2:
        raise InputError("gain is so large that a mode no longer oscillates; it has no damping ratio below 1")
    return damped_modes(upper, model.rigid_modes)
