"""What an observer does to the bandwidth: table, map, and explorers of stage, drive and measured structure."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache

import numpy as np

from experiments.motion.designs import Design, stage_loops
from experiments.motion.drive import drive_applications, drive_loop, rigid_response, seen_by_controller
from experiments.motion.machines import Drive, drive, published_noise, stage_mass
from experiments.motion.open_choices import BandwidthMap
from experiments.motion.pictures import (
    CASES,
    LABELS,
    add_magnitude,
    paint_bode,
    paint_over_masses,
    plain_numbers,
)
from experiments.motion.structure import as_stage, measured_accelerance
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Bandwidth, Loop
from stillwork.control.machine_loops import observed_loops
from stillwork.control.pid import PidFamily
from stillwork.identification.frequency_response import Identified
from stillwork.identification.modal_fit import identify_modes
from stillwork.lti.modal import ModalModel, mirrored
from stillwork.lti.state_space import StateModel
from stillwork.workbook import figures


@lru_cache(maxsize=8)
def _loops(design: Design) -> list[Loop]:
    """Loops of the seven masses: they stay while the bandwidth alone moves."""
    return stage_loops(design, points=250, around=8)


def paint_design(
    bandwidth_hz: float,
    damping: float = 0.0,
    selectivity: float = 2.0,
    compensate: str = "no",
    noise_model: float = 0.03,
):
    """Explorer: S_I and S_O of the seven loops for one controller and one use of the observer."""
    used = damping > 0 or compensate == "yes"
    application = Application(compensate == "yes", damping, selectivity=selectivity) if used else None
    loops = _loops(Design(application, noise_model))
    controller = PidFamily(stage_mass())(bandwidth_hz)
    names = ("input_sensitivity", "output_sensitivity")
    figure = paint_over_masses({LABELS[name]: (loops, controller, name) for name in names})
    peaks = [max(loop.peak(controller, name).magnitude for loop in loops) for name in names]
    stable = all(np.all(loop.poles(controller).real < 0) for loop in loops)
    for axis, peak in zip(figure.axes, peaks, strict=True):
        verdict = f"peak {20 * np.log10(peak):.1f} dB" if stable else "unstable"
        axis.set_title(f"{axis.get_title(loc='left')}: {verdict}")
    return figure


def paint_bandwidths(found: Mapping[str, Bandwidth], position: int, published_hz: Sequence[float]):
    """First crossings at one mass with their range over the masses, and the design parameters, beside the published."""
    figure, axis = figures.new(1, 1, height=3.2)
    places, crossings = range(len(found)), np.array([each.crossing_hz for each in found.values()])
    middle = crossings[:, position - 1]
    reach = [middle - crossings.min(axis=1), crossings.max(axis=1) - middle]
    label = f"first crossing, mass {position} and range over masses"
    axis.errorbar(places, middle, yerr=reach, fmt="o", capsize=4, color=figures.BLUE, label=label)
    designs = [each.design_hz for each in found.values()]
    style = {"markersize": 14, "color": figures.RED, "label": "design parameter $f_{bw}$"}
    axis.plot(places, designs, "_", **style)
    figures.mark_published(axis, places, published_hz)
    names = [name.replace(", ", ",\n").replace(" with ", "\nwith ") for name in found]
    axis.set_xticks(places, names, fontsize=7)
    axis.set_ylabel("bandwidth (Hz)")
    axis.legend()
    return figure


def paint_map(chart: BandwidthMap, best: tuple[float, float, str]):
    """First crossings over Q_nu and Q, each cell as wide as the other; `best` is a printed place and what it says."""
    figure, axis = figures.new(1, 1, height=3.4)
    edges = [_edges(chart.noise_model), _edges(chart.selectivity)]
    mesh = axis.pcolormesh(*edges, chart.crossing_hz, cmap="viridis")
    figure.colorbar(mesh, ax=axis, label="first crossing (Hz)")
    axis.set(xscale="log", yscale="log", xlabel=r"noise model $Q_\nu$ (N²/s)", ylabel="selectivity $Q$")
    figures.mark_published(axis, *best[:2], label=best[2], markersize=9, color="white")
    axis.legend(axis.lines, [best[2]], loc="lower left", labelcolor="white")
    return figure


def _edges(centres: np.ndarray) -> np.ndarray:
    """Edges of cells around ascending positive centres, halfway in logarithms."""
    inner = np.sqrt(centres[1:] * centres[:-1])
    return np.concatenate([[centres[0] ** 2 / inner[0]], inner, [centres[-1] ** 2 / inner[-1]]])


def paint_identified(
    plant: Drive, loops: Mapping[str, StateModel], found: Mapping[str, Identified], hertz: tuple[float, float]
):
    """What the controller of the drive sees, as identified and exact, beside the rigid body, and the coherence."""
    figure, axes = figures.new(2, 1, height=5.0, sharex=True)
    for name, each in found.items():
        shown = (each.omega > 2 * np.pi * hertz[0]) & (each.omega < 2 * np.pi * hertz[1])
        omega, style = each.omega[shown], {"color": CASES[name], "linewidth": 0.7}
        add_magnitude(axes[0], omega, each.response[shown], label=f"{name}, identified", **style)
        exact = seen_by_controller(loops[name], omega)
        add_magnitude(axes[0], omega, exact, label=f"{name}, exact", color=CASES[name], linestyle=":")
        axes[1].semilogx(omega / (2 * np.pi), each.coherence[shown], label=name, **style)
    add_magnitude(axes[0], omega, rigid_response(plant, omega), label="rigid body", color=figures.GREY)
    axes[0].set_ylabel("magnitude (dB re 1 rad/A)")
    axes[0].legend(ncols=3, fontsize=7)
    axes[1].set(ylabel="coherence", xlabel="frequency (Hz)")
    plain_numbers(axes[1].xaxis)
    return figure


def paint_drive(stiffness_error: float, damping: float, bandwidth_hz: float):
    """Explorer: what the controller of the two-inertia drive sees, with an observer whose stiffness is off."""
    plant = drive()
    model = replace(plant, stiffness=plant.stiffness * (1 + stiffness_error))
    omega = 2 * np.pi * np.geomspace(2, 60, 400)
    curves = {
        name: (omega, seen_by_controller(drive_loop(plant, model, each, bandwidth_hz), omega))
        for name, each in drive_applications(damping).items()
    }
    return paint_bode(curves, "magnitude (dB re 1 rad/A)", height=3.2)[0]


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
