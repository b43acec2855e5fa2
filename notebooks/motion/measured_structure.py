"""The measured structure: what notebook 13 alone needs, its search, pictures and appendix."""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
import pandas as pd

from experiments.motion.machines import as_stage, measured_accelerance, published_noise, stage_mass
from experiments.motion.pictures import decibel, paint_bode
from stillwork.control.applications import Application
from stillwork.control.bandwidth import FUNCTIONS, Bandwidth, Loop, highest_peaks, maximise_bandwidth
from stillwork.control.machine_loops import SAFE, SHOWN, encirclement_difference, observed_loops
from stillwork.control.pid import Pid, PidFamily
from stillwork.identification.frequency_response import Identified
from stillwork.identification.modal_fit import ModalFit, identify_modes
from stillwork.lti.modal import ModalModel, mirrored
from workbook import figures

LIMITS = {"all three": SAFE, "S_I, S_O alone": SAFE[:2]}
Found = Mapping[tuple[str, str], Sequence[Bandwidth]]


def limits_of(
    modelled: Mapping[str, Sequence[Loop]], measured: Mapping[str, Sequence[Loop]], family: PidFamily
) -> tuple[dict[tuple[str, str], list[Bandwidth]], dict[tuple[str, str], Pid]]:
    """By use of the observer and set of `LIMITS`: the largest bandwidths on model and measurement, and the lower controller."""
    range_hz = {"low_hz": 20.0, "high_hz": 300.0, "tolerance_hz": 0.01}
    found = {
        (name, label): [
            maximise_bandwidth(loops[name], family, limits, refine=refine, lowest=True, **range_hz)
            for loops, refine in ((modelled, True), (measured, False))
        ]
        for name in modelled
        for label, limits in LIMITS.items()
    }
    return found, {
        case: min(pair, key=lambda each: each.design_hz).controller for case, pair in found.items()
    }


def table_of(
    found: Found, measured: Mapping[str, Sequence[Loop]], lower: Mapping[tuple[str, str], Pid]
) -> pd.DataFrame:
    """The search as a table: first crossings (Hz), what stops it, the peak from r to e_true and extra turns on the measurement."""
    rows = {}
    for (name, label), (on_model, on_data) in found.items():
        responses = [each.at(on_data.controller) for each in measured[name]]
        turns = [abs(encirclement_difference(each, lower[name, label])) for each in measured[name]]
        rows[name, label] = {
            "on the model": on_model.crossing_hz.mean().round(1),
            "on the measurement": on_data.crossing_hz.mean().round(1),
            "stopped by": f"{SHOWN[on_data.function]} at {on_data.peak.omega / (2 * np.pi):.0f} Hz",
            "tracking (dB)": max(decibel(each.true_tracking).max() for each in responses),
            "extra turns": sum(turns),
        }
    return pd.DataFrame(rows).T


def paint_fit(fine: Identified, fit: ModalFit, band_hz: tuple[float, float]):
    """The measured accelerance with the fitted one, the coherence, and the error of the fit."""
    shown = (fine.omega > 2 * np.pi * 20) & (fine.omega < 2 * np.pi * 3500)
    omega = fine.omega[shown]
    fitted = -(omega**2) * fit.model.frequency_response(omega)[0, 0]
    figure, axes = figures.new(3, 1, height=6.0, sharex=True)
    hertz = omega / (2 * np.pi)
    axes[0].semilogx(hertz, decibel(fine.response[shown]), linewidth=0.9, label="measured")
    axes[0].semilogx(hertz, decibel(fitted), "--", linewidth=0.9, label="fitted")
    axes[0].set_ylabel("accelerance (dB re 1/kg)")
    for axis in axes:
        axis.axvspan(*band_hz, color=figures.GREY, alpha=0.12, linewidth=0, label="band of the fit")
    axes[0].legend()
    axes[1].semilogx(hertz, fine.coherence[shown], linewidth=0.7, label="coherence")
    axes[1].set_ylabel("coherence")
    axes[2].loglog(fit.omega / (2 * np.pi), 100 * fit.error, linewidth=0.7, label="error of the fit")
    axes[2].set_ylabel("relative error (%)")
    axes[2].set_xlabel("frequency (Hz)")
    return figure


def paint_limits(table: pd.DataFrame):
    """First crossings of the search, by use of the observer, set of limits and place."""
    figure, axis = figures.new(1, 1, height=2.8)
    for label, marker, left in (("all three", "o", -0.15), ("S_I, S_O alone", "x", 0.05)):
        of = table.xs(label, level=1)
        name = "all three constraints" if marker == "o" else "$S_I$, $S_O$ alone"
        for shift, place, colour in (
            (0, "on the model", figures.BLUE),
            (0.1, "on the measurement", figures.RED),
        ):
            face = {"color": colour, "markerfacecolor": "none" if shift else colour}
            places = np.arange(len(of)) + left + shift
            axis.plot(places, of[place].astype(float), marker, label=f"{name}, {place}", **face)
    axis.set_xticks(range(len(of)), list(of.index))
    axis.set_ylabel("first crossing (Hz)")
    axis.set_ylim(0, None)
    axis.legend()
    return figure


@cache
def _fitted_structure() -> ModalModel:
    fit = identify_modes(measured_accelerance(1), (100.0, 3100.0))
    return as_stage(fit, stage_mass())[0]


def paint_structure(damping: float, noise_model: float):
    """Explorer: the mirrored sensor of the measured structure, bare and with MC and AD."""
    machine = [mirrored(_fitted_structure())]
    application = Application(compensate=True, damping=damping, selectivity=2.0)
    bare = observed_loops(machine, None, 5, published_noise(), None)[0]
    used = observed_loops(machine, application, 5, published_noise(), noise_model)[0]
    controller = PidFamily(stage_mass())(45.0)
    omega = used.omega[(used.omega > 2 * np.pi * 100) & (used.omega < 2 * np.pi * 3000)]
    curves = {
        "plant": (omega, bare.at(controller, omega).equivalent_plant),
        "with MC and AD": (omega, used.at(controller, omega).equivalent_plant),
    }
    return paint_bode(curves, "magnitude (dB re 1 m/N)", height=3.2)[0]


def appendix(
    page,
    *,
    modelled: Mapping[str, Sequence[Loop]],
    measured: Mapping[str, Sequence[Loop]],
    lower: Mapping[tuple[str, str], Pid],
) -> None:
    """What this notebook judges beside its answer: the peaks under all three constraints with the `lower` controllers."""
    page.text(
        "## What is recommended keeps its limits, on model and measurement, and at its closed-loop poles"
    )
    peaks, computed = [], []
    for name in measured:
        controller = lower[name, "all three"]
        for limit in SAFE:
            peaks += [each.peak(controller, limit.function).magnitude for each in modelled[name]]
            peaks += [np.abs(getattr(each.at(controller), limit.function)).max() for each in measured[name]]
        highest = highest_peaks(modelled[name], controller, FUNCTIONS)  # infinite of an unstable loop
        computed += [each.magnitude for each in highest.values()]
    page.check("motion.structure.recommended", max(0.0, decibel(max(peaks)) - 6.0))
    page.check("motion.structure.computed", max(0.0, decibel(max(computed)) - 6.0))
