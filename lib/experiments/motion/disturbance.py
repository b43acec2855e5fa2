"""Cumulative spectra of the errors under white disturbances (section 3.5.1)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.control.loops import INPUTS, require_stable
from stillwork.lti.discretisation import zoh
from stillwork.lti.state_space import StateModel


class CumulativePower(NamedTuple):
    """Power of the errors below each frequency (m^2)."""

    omega: Float64[np.ndarray, " frequencies"]  # rad/s
    true: Float64[np.ndarray, " frequencies"]
    measured: Float64[np.ndarray, " frequencies"]


def cumulative_power(
    loop: StateModel, step: float, deviations: dict[str, float], omega: Float64[np.ndarray, " frequencies"]
) -> CumulativePower:
    """Cumulative power of true and measured error under independent white noise held over each sample.

    It comes from the discrete frequency responses, not from a simulated record, so it has no scatter. `deviations`
    are those of the inputs ``w``, ``v``, ``d`` (N and m): a standard deviation sigma has the one-sided density 2
    sigma^2 step. `omega` ascends to the Nyquist frequency at most and is fine at every resonance.
    """
    omega = require_array("omega", omega, ndim=1)
    if np.any(np.diff(omega) <= 0) or omega[-1] > np.pi / step * (1 + 1e-12):
        raise InputError(f"omega must ascend and end at the Nyquist frequency {np.pi / step:g} rad/s at most")
    for name in deviations:
        require_choice("deviations", name, ("w", "v", "d"))
        require_number(f"deviations[{name!r}]", deviations[name], at_least=0.0)
    require_stable(loop)
    places = [INPUTS.index(name) for name in deviations]
    response = zoh(loop.select(places, [0, 1]), step).frequency_response(omega)
    weights = 2 * step * np.array(list(deviations.values())) ** 2
    density = np.einsum("oif,i->of", np.abs(response) ** 2, weights)  # m^2/Hz
    pieces = (density[:, 1:] + density[:, :-1]) / 2 * np.diff(omega) / (2 * np.pi)
    total = np.cumsum(np.hstack([density[:, :1] * omega[0] / (2 * np.pi), pieces]), axis=1)
    return CumulativePower(omega, total[0], total[1])


def band_power(power: CumulativePower, centre: float, width: float = 0.1) -> tuple[float, float]:
    """True and measured power in the band of relative half-width `width` around `centre` (rad/s)."""
    low, high = centre * (1 - width), centre * (1 + width)
    rise = [
        np.interp(high, power.omega, p) - np.interp(low, power.omega, p) for p in (power.true, power.measured)
    ]
    return float(rise[0]), float(rise[1])
