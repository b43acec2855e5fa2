"""The rejection of disturbances at rest, section 3.5.1: its power over frequency, its figure and explorer (notebook 10)."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float64
from scipy.signal import welch

from experiments.motion.designs import (
    DESIGNS,
    Design,
    design_controller,
    stage_bandwidth,
    stage_compensator,
    stage_loops,
)
from experiments.motion.machines import published_deviations, stage, stage_mass
from experiments.motion.pictures import case_styles
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.feedforward import noise_error
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


def third_constraint() -> tuple[dict[str, list[float]], float]:
    """Largest f_bw (Hz) by design with two constraints and with the third, r to e_true; and what that costs all but MC."""
    two, limits = ("input_sensitivity", "output_sensitivity"), {}
    for name in ("MC", "AD", "MC and AD", "AD, no band-pass", "MC and AD, no band-pass"):
        designs = [replace(DESIGNS[name], constraints=each) for each in (two, (*two, "true_tracking"))]
        limits[name] = [stage_bandwidth(design).design_hz for design in designs]
    return limits, max(before - after for name, (before, after) in limits.items() if name != "MC")


# === Appendix =====================================================================================================


def appendix(
    page,
    *,
    loop: StateModel,
    power: CumulativePower,
    sample_time: float,
    record: int,
    seed: int,
    redesign: str,
    position: int,
    over: Mapping[str, Sequence[float]],
    limits: Mapping[str, Sequence[float]],
) -> None:
    """What this notebook judges beside its answer.

    `loop` is the original one and `power` its cumulative power, `over` the peaks of Fig. 3.31 over those without observer (dB),
    `limits` of `third_constraint`.
    """
    page.text("## The power of a simulated record of the original loop, by Welch's method")
    noise = published_deviations()
    errors = noise_error(loop, sample_time, record, noise, np.random.default_rng(seed))[:, 5000:]
    frequency, density = welch(errors[0], 1 / sample_time, nperseg=32768)
    figure, axis = figures.new(1, 1, height=2.8)
    axis.semilogx(power.omega / (2 * np.pi), 1e18 * power.true, label="from the responses")
    axis.semilogx(frequency[1:], 1e18 * np.cumsum(density)[1:] * frequency[1], "--", label="simulated record")
    axis.set_xlim(1, None)
    axis.set_xlabel("frequency (Hz)")
    axis.set_ylabel("cumulative power (nm²)")
    axis.legend()
    page.save("record", figure)
    ratio = density.sum() * frequency[1] / power.true[-1]
    page.show(f"power of the record over that from the responses: {ratio:.2f}")
    page.text("## Fig. 3.31: peaks relative to those without observer (dB), by transfer and resonance")
    columns = [f"{source}, mode {k}" for source in ("r", "u_ff", "w") for k in (1, 2, 3)]
    page.show(pd.DataFrame(over, index=columns).T.round(1))
    page.text("## The third constraint: the largest design parameter (Hz)")
    page.show(pd.DataFrame(limits, index=["two constraints", "three"]).T.round(2))
    page.text("""
Remark 3.5.1: in Fig. 3.31 the peak from $r$ to $e_{true}$ is below 6 dB, because another mass is critical. The peaks over the
seven masses (dB):
""")
    peaks = {}
    for name in ("PID", "AD", "MC", "MC and AD"):
        controller = design_controller(name, redesign)
        each = [one.peak(controller, "true_tracking").magnitude for one in stage_loops(DESIGNS[name])]
        peaks[name] = 20 * np.log10(each)
    table = pd.DataFrame(peaks, index=[f"y{mass}" for mass in range(1, 8)]).T
    page.show(table.round(2))
    page.check("motion.remark-3-5-1.not-critical", np.mean(table[f"y{position}"] < table.max(axis=1) - 0.05))
    page.check("motion.remark-3-5-1.measured", table.loc["MC", f"y{position}"])
