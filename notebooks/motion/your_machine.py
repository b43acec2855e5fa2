"""Pictures of a machine of one's own (notebook 29)."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

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
from stillwork.machine.machine_designs import Designed
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


def modes_table(machine: Machine) -> pd.DataFrame:
    """Frequencies, damping and shares of the rigid body, with intervals of 95 % where there was a fit."""
    flexible = machine.sensors[0].modes(slice(1, None))
    share = flexible.input_shapes[:, 0] * flexible.output_shapes[0] * machine.mass
    columns = {
        "frequency (Hz)": machine.resonances_hz.round(1),
        "damping (%)": (100 * flexible.damping).round(3),
        "share of the rigid body": share.round(3),
    }
    count = len(flexible.frequencies)
    if machine.fit is not None:
        columns["± (Hz)"] = (1.96 * machine.fit.deviation[-count:] / (2 * np.pi)).round(2)
        columns["± (%)"] = (196 * machine.fit.damping_deviation[-count:]).round(3)
    return pd.DataFrame(columns, index=range(1, count + 1))


def reached_table(made: Designed) -> pd.DataFrame:
    """How far every use gets, on the model and on the measurement, and whose design it takes."""
    shown = ("on the model (Hz)", "on the measurement (Hz)", "extra turns")
    rows = {
        use: {name: each.summary[name] for name in shown if name in each.summary}
        | {"design": f"as {made.same[use]}" if use in made.same else "own"}
        for use, each in made.found.items()
    }
    return pd.DataFrame(rows).T


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
    highest = max((hz for line in axis.lines for hz in line.get_ydata()), default=1.0)
    axis.set(xlim=(-0.5, len(found) - 0.4), ylim=(0, 1.1 * highest), ylabel="first crossing (Hz)")
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


def appendix(page, *, made: Designed, machine: Machine) -> None:
    """What the page of motion/29 shows beside its answer."""
    page.text("""## Where the modes come from

Candidates are the poles that stay when the order of a polynomial fraction grows (poly-reference least-squares complex frequencies).
A candidate becomes a mode if the fit without it errs by 50 % over its width, if noise could not have made it, and if it does not
merely cancel another; `modes_hz` overrides that. The mass follows from the lines below half the first resonance, and includes a
free body's rotation at the force. A response against the direction of the force gets the other sign.""")
    if machine.fit is not None:
        page.save("stabilisation", designing.paint_stabilisation(machine.fit))
    page.show(f"{machine.source}:", *machine.notes)
    page.text("## What stops each loop")
    page.show(*made.lines())
    page.text("## Output sensitivity at the limit")
    page.save("sensitivities", paint_sensitivities(made.found, machine))
    peaks = [
        size
        for each in made.found.values()
        for pair in each.peaks_db().values()
        for size in pair
        if size is not None
    ]
    page.check("motion.your-machine.recommended", max([0.0, *(size - 6.0 for size in peaks)]))
