"""The rejection of disturbances at rest, section 3.5.1: its power over frequency, its figure and explorer (notebook 10)."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from experiments.motion.designs import Design, stage_compensator
from experiments.motion.machines import stage, stage_mass
from experiments.motion.pictures import case_styles
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.loops import channel, closed_loop, require_deviations, require_stable
from stillwork.control.pid import PidFamily
from stillwork.lti.discretisation import zoh
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.state_space import StateModel
from workbook import figures


class CumulativePower(NamedTuple):
    """Power of the errors below each frequency (m^2)."""

    omega: Float64[np.ndarray, " frequencies"]  # rad/s
    true: Float64[np.ndarray, " frequencies"]
    measured: Float64[np.ndarray, " frequencies"]


def cumulative_power(
    loop: StateModel,
    sample_time: float,
    deviations: dict[str, float],
    omega: Float64[np.ndarray, " frequencies"],
) -> CumulativePower:
    """Cumulative power of true and measured error under independent white noise held over each sample.

    It comes from the discrete frequency responses, not from a simulated record, so it has no scatter. `deviations`
    are those of the inputs ``w``, ``v``, ``d`` (N and m): a standard deviation sigma has the one-sided density 2
    sigma^2 sample_time. `omega` ascends to the Nyquist frequency at most and is fine at every resonance.
    """
    omega = np.asarray(omega, float)
    require_deviations(deviations)
    require_stable(loop)
    both = channel(loop, list(deviations), ("e_true", "e_meas"))
    response = zoh(both, sample_time).frequency_response(omega)
    weights = 2 * sample_time * np.array(list(deviations.values())) ** 2
    density = np.einsum("oif,i->of", np.abs(response) ** 2, weights)  # m^2/Hz
    pieces = (density[:, 1:] + density[:, :-1]) / 2 * np.diff(omega) / (2 * np.pi)
    total = np.cumsum(np.hstack([density[:, :1] * omega[0] / (2 * np.pi), pieces]), axis=1)
    return CumulativePower(omega, total[0], total[1])


def band_power(power: CumulativePower, centre: float, width: float = 0.1) -> tuple[float, float]:
    """True and measured power in the band of relative half-width `width` around `centre` (rad/s)."""
    ends = centre * np.array([1 - width, 1 + width])
    true, measured = (np.ptp(np.interp(ends, power.omega, p)) for p in (power.true, power.measured))
    return float(true), float(measured)


def paint_cumulative(power: Mapping[str, CumulativePower], low_hz: float = 1.0):
    """Cumulative power of the measured and of the true error above `low_hz`, nm^2."""
    from matplotlib.ticker import NullFormatter

    figure, axes = figures.new(1, 2, height=3.2, sharey=True)
    styles = case_styles(power)
    for label, each in power.items():
        style = {"label": label, **styles.get(label, {})}
        shown = each.omega >= 2 * np.pi * low_hz
        for axis, values in zip(axes, (each.measured, each.true), strict=True):
            axis.semilogx(each.omega[shown] / (2 * np.pi), 1e18 * values[shown], **style)
    for axis, title in zip(axes, ("measured error $e_{meas}$", "true error $e_{true}$"), strict=True):
        axis.set_title(title)
        axis.xaxis.set_minor_formatter(NullFormatter())
    figures.label(axes, "frequency (Hz)", "cumulative power (nm²)")
    axes[0].legend(loc="upper left")
    return figure


def paint_disturbance(bandwidth_hz: float, process_noise: float, damping: float):
    """Explorer: cumulative power of the errors at rest without observer and with active damping."""
    plant, sample_time = stage().at([0], [4]), 1e-4
    controller = PidFamily(stage_mass())(bandwidth_hz).state_space()
    designs = {"PID": Design(), "AD": Design(Application(damping=damping, selectivity=2.0))}
    noise = {"w": process_noise, "v": 1e-9, "d": 1e-9}
    grid = resonance_grid(plant.poles, 0.01, 0.5 / sample_time, 300, 15)
    power = {}
    for name, design in designs.items():
        loop = closed_loop(plant, stage_compensator(5, design), controller)
        if not loop.is_stable:
            raise InputError(f"{name} is unstable at {bandwidth_hz:g} Hz; lower the bandwidth")
        power[name] = cumulative_power(loop, sample_time, noise, grid)
    return paint_cumulative(power)
