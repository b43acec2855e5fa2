"""The scan, and three masses in a row (Example 1.5.1), whose loop a larger bandwidth makes unstable (notebook 01)."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from experiments.motion.machines import chain_matrix
from stillwork.control.bandwidth import Bandwidth, Loop, PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.pid import Pid, PidFamily
from stillwork.control.setpoint import Setpoint
from stillwork.lti.modal import ModalModel, modal_model
from stillwork.lti.peaks import resonance_grid
from stillwork.signals.moving_average import Moving
from workbook import figures


def three_masses(masses: ArrayLike, springs: ArrayLike) -> ModalModel:
    """Three masses in a row, the force on the first, positions of all (Fig. 1.7a)."""
    masses = np.asarray(masses, float)
    springs = np.asarray(springs, float)
    places = np.eye(3)
    return modal_model(np.diag(masses), chain_matrix(springs), places[:, :1], places, 0.005)


def scaled_springs(masses: ArrayLike, bandwidth_hz: float) -> np.ndarray:
    """Equal springs for which the loop through x2 has this bandwidth: all frequencies go with their root."""
    trial = np.full(2, 1e7)
    _, best = designed_for_second(three_masses(masses, trial), float(np.sum(masses)))
    return trial * (bandwidth_hz / best.crossing_hz[0]) ** 2


def designed_for_second(machine: ModalModel, mass: float) -> tuple[tuple[Loop, Loop], Bandwidth]:
    """Loops through x1 and x2, and the largest PID bandwidth for x2 alone."""
    first, second = (make_loop(machine.at([0], [k])) for k in (0, 1))
    scale = machine.frequencies[1] / (2 * np.pi)
    limits = [PeakConstraint("input_sensitivity")]
    best = maximise_bandwidth([second], PidFamily(mass), limits, 0.02 * scale, 0.9 * scale, scan=150)
    return (first, second), best


def stability_trial(rng: np.random.Generator, spread: float) -> dict[str, float]:
    """One machine with masses and springs drawn within +-`spread`: is x2 stable, and x1 unstable?"""
    masses, springs = 4 * (1 + rng.uniform(-spread, spread, 3)), 1e7 * (1 + rng.uniform(-spread, spread, 2))
    loops, best = designed_for_second(three_masses(masses, springs), float(masses.sum()))
    stable = [loop.is_stable(best.controller) for loop in loops]
    return {"first_unstable": float(not stable[0]), "second_stable": float(stable[1])}


def paint_nyquist(
    loops: Mapping[str, Loop], controller: Pid, around: int = 150, printed_hz: float | None = None
):
    """Nyquist plot of open loops, with the verdict of the closed-loop eigenvalues, its radius log10(1 + |L|).

    `printed_hz` marks the point of the last loop at a printed bandwidth.
    """
    figure, axis = figures.new(1, 1, height=4.6)
    angle = np.linspace(0, 2 * np.pi, 181)
    for size in (1.0, 10.0, 100.0):
        ring = _near_origin(size * np.exp(1j * angle))
        axis.plot(ring.real, ring.imag, color=figures.GREY, linewidth=0.6, label=f"|L| = {size:g}")
        axis.annotate(
            f"|L| = {size:g}",
            (0, ring.imag.max()),
            (0, 2),
            textcoords="offset points",
            fontsize=6,
            ha="center",
        )
    for (label, loop), style in zip(loops.items(), ("-", "--"), strict=True):
        omega = resonance_grid(loop.plant.poles, 10.0, 1e4, 300, around)
        line = _near_origin(loop.at(controller, omega).loop)
        verdict = "stable" if loop.is_stable(controller) else "unstable"
        axis.plot(line.real, line.imag, style, label=f"{label}: {verdict}")
        if printed_hz is not None and style == "--":
            at = _near_origin(loop.at(controller, np.array([2 * np.pi * printed_hz])).loop)
            figures.mark_published(axis, at.real, at.imag, label=f"{label} at the printed {printed_hz:g} Hz")
    axis.plot([_near_origin(-1.0).real], [0], "+", color=figures.BLACK, markersize=12, label="−1")
    axis.set(aspect="equal")
    figures.label(axis, "along the real axis, radius log10(1 + |L|)", "along the imaginary axis")
    axis.legend(handles=axis.lines[3:], loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _near_origin(response):
    """A response with its distance from the origin as log10(1 + distance)."""
    response = np.asarray(response, complex)
    return response / np.abs(response) * np.log10(1 + np.abs(response))


def paint_moving(
    setpoint: Setpoint, error: np.ndarray, values: Moving, centre: np.ndarray, inside: np.ndarray
):
    """Error in the scan with its moving average, deviation and rms (nm) at the centres that lie `inside`."""
    figure, axis = figures.new(1, 1, height=3.0)
    shown = setpoint.scanning
    grey = {"color": figures.GREY, "linewidth": 0.7, "label": "error"}
    axis.plot(setpoint.time[shown], 1e9 * error[shown], **grey)
    for name, curve in (("MA", values.average), ("MSD", values.deviation), ("rms", values.rms)):
        largest = 1e9 * np.abs(curve[inside]).max()
        label = f"{name}, at most {largest:.1f} nm"
        axis.plot(centre[inside], 1e9 * curve[inside], "--" if name == "rms" else "-", label=label)
    axis.set(xlabel="time (s)", ylabel="error in the scan (nm)")
    axis.legend(ncols=2)
    return figure


def paint_three_masses(bandwidth_hz: float):
    """Explorer: Nyquist plot of Example 1.5.1 for both sensor positions."""
    masses = np.full(3, 4.0)
    machine = three_masses(masses, scaled_springs(masses, 45.0))
    controller = PidFamily(masses.sum())(bandwidth_hz)
    loops = {f"$x_{k + 1}$": make_loop(machine.at([0], [k])) for k in (0, 1)}
    return paint_nyquist(loops, controller, around=60)  # coarse enough to redraw quickly
