"""Figure and explorer of the two-inertia drive (notebook 12)."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from experiments.motion.bode import paint_bode
from experiments.motion.drive import drive_applications, drive_loop, rigid_response, seen_by_controller
from experiments.motion.legends import CASES
from experiments.motion.machines import Drive, drive
from experiments.motion.magnitudes import add_magnitude, plain_numbers
from stillwork.identification.frequency_response import Identified
from stillwork.lti.state_space import StateModel
from workbook import figures


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
