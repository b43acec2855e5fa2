"""Pictures of a machine of one's own (notebook 29)."""

from collections.abc import Callable, Mapping

import numpy as np

from experiments.motion.pictures import decibel, paint_bode, paint_over_masses
from stillwork.base.checks import InputError
from stillwork.control.applications import Application
from stillwork.control.loops import LoopResponse
from stillwork.control.machine_loops import (
    AchievableBandwidth,
    Intensities,
    observer_settings,
    observing_compensator,
)
from stillwork.identification.machine import Machine
from stillwork.lti.peaks import resonance_grid
from stillwork.machine import design_page as designing
from workbook import figures


def paint_machine(machine: Machine):
    """Accelerance of the model at every sensor; with a measurement also that, and the error of the fit."""
    if machine.measured is None:
        return designing.paint_machine(machine)
    figure, (upper, lower) = figures.new(2, 1, height=4.6, sharex=True)
    omega = machine.fit.omega
    inside = (machine.measured.omega >= 0.3 * omega[0]) & (machine.measured.omega <= 1.2 * omega[-1])
    measured = machine.measured.omega[inside], machine.measured.response[inside]
    hertz = measured[0] / (2 * np.pi)
    fitted = -(measured[0] ** 2) * machine.sensors[0].frequency_response(measured[0])[0, 0]
    for response, label, style in (
        (measured[1], "measured", {"color": figures.BLUE}),
        (fitted, "fitted", {"color": figures.RED, "linestyle": "--"}),
    ):
        kept = envelope(hertz, np.abs(response))
        upper.semilogx(hertz[kept], decibel(response[kept]), linewidth=0.9, label=label, **style)
    for axis in (upper, lower):
        band = omega[0] / (2 * np.pi), omega[-1] / (2 * np.pi)
        axis.axvspan(*band, color=figures.GREY, alpha=0.12, linewidth=0, label="band of the fit")
    upper.set_ylabel("accelerance (dB re 1/kg)")
    upper.legend()
    kept = envelope(omega, machine.fit.error)
    lower.loglog(omega[kept] / (2 * np.pi), 100 * machine.fit.error[kept], linewidth=0.7, color=figures.BLACK)
    lower.set(ylabel="error of the fit (%)", xlabel="frequency (Hz)")
    return figure


def envelope(x: np.ndarray, magnitude: np.ndarray) -> np.ndarray:
    """Index of the largest and the smallest magnitude in each of 500 logarithmic stretches: no peak is lost."""
    place = np.searchsorted(np.geomspace(x[0], x[-1], 501)[1:-1], x)
    starts = np.flatnonzero(np.diff(place, prepend=-1))
    stretches = np.split(np.arange(len(x)), starts[1:])
    return np.unique([each[pick(magnitude[each])] for each in stretches for pick in (np.argmin, np.argmax)])


def paint_reached(found: Mapping[str, AchievableBandwidth]):
    """First crossing of every sensor for every use of the observer, on the model and on the measurement."""
    figure, axis = figures.new(1, 1, height=2.8)
    for number, (attribute, label, marker) in enumerate(
        (("on_model", "on the model", "o"), ("on_measurement", "on the measurement", "s"))
    ):
        limits = [getattr(reached, attribute) for reached in found.values()]
        points = [(k + 0.1 * number, hz) for k, each in enumerate(limits) if each for hz in each.crossing_hz]
        if points:
            face = {} if number == 0 else {"markerfacecolor": "none"}
            axis.plot(*np.transpose(points), marker, label=label, **face)
    axis.set_xticks(range(len(found)), list(found))
    axis.set(xlim=(-0.5, len(found) - 0.4), ylim=(0, None), ylabel="first crossing (Hz)")
    axis.legend()
    return figure


def paint_sensitivities(found: Mapping[str, AchievableBandwidth], machine: Machine):
    """Output sensitivity of every sensor at the limit of PID and of the furthest use of the observer."""
    reached = {name: each for name, each in found.items() if each.recommended is not None}
    if not reached:
        raise InputError(
            "no loop has a feasible bandwidth; the reasons stand above: widen search_hz or mend the fit"
        )
    furthest = max(reached, key=lambda name: reached[name].recommended.crossing_hz.min())
    chosen = list(dict.fromkeys([next(iter(reached)), furthest]))
    panels = {
        f"{name}, $S_O$": (reached[name].loops, reached[name].recommended.controller, "output_sensitivity")
        for name in chosen
    }
    low, high = machine.resonances_hz[0] / 80, 1.2 * machine.resonances_hz[-1]
    return paint_over_masses(panels, low_hz=low, high_hz=high, label="sensor")


def machine_explorer(
    machine: Machine, intensities: Intensities, retained: int, selectivity: float
) -> Callable:
    """Explorer: what the controller sees at the last sensor, bare and with MC and AD."""
    last = machine.sensors[-1]
    low, high = machine.resonances_hz[0] * 0.05, machine.resonances_hz[-1] * 1.2
    shown = resonance_grid(last.poles, low, high, 200, 16)  # coarse enough to redraw quickly
    plant = last.frequency_response(shown)[0, 0]
    flexible = shown > np.pi * machine.resonances_hz[0]  # from half of the first resonance on

    def paint(damping: float, drift: float):
        moved = Intensities(intensities.disturbance, intensities.sensor, drift)
        application = Application(compensate=True, damping=damping, selectivity=selectivity)
        settings = observer_settings(machine, application, retained, moved)
        used = observing_compensator(last, application, *settings)
        seen = LoopResponse(plant, used.frequency_response(shown), np.zeros_like(plant)).equivalent_plant
        figure, axes = paint_bode(
            {"plant": (shown, plant), "with MC and AD": (shown, seen)}, "magnitude (dB re 1 m/N)", height=3.2
        )
        lowered = 20 * np.log10(np.abs(plant[flexible]).max() / np.abs(seen[flexible]).max())
        axes[0].set_title(f"the highest peak is {lowered:.0f} dB lower")
        return figure

    return paint
