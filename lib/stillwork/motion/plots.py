"""Figures of the motion room that more than one notebook draws, and the drawings behind its explorers."""

from collections.abc import Mapping, Sequence

import numpy as np

from stillwork import figures
from stillwork.lti import StateModel
from stillwork.motion.applications import Application
from stillwork.motion.bandwidth import SIX_DB, Loop
from stillwork.motion.controller import Pid, PidFamily
from stillwork.motion.designs import Design, stage_loops
from stillwork.motion.loops import channel
from stillwork.motion.machines import stage_mass

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
            axis.semilogx(hertz[shown], decibel(response)[shown], label=f"mass {number}", linewidth=1.0)
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
    rows = (len(sources) + 1) // 2
    figure, axes = figures.new(rows, 2, sharex=True, squeeze=False)
    names = {"u_ff": "$u_{ff}$", "w": "$w$", "v": "$v$", "d": "$d$", "r": "$r$"}
    for axis, source in zip(axes.ravel(), sources, strict=False):
        for number, (label, loop) in enumerate(cases.items()):
            response = channel(loop, source, "e_true").frequency_response(omega)[0, 0]
            # The differences are local: the first case lies broad and grey below the others.
            style = {"color": figures.GREY, "linewidth": 2.5} if number == 0 else {"linewidth": 1.0}
            axis.semilogx(omega / (2 * np.pi), decibel(response), label=label, **style)
        axis.set_title(f"{names[source]} to $e_{{true}}$")
        axis.set_ylabel("dB re 1 m/N" if source in ("u_ff", "w") else "dB")
    for axis in axes.ravel()[len(sources) :]:
        axis.set_axis_off()
    for axis in axes[-1]:
        axis.set_xlabel("frequency (Hz)")
    axes[0, 0].legend(loc="lower center", fontsize=7)
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
