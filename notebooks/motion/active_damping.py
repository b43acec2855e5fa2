"""Poles and zeros beside the magnitude."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from experiments.motion.pictures import add_magnitude
from stillwork.base.rounding import in_order
from stillwork.control.feedback import place
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel
from workbook import figures


def rigid_poles_after_placement(model: ModalModel, increase: float, machines: int = 21) -> np.ndarray:
    """Largest real part of a rigid-body pole after Ackermann's formula has placed all poles, over the first resonance.

    On `machines` stages whose frequencies differ from the model's by up to 1 %: what rounding leaves varies from
    one to the next. The wanted poles are those of (3.33), with the double one at zero left where it is.
    """
    found = []
    for shift in np.linspace(-0.01, 0.01, machines):
        machine = replace(model, frequencies=(1 + shift) * model.frequencies)
        states, ratios = machine.state_space(), machine.damping[1:] + increase
        upper = machine.frequencies[1:] * (-ratios + 1j * np.sqrt(1 - ratios**2))
        gain = place(states, np.concatenate([[0, 0], upper, upper.conj()]))
        poles = np.linalg.eigvals(states.a + states.b @ gain)
        slow = poles[np.argsort(np.abs(poles))[:2]]
        found.append(slow.real.max() / machine.frequencies[1])
    return np.array(found)


def paint_pole_zero(systems: Mapping[str, StateModel]):
    """Poles and zeros in the upper half-plane beside the magnitude, for systems with a few modes.

    What comes later is drawn smaller, so that what coincides stays visible.
    """
    figure, axes = figures.new(1, 2, height=3.2)
    colours = [figures.BLUE, figures.GREEN, figures.RED]
    top = max(np.abs(system.poles).max() for system in systems.values())
    omega = np.geomspace(top / 30, top * 2, 1500)
    sizes = zip(colours, (10, 7, 4), (3.0, 2.0, 1.0), strict=True)
    for (colour, marker_size, width), (label, system) in zip(sizes, systems.items(), strict=True):
        for kind, marker, values in (("poles", "x", system.poles), ("zeros", "o", system.zeros)):
            values = top * in_order(values / top)
            upper = values[(values.imag >= -1e-6) & (np.abs(values) < 3 * top)]
            style = {"color": colour, "markerfacecolor": "none", "markersize": marker_size}
            axes[0].plot(
                *(np.array([upper.real, upper.imag]) / (2 * np.pi)), marker, label=f"{label}, {kind}", **style
            )
        add_magnitude(
            axes[1], omega, system.frequency_response(omega)[0, 0], color=colour, label=label, lw=width
        )
    axes[0].set(xlabel="real part / 2π (Hz)", ylabel="imaginary part / 2π (Hz)")
    axes[0].legend(fontsize=7)
    axes[1].set(xlabel="frequency (Hz)", ylabel="magnitude (dB re 1 m/N)")
    axes[1].legend(fontsize=7)
    return figure
