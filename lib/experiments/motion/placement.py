"""General pole placement in z beside the closed form of the discrete damping gain (Remark 4.1.1)."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import InputError, require_array, require_choice, require_count, require_number
from stillwork.control.discrete_damping import damped_poles, discrete_damping_gain
from stillwork.control.feedback import place
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.modal import ModalModel

Z_METHODS = ("Ackermann", "robust")


def gain_by_placement(
    model: ModalModel, increase: float | ArrayLike, step: float, method: str
) -> Float64[np.ndarray, "1 states"]:
    """The gain of (4.3) by a general pole-placement method in z, for comparison: it loses digits at high rates."""
    require_choice("method", method, Z_METHODS)
    upper = np.exp(damped_poles(model, increase) * step)
    wanted = np.concatenate([upper, upper.conj()])
    rigid = model.rigid_modes
    sampled = zoh_modes(model.modes(slice(rigid, None)), step)
    gain = np.zeros((1, 2 * len(model.frequencies)))
    if method == "Ackermann":
        gain[:, 2 * rigid :] = place(sampled, wanted)
        return gain
    from scipy.signal import place_poles

    try:
        gain[:, 2 * rigid :] = -place_poles(sampled.a, sampled.b, wanted).gain_matrix
    except ValueError as error:
        raise InputError(f"model: its poles cannot be placed ({error}); lower the sampling rate") from None
    return gain


def placement_error(model: ModalModel, gain: ArrayLike, increase: float | ArrayLike, step: float) -> float:
    """Largest distance of a pole of A + BK from the wanted one, relative to the distance it had to move."""
    rigid = model.rigid_modes
    gain = require_array("gain", gain, shape=(1, 2 * len(model.frequencies)))
    flexible = model.modes(slice(rigid, None))
    sampled = zoh_modes(flexible, step)
    poles = linalg.eigvals(sampled.a + sampled.b @ gain[:, 2 * rigid :])
    wanted, before = (
        np.exp(p * step) for p in (damped_poles(model, increase), flexible.poles[: len(flexible.frequencies)])
    )
    return float((np.abs(poles[:, None] - wanted).min(axis=0) / np.abs(before - wanted)).max())


def typical_placement_error(
    model: ModalModel,
    increase: float | ArrayLike,
    step: float,
    method: str,
    machines: int = 21,
    spread: float = 0.01,
) -> float:
    """Median of `placement_error` over machines that differ by a little: the size of rounding without its luck.

    What rounding leaves on one machine is a draw: the next one, or the same one on another processor, gives ten times
    as much or as little. The median over 21 of them, with frequencies within `spread` of those of `model`, moved by a
    factor below 2 between processors. NaN where the method takes most of the machines for uncontrollable.
    """
    require_choice("method", method, ("closed form", *Z_METHODS))
    require_number("spread", spread, at_least=0.0, below=1.0)
    errors = []
    for shift in np.linspace(-spread, spread, require_count("machines", machines)):
        machine = replace(model, frequencies=(1 + shift) * model.frequencies)
        if method == "closed form":
            gain = discrete_damping_gain(machine, increase, step)
        else:
            try:
                gain = gain_by_placement(machine, increase, step, method)
            except InputError:
                errors.append(np.inf)
                continue
        errors.append(placement_error(machine, gain, increase, step))
    middle = float(np.median(errors))
    return middle if np.isfinite(middle) else np.nan
