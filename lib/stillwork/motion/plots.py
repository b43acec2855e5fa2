"""Figures of the motion room that more than one notebook draws, and the drawings behind its explorers."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from stillwork import figures
from stillwork.checks import InputError
from stillwork.lti import ModalModel, StateModel, resonance_grid
from stillwork.motion.applications import Application
from stillwork.motion.bandwidth import SIX_DB, Loop, make_loop
from stillwork.motion.controller import Pid, PidFamily
from stillwork.motion.designs import Design, stage_compensator, stage_loops
from stillwork.motion.discretisation import VARIANTS, transition
from stillwork.motion.disturbance import CumulativePower, cumulative_power
from stillwork.motion.drive import drive_loop, seen_by_controller
from stillwork.motion.loops import channel, closed_loop
from stillwork.motion.machines import chain, drive, stage, stage_mass
from stillwork.motion.observer import published_noise
from stillwork.motion.performance import rms
from stillwork.motion.reduction import roll_off, truncate
from stillwork.motion.setpoint import Setpoint, published_setpoint
from stillwork.motion.structure import as_stage, fit_modes, measured_accelerance, structure_loops
from stillwork.motion.three_masses import scaled_springs, three_masses
from stillwork.motion.tracking import Feedforward, error_loop, tracking_error

LABELS = {
    "input_sensitivity": "input sensitivity $S_I$",
    "output_sensitivity": "output sensitivity $S_O$",
    "true_tracking": r"$r$ to $e_{true}$",
}


def decibel(response) -> np.ndarray:
    """Magnitude in dB."""
    return 20 * np.log10(np.abs(response))


def bode(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]],
    quantity: str,
    *,
    phase: bool = False,
    styles: Mapping[str, dict] | None = None,
    height: float | None = None,
):
    """Magnitude (and phase) of single responses on one pair of axes.

    Parameters
    ----------
    curves : mapping
        Label to (omega in rad/s, complex response).
    quantity : str
        Label of the magnitude axis, with its unit.
    phase : bool
        Add a panel with the phase.
    styles : mapping, optional
        Label to line options.
    height : float, optional
        Inches.

    Returns
    -------
    figure, axes
        The axes as an array of one or two.
    """
    from matplotlib.ticker import MultipleLocator

    figure, axes = figures.new(1 + phase, 1, height=height, sharex=True, squeeze=False)
    axes = axes[:, 0]
    for label, (omega, response) in curves.items():
        style = (styles or {}).get(label, {})
        hertz = np.asarray(omega) / (2 * np.pi)
        axes[0].semilogx(hertz, decibel(response), label=label, **style)
        if phase:
            angle = np.degrees(np.unwrap(np.angle(response)))
            angle -= 360 * np.ceil(angle[0] / 360 - 1e-6)  # start between -360 and 0 degrees
            axes[1].semilogx(hertz, angle, label=label, **style)
    axes[0].set_ylabel(quantity)
    if phase:
        axes[1].set_ylabel("phase (deg)")
        axes[1].yaxis.set_major_locator(MultipleLocator(180))
    axes[-1].set_xlabel("frequency (Hz)")
    axes[0].legend()
    return figure, axes


def over_masses(
    panels: Mapping[str, tuple[Sequence[Loop], Pid, str]],
    *,
    limit: float = SIX_DB,
    low_hz: float = 1.0,
    high_hz: float = 2e3,
    label: str = "mass",
):
    """One loop function of every measured mass, one panel a case, with the allowed peak.

    Parameters
    ----------
    panels : mapping
        Title to (loops, controller, name of the loop function).
    """
    figure, axes = figures.new(1, len(panels), height=3.2, sharey=True, squeeze=False)
    for axis, (title, (loops, controller, function)) in zip(axes[0], panels.items(), strict=True):
        for number, loop in enumerate(loops, 1):
            hertz = loop.omega / (2 * np.pi)
            shown = (hertz >= low_hz) & (hertz <= high_hz)
            response = getattr(loop.at(controller), function)
            axis.semilogx(hertz[shown], decibel(response)[shown], label=f"{label} {number}", linewidth=1.0)
        axis.axhline(20 * np.log10(limit), color=figures.BLACK, linestyle=":", linewidth=1.0)
        axis.set_title(title)
        axis.set_xlabel("frequency (Hz)")
        axis.set_ylim(-50, 15)
    axes[0, 0].set_ylabel("magnitude (dB)")
    axes[0, 0].legend(ncols=2, loc="lower right", fontsize=7)
    return figure


def rejections(
    cases: Mapping[str, StateModel], omega: np.ndarray, sources: Sequence[str] = ("u_ff", "w", "v", "d")
):
    """Transfers from each disturbance to the true error for several closed loops, one panel a disturbance.

    Parameters
    ----------
    cases : mapping
        Label to a single `closed_loop`.
    omega : ndarray
        rad/s.
    sources : sequence of str
        Inputs of `closed_loop`.
    """
    from matplotlib.ticker import NullFormatter

    rows = (len(sources) + 1) // 2
    figure, axes = figures.new(rows, 2, sharex=True, squeeze=False)
    names = {"u_ff": "$u_{ff}$", "w": "$w$", "v": "$v$", "d": "$d$", "r": "$r$"}
    for axis, source in zip(axes.ravel(), sources, strict=False):
        for number, (label, loop) in enumerate(cases.items()):
            response = channel(loop, source, "e_true").frequency_response(omega)[0, 0]
            # The differences are local: the first case lies broad and grey below the others.
            style = {"color": figures.GREY, "linewidth": 2.5} if number == 0 else {"linewidth": 1.0}
            style["linestyle"] = "--" if number > 1 else "-"
            axis.semilogx(omega / (2 * np.pi), decibel(response), label=label, **style)
        axis.set_title(f"{names[source]} to $e_{{true}}$")
        axis.set_ylabel("dB re 1 m/N" if source in ("u_ff", "w") else "dB")
    for axis in axes.ravel()[len(sources) :]:
        axis.set_axis_off()
    for axis in axes[-1]:
        axis.set_xlabel("frequency (Hz)")
        axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0, 0].legend(loc="best", fontsize=7)
    return figure


def controllers(cases: Mapping[str, tuple[Loop, Pid]], omega: np.ndarray):
    """Equivalent controllers of several loops, from r and from y to the plant input, with their phase."""
    figure, axes = figures.new(2, 2, sharex=True, sharey="row", height=4.6)
    for label, (loop, controller) in cases.items():
        response = loop.at(controller, omega)
        for column, c in enumerate((response.reference_controller, response.output_controller)):
            axes[0, column].semilogx(omega / (2 * np.pi), decibel(c), label=label)
            phase = np.degrees(np.unwrap(np.angle(c)))
            axes[1, column].semilogx(omega / (2 * np.pi), phase - 360 * np.round(phase[0] / 360), label=label)
    for axis, title in zip(axes[0], ("from $r$", "from $y$ (sign turned)"), strict=True):
        axis.set_title(title)
    axes[0, 0].set_ylabel("magnitude (dB re 1 N/m)")
    axes[1, 0].set_ylabel("phase (deg)")
    for axis in axes[1]:
        axis.set_xlabel("frequency (Hz)")
    axes[0, 0].legend(loc="upper center", fontsize=7)
    return figure


def pole_zero(systems: Mapping[str, StateModel], quantity: str = "magnitude (dB re 1 m/N)"):
    """Poles and zeros in the upper half-plane beside the magnitude, for systems with a few modes."""
    figure, axes = figures.new(1, 2, height=3.2)
    colours = [figures.BLUE, figures.GREEN, figures.RED]
    top = max(np.abs(system.poles).max() for system in systems.values())
    omega = np.geomspace(top / 30, top * 2, 1500)
    for colour, (label, system) in zip(colours, systems.items(), strict=True):
        for kind, marker, values in (("poles", "x", system.poles), ("zeros", "o", system.zeros)):
            upper = values[(values.imag >= -1e-6) & (np.abs(values) < 3 * top)]
            axes[0].plot(
                upper.real,
                upper.imag / (2 * np.pi),
                marker,
                color=colour,
                markerfacecolor="none",
                label=f"{label}, {kind}",
            )
        axes[1].semilogx(
            omega / (2 * np.pi), decibel(system.frequency_response(omega)[0, 0]), color=colour, label=label
        )
    axes[0].set_xlabel("real part (1/s)")
    axes[0].set_ylabel("imaginary part (Hz)")
    axes[0].legend(fontsize=7)
    axes[1].set_xlabel("frequency (Hz)")
    axes[1].set_ylabel(quantity)
    axes[1].legend(fontsize=7)
    return figure


def draw_design(
    bandwidth_hz: float,
    damping: float = 0.0,
    selectivity: float = 2.0,
    compensate: str = "no",
    noise_model: float = 0.03,
):
    """Explorer: S_I and S_O of the seven loops for one controller and one use of the observer."""
    used = damping > 0 or compensate == "yes"
    application = Application(compensate == "yes", damping, selectivity=selectivity) if used else None
    loops = stage_loops(Design(application, noise_model), points=250, around=8)
    controller = PidFamily(stage_mass())(bandwidth_hz)
    figure = over_masses(
        {LABELS[name]: (loops, controller, name) for name in ("input_sensitivity", "output_sensitivity")}
    )
    peaks = [
        max(loop.peak(controller, name).magnitude for loop in loops)
        for name in ("input_sensitivity", "output_sensitivity")
    ]
    stable = all(np.all(loop.poles(controller).real < 0) for loop in loops)
    for axis, peak in zip(figure.axes, peaks, strict=True):
        verdict = f"peak {20 * np.log10(peak):.1f} dB" if stable else "unstable"
        axis.set_title(f"{axis.get_title(loc='left')}: {verdict}")
    return figure


def draw_tracking(setpoint: Setpoint, errors: Mapping[str, np.ndarray]):
    """Tracking errors in nm over the move, one panel a case, with the scaled acceleration and the scan."""
    figure, axes = figures.new(2, 2, height=4.4, sharex=True, sharey=True)
    shown = setpoint.time <= setpoint.scan[1]
    scaled = setpoint.derivatives[2] / np.abs(setpoint.derivatives[2]).max()
    top = 1e9 * max(np.abs(error).max() for error in errors.values())
    for axis, (name, error) in zip(axes.ravel(), errors.items(), strict=True):
        axis.plot(
            setpoint.time, top * scaled, color=figures.GREY, linewidth=0.8, label="acceleration, scaled"
        )
        axis.plot(setpoint.time, 1e9 * error, linewidth=0.9, color=figures.BLUE, label="error")
        axis.axvspan(*setpoint.scan, color=figures.GREY, alpha=0.12, linewidth=0)
        axis.set_title(f"{name}: {1e9 * rms(error[setpoint.scanning]):.2f} nm rms in the scan")
    axes[0, 0].set_xlim(0, setpoint.time[shown][-1] + 0.02)
    axes[0, 0].legend(loc="upper right", fontsize=7)
    for axis in axes[:, 0]:
        axis.set_ylabel("error (nm)")
    for axis in axes[-1]:
        axis.set_xlabel("time (s)")
    return figure


def draw_feedforward(acceleration_kg: float, snap: float, bandwidth_hz: float):
    """Explorer: the error of the loop without observer for given feedforward gains."""
    setpoint = published_setpoint()
    controller = PidFamily(stage_mass())(bandwidth_hz).state_space()
    loop = error_loop(closed_loop(stage().at([0], [4]), None, controller))
    error = tracking_error(loop, setpoint, Feedforward(acceleration=acceleration_kg, snap=1e-6 * snap))
    figure, axis = figures.new(1, 1, height=2.8)
    axis.plot(setpoint.time, 1e9 * error, label="error")
    axis.axvspan(*setpoint.scan, color=figures.GREY, alpha=0.12, linewidth=0)
    axis.set_title(f"{1e9 * rms(error[setpoint.scanning]):.1f} nm rms in the scan (grey)")
    axis.set_xlabel("time (s)")
    axis.set_ylabel("error (nm)")
    return figure


def draw_cumulative(power: Mapping[str, CumulativePower], low_hz: float = 1.0):
    """Cumulative power of the measured and of the true error above `low_hz`, nm^2."""
    from matplotlib.ticker import NullFormatter

    figure, axes = figures.new(1, 2, height=3.2, sharey=True)
    for label, each in power.items():
        shown = each.omega >= 2 * np.pi * low_hz
        for axis, values in zip(axes, (each.measured, each.true), strict=True):
            axis.semilogx(each.omega[shown] / (2 * np.pi), 1e18 * values[shown], label=label)
    for axis, title in zip(axes, ("measured error $e_{meas}$", "true error $e_{true}$"), strict=True):
        axis.set_title(title)
        axis.set_xlabel("frequency (Hz)")
        axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("cumulative power (nm²)")
    axes[0].legend(loc="upper left")
    return figure


def draw_disturbance(bandwidth_hz: float, process_noise: float, damping: float):
    """Explorer: cumulative power of the errors at rest without observer and with active damping."""
    plant, step = stage().at([0], [4]), 1e-4
    controller = PidFamily(stage_mass())(bandwidth_hz).state_space()
    designs = {"PID": Design(), "AD": Design(Application(damping=damping, selectivity=2.0))}
    noise = {"w": process_noise, "v": 1e-9, "d": 1e-9}
    grid = resonance_grid(plant.poles, 0.01, 0.5 / step, 300, 15)
    power = {}
    for name, design in designs.items():
        loop = closed_loop(plant, stage_compensator(5, design), controller)
        if not loop.is_stable:
            raise InputError(f"{name} is unstable at {bandwidth_hz:g} Hz; lower the bandwidth")
        power[name] = cumulative_power(loop, step, noise, grid)
    return draw_cumulative(power)


def draw_reduction(retained: int, cutoff_hz: float):
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
    return bode(curves, "magnitude (dB re 1 m/N)", styles={"full": {"color": figures.GREY}}, height=3.2)[0]


def draw_heavy_mass(place: int, mass_kg: float):
    """Explorer: force to position at mass 1 of the five-mass chain with one mass changed."""
    masses = np.full(5, 1.6)
    masses[int(place) - 1] = mass_kg
    curves = {}
    for label, values in (("all 1.6 kg", np.full(5, 1.6)), (f"mass {int(place)}: {mass_kg:g} kg", masses)):
        machine = chain(values).at([0], [0])
        omega = resonance_grid(machine.poles, 5.0, 100.0, 300, 30)
        curves[label] = (omega, machine.frequency_response(omega)[0, 0])
    return bode(curves, "$f_1$ to $x_1$ (dB re 1 m/N)", height=3.2)[0]


def draw_transition_error(frequency_hz: float, damping: float):
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
    axis.set_xlabel("sample time (ms)")
    axis.set_ylabel("largest error, scaled entries")
    axis.legend()
    return figure


def draw_drive(stiffness_error: float, damping: float, bandwidth_hz: float):
    """Explorer: what the controller of the two-inertia drive sees, with an observer whose stiffness is off."""
    plant = drive()
    model = replace(plant, stiffness=plant.stiffness * (1 + stiffness_error))
    omega = 2 * np.pi * np.geomspace(2, 60, 400)
    cases = {
        "no observer": None,
        "MC": Application(compensate=True),
        "AD": Application(damping=damping),
        "MC and AD": Application(compensate=True, damping=damping),
    }
    curves = {
        name: (omega, seen_by_controller(drive_loop(plant, model, each, bandwidth_hz), omega))
        for name, each in cases.items()
    }
    return bode(curves, "magnitude (dB re 1 rad/A)", height=3.2)[0]


def draw_three_masses(bandwidth_hz: float):
    """Explorer: Nyquist plot of Example 1.5.1 for both sensor positions."""
    masses = np.full(3, 4.0)
    machine = three_masses(masses, scaled_springs(masses, 45.0))
    controller = PidFamily(masses.sum())(bandwidth_hz)
    return nyquist({f"$x_{k + 1}$": make_loop(machine.at([0], [k])) for k in (0, 1)}, controller)


def nyquist(loops: Mapping[str, Loop], controller: Pid):
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
    axis.set_xlim(-6, 6)
    axis.set_ylim(-6, 6)
    axis.set_aspect("equal")
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    axis.legend()
    return figure


@cache
def _fitted_structure() -> ModalModel:
    guesses = [810.0, 824.0, 851.0, 900.0, 1519.0, 2640.0, 3007.0]
    fit = fit_modes(measured_accelerance(1), guesses, (100.0, 3100.0))
    return as_stage(fit, stage_mass())[0]


def draw_structure(damping: float, noise_model: float):
    """Explorer: the mirrored sensor of the measured structure, bare and with MC and AD."""
    machine = _fitted_structure()
    application = Application(compensate=True, damping=damping, selectivity=2.0)
    bare = structure_loops(machine, None, 5, published_noise(), None)[1]
    used = structure_loops(machine, application, 5, published_noise(), noise_model)[1]
    controller = PidFamily(stage_mass())(45.0)
    omega = used.omega[(used.omega > 2 * np.pi * 100) & (used.omega < 2 * np.pi * 3000)]
    curves = {
        "plant": (omega, bare.at(controller, omega).equivalent_plant),
        "with MC and AD": (omega, used.at(controller, omega).equivalent_plant),
    }
    return bode(curves, "magnitude (dB re 1 m/N)", height=3.2)[0]
