"""Explorers of the mass chain of chapter 2 (notebooks 02 and 03)."""

import numpy as np

from experiments.motion.bode import paint_bode
from experiments.motion.machines import chain
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import roll_off, truncate
from workbook import figures


def paint_reduction(retained: int, cutoff_hz: float):
    """Explorer: model error of the reduced ten-mass chain, with and without compliance."""
    full = chain(np.full(10, 2.0)).at([0], [0])
    omega = resonance_grid(full.poles, 0.3, 300.0, 300, 20)
    exact = full.frequency_response(omega)[0, 0]
    compensated = truncate(full, int(retained), 10 - int(retained))
    reduced = {
        "truncated": truncate(full, int(retained)),
        "with compliance": compensated,
        "rolled off": roll_off(compensated, cutoff_hz),
    }
    curves = {"full": (omega, exact)}
    for name, each in reduced.items():
        curves[f"error, {name}"] = omega, exact - each.frequency_response(omega)[0, 0]
    grey = {"full": {"color": figures.GREY}}
    return paint_bode(curves, "magnitude (dB re 1 m/N)", styles=grey, height=3.2)[0]


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
