"""Three masses in a row, Example 1.5.1: a loop that a larger bandwidth makes stable or not (notebook 01)."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from experiments.motion.machines import chain_matrix
from stillwork.control.bandwidth import Bandwidth, Loop, PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.pid import Pid, PidFamily
from stillwork.lti.modal import ModalModel, modal_model
from stillwork.lti.peaks import resonance_grid
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


def paint_nyquist(loops: Mapping[str, Loop], controller: Pid, around: int = 150):
    """Nyquist plot of open loops near -1, with the verdict of the closed-loop eigenvalues."""
    figure, axis = figures.new(1, 1, height=4.2)
    for label, loop in loops.items():
        omega = resonance_grid(loop.plant.poles, 10.0, 1e4, 300, around)
        open_loop = loop.at(controller, omega).loop
        verdict = "stable" if loop.is_stable(controller) else "unstable"
        near = open_loop[np.abs(open_loop) < 30]
        axis.plot(near.real, near.imag, label=f"{label}: {verdict}")
    axis.plot([-1], [0], "+", color=figures.BLACK, markersize=12, label="−1")
    axis.set(xlim=(-6, 6), ylim=(-6, 6), aspect="equal")
    figures.label(axis, "real part of the open loop", "imaginary part of the open loop")
    axis.legend()
    return figure


def paint_three_masses(bandwidth_hz: float):
    """Explorer: Nyquist plot of Example 1.5.1 for both sensor positions."""
    masses = np.full(3, 4.0)
    machine = three_masses(masses, scaled_springs(masses, 45.0))
    controller = PidFamily(masses.sum())(bandwidth_hz)
    loops = {f"$x_{k + 1}$": make_loop(machine.at([0], [k])) for k in (0, 1)}
    return paint_nyquist(loops, controller, around=60)  # coarse enough to redraw quickly
