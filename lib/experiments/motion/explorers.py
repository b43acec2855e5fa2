"""Explorers of the mass chain of chapter 2, and of the stage's bandwidth with one use of the observer."""

from collections.abc import Iterable
from functools import lru_cache

import numpy as np

from experiments.motion.designs import (
    DESIGNS,
    NOISE_MODEL,
    Design,
    stage_bandwidth,
    stage_loops,
)
from experiments.motion.machines import chain, stage_mass
from experiments.motion.pictures import (
    LABELS,
    decibel,
    magnitudes_over_masses,
    paint_bode,
    paint_over_masses,
)
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Loop, highest_peaks
from stillwork.control.pid import PidFamily
from stillwork.lti.peaks import resonance_grid


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


ORIGINAL = ", original controller"
THREE = ("input_sensitivity", "output_sensitivity", "true_tracking")


@lru_cache(maxsize=8)
def loops_of(design: Design) -> list[Loop]:
    """Loops of the seven masses: they stay while the bandwidth alone moves."""
    return stage_loops(design, points=120, around=5)


def paint_design(
    bandwidth_hz: float,
    damping: float = 0.0,
    selectivity: float = 2.0,
    compensate: str = "no",
    noise_model: float = NOISE_MODEL,
):
    """Explorer: S_I and S_O of the seven loops for one controller and one use of the observer."""
    used = damping > 0 or compensate == "yes"
    application = Application(compensate == "yes", damping, selectivity=selectivity) if used else None
    loops, controller = loops_of(Design(application, noise_model)), PidFamily(stage_mass())(bandwidth_hz)
    figure, names = _panels(), THREE[:2]
    curves = magnitudes_over_masses({name: (loops, controller, name) for name in names})
    peaks = highest_peaks(loops, controller, names)
    for axis, (name, peak) in zip(figure.axes, peaks.items(), strict=True):
        for line, (omega, response, _) in zip(axis.lines, curves[name].values(), strict=False):
            line.set_data(omega / (2 * np.pi), decibel(response))
        verdict = f"peak {decibel(peak.magnitude):.1f} dB" if np.isfinite(peak.magnitude) else "unstable"
        axis.set_title(f"{LABELS[name]}: {verdict}")
    return figure


@lru_cache
def _panels():
    """The figure of `paint_design`, kept from one move to the next: its lines and titles are set anew."""
    plain = loops_of(DESIGNS["PID"]), PidFamily(stage_mass())(10.0)
    return paint_over_masses({LABELS[name]: (*plain, name) for name in THREE[:2]})


@lru_cache(maxsize=8)
def limit_hz(design: str) -> float:
    return stage_bandwidth(design).design_hz


def design_presets(designs: Iterable[str], *controls: str) -> dict[str, dict]:
    """Presets of an explorer with these `controls` of `paint_design`: designs of the bandwidth table, at their limits.

    A name that ends in ``", original controller"`` has the limit of PID. Limits are rounded down to 0.1 Hz, so that they
    stay feasible.
    """
    found = {}
    for name in designs:
        used = name.removesuffix(ORIGINAL)
        use = DESIGNS[used].application or Application()
        settings = {
            "bandwidth_hz": float(np.floor(10 * limit_hz(used if used == name else "PID")) / 10),
            "damping": use.damping,
            "selectivity": use.selectivity,
            "compensate": "yes" if use.compensate else "no",
            "noise_model": DESIGNS[used].noise_model or NOISE_MODEL,
        }
        found[name] = {control: settings[control] for control in controls}
    return found
