"""Explorers of the motion room's first two chapters: position dependence, reduction, discretisation."""

from collections.abc import Mapping

import numpy as np

from experiments.motion.discretisation import VARIANTS, transition
from experiments.motion.machines import chain
from experiments.motion.pictures import paint_bode
from experiments.motion.three_masses import scaled_springs, three_masses
from stillwork.control.bandwidth import Loop, make_loop
from stillwork.control.pid import Pid, PidFamily
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import roll_off, truncate
from stillwork.workbook import figures


def paint_nyquist(loops: Mapping[str, Loop], controller: Pid):
    """Nyquist plot of open loops near -1, with the verdict of the closed-loop eigenvalues."""
    figure, axis = figures.new(1, 1, height=4.2)
    for label, loop in loops.items():
        open_loop = loop.at(controller).loop
        stable = bool(np.all(loop.poles(controller).real < 0))
        near = np.abs(open_loop) < 30
        axis.plot(
            open_loop.real[near], open_loop.imag[near], label=f"{label}: {'stable' if stable else 'unstable'}"
        )
    axis.plot([-1], [0], "+", color=figures.BLACK, markersize=12, label="-1")
    axis.set(xlim=(-6, 6), ylim=(-6, 6))
    axis.set_aspect("equal")
    axis.set(xlabel="real part", ylabel="imaginary part")
    axis.legend()
    return figure


def paint_three_masses(bandwidth_hz: float):
    """Explorer: Nyquist plot of Example 1.5.1 for both sensor positions."""
    masses = np.full(3, 4.0)
    machine = three_masses(masses, scaled_springs(masses, 45.0))
    controller = PidFamily(masses.sum())(bandwidth_hz)
    return paint_nyquist({f"$x_{k + 1}$": make_loop(machine.at([0], [k])) for k in (0, 1)}, controller)


def paint_reduction(retained: int, cutoff_hz: float):
    """Explorer: model error of the reduced ten-mass chain, with and without compliance."""
    full = chain(np.full(10, 2.0)).at([0], [0])
    omega = resonance_grid(full.poles, 0.3, 300.0, 300, 20)
    exact = full.frequency_response(omega)[0, 0]
    compensated = truncate(full, int(retained), 10 - int(retained))
    curves = {
        "full": (omega, exact),
        "error, truncated": (omega, exact - truncate(full, int(retained)).frequency_response(omega)[0, 0]),
        "error, with compliance": (omega, exact - compensated.frequency_response(omega)[0, 0]),
        "error, rolled off": (
            omega,
            exact - roll_off(compensated, cutoff_hz).frequency_response(omega)[0, 0],
        ),
    }
    return paint_bode(
        curves, "magnitude (dB re 1 m/N)", styles={"full": {"color": figures.GREY}}, height=3.2
    )[0]


def paint_heavy_mass(place: int, mass_kg: float):
    """Explorer: force to position at mass 1 of the five-mass chain with one mass changed."""
    masses = np.full(5, 1.6)
    masses[int(place) - 1] = mass_kg
    curves = {}
    for label, values in (("all 1.6 kg", np.full(5, 1.6)), (f"mass {int(place)}: {mass_kg:g} kg", masses)):
        machine = chain(values).at([0], [0])
        omega = resonance_grid(machine.poles, 5.0, 100.0, 300, 30)
        curves[label] = (omega, machine.frequency_response(omega)[0, 0])
    return paint_bode(curves, "$f_1$ to $x_1$ (dB re 1 m/N)", height=3.2)[0]


def paint_transition_error(frequency_hz: float, damping: float):
    """Explorer: error of the printed and of the lightly damped transition matrix over the sample time."""
    steps = np.geomspace(1e-6, 0.4 / frequency_hz, 200)
    figure, axis = figures.new(1, 1, height=2.8)
    for variant in VARIANTS[1:]:
        w = 2 * np.pi * frequency_hz
        error = []
        for step in steps:
            exact = transition(w, damping, step)
            size = np.array([[1, 1 / w], [w, 1]])  # the size of each entry, which itself passes zero
            error.append((np.abs(transition(w, damping, step, variant) - exact) / size).max())
        axis.loglog(1e3 * steps, error, label=variant)
    axis.set(xlabel="sample time (ms)", ylabel="largest error, scaled entries")
    axis.legend()
    return figure
