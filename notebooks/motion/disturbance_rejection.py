"""The rejection of disturbances at rest, section 3.5.1: its power over frequency, its figure and explorer (notebook 10)."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float64
from matplotlib.ticker import NullFormatter

from experiments.motion.designs import (
    DESIGNS,
    Design,
    design_controller,
    stage_bandwidth,
    stage_compensator,
    stage_loops,
)
from experiments.motion.machines import stage, stage_mass
from experiments.motion.pictures import add_magnitude, case_styles
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


def paint_rejections(cases: Mapping[str, StateModel], omega: np.ndarray):
    """Transfers from r, u_ff, w, v and d to the true error for several closed loops (Fig. 3.31), with the limit of the first."""
    figure, axes = figures.new(3, 2, sharex=True)
    colours = case_styles(cases)
    sources = {"r": "$r$", "u_ff": "$u_{ff}$", "w": "$w$", "v": "$v$", "d": "$d$"}
    for axis, (source, name) in zip(axes.ravel(), sources.items(), strict=False):
        for number, (label, loop) in enumerate(cases.items()):
            response = channel(loop, source, "e_true").frequency_response(omega)[0, 0]
            # The differences are local: the first case lies broad and grey below the others.
            style = {
                "linewidth": 1.0,
                "color": colours[label]["color"],
                "linestyle": "--" if number > 1 else "-",
            }
            style |= {"color": figures.GREY, "linewidth": 2.5} if number == 0 else {}
            add_magnitude(axis, omega, response, label=label, **style)
        axis.set_title(f"{name} to $e_{{true}}$")
        axis.set_ylabel("magnitude (dB re 1 m/N)" if source in ("u_ff", "w") else "magnitude (dB)")
    figures.label(axes, "frequency (Hz)")
    for axis in axes[-1]:
        axis.xaxis.set_minor_formatter(NullFormatter())
    axes[2, 1].set_axis_off()
    axes[2, 1].legend(*axes[0, 0].get_legend_handles_labels(), loc="center")
    axes[1, 1].tick_params(labelbottom=True)
    axes[1, 1].set_xlabel("frequency (Hz)")
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


def third_constraint() -> tuple[dict[str, list[float]], float]:
    """Largest f_bw (Hz) by design with two constraints and with the third, r to e_true; and what that costs all but MC."""
    two, limits = ("input_sensitivity", "output_sensitivity"), {}
    for name in ("MC", "AD", "MC and AD", "AD, no band-pass", "MC and AD, no band-pass"):
        designs = [replace(DESIGNS[name], constraints=each) for each in (two, (*two, "true_tracking"))]
        limits[name] = [stage_bandwidth(design).design_hz for design in designs]
    return limits, max(before - after for name, (before, after) in limits.items() if name != "MC")


# === Appendix =====================================================================================================


def appendix(page, *, redesign: str, position: int) -> None:
    """What this notebook judges beside its answer: Remark 3.5.1."""
    page.text("""
## Remark 3.5.1

In Fig. 3.31 the peak from $r$ to $e_{true}$ is below 6 dB, because another mass is critical. The peaks over the seven masses (dB):
""")
    peaks = {}
    for name in ("PID", "AD", "MC", "MC and AD"):
        controller = design_controller(name, redesign)
        each = [one.peak(controller, "true_tracking").magnitude for one in stage_loops(DESIGNS[name])]
        peaks[name] = 20 * np.log10(each)
    table = pd.DataFrame(peaks, index=[f"y{mass}" for mass in range(1, 8)]).T
    page.show(table.round(2))
    page.check("motion.remark-3-5-1.not-critical", np.mean(table[f"y{position}"] < table.max(axis=1) - 0.05))
