"""Figures that more than one chapter of the motion room draws."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from experiments.motion.loop_conditions import slope
from stillwork.base.rounding import in_order
from stillwork.control.bandwidth import SIX_DB, Loop
from stillwork.control.loops import channel
from stillwork.control.pid import Pid
from stillwork.lti.state_space import StateModel
from stillwork.workbook import figures

LABELS = {
    "input_sensitivity": "input sensitivity $S_I$",
    "output_sensitivity": "output sensitivity $S_O$",
    "true_tracking": r"$r$ to $e_{true}$",
}

# One colour a use of the observer, in every figure.
CASES = {
    "PID": figures.BLACK,
    "PID with notches": figures.BLACK,
    "no observer": figures.BLACK,
    "original": figures.BLACK,
    "plant": figures.BLACK,
    "plant $P$": figures.BLACK,
    "MC": figures.BLUE,
    "compensated $P_{eq}$": figures.BLUE,
    "AD": figures.GREEN,
    "MC and AD": figures.RED,
}


def case_styles(labels: Iterable[str]) -> dict[str, dict]:
    """Line options by label where every label names a case, dashed for a redesigned controller; else none."""
    styles = {}
    for label in labels:
        name, _, controller = label.removeprefix("with ").partition(", ")
        if name not in CASES or controller not in ("", "original", "redesigned"):
            return {}
        styles[label] = {"color": CASES[name], "linestyle": "--" if controller == "redesigned" else "-"}
    return styles


def decibel(response) -> np.ndarray:
    """Magnitude in dB."""
    return 20 * np.log10(np.abs(response))


def add_magnitude(axis, omega, response, **style) -> None:
    """Draw the magnitude in dB of a response over frequencies (rad/s) in Hz."""
    axis.semilogx(np.asarray(omega) / (2 * np.pi), decibel(response), **style)


def paint_bode(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]],
    quantity: str,
    *,
    phase: bool = False,
    unwrap: bool = True,
    styles: Mapping[str, dict] | None = None,
    height: float | None = None,
    xlim: tuple[float, float] | None = None,
    ylim: tuple[float, float] | None = None,
):
    """Magnitude (and phase) of single responses, by label (omega in rad/s, response), on one pair of axes.

    Without `unwrap` the phase stays between -270 and 90 degrees. `xlim` in Hz, `ylim` in dB.
    """
    from matplotlib.ticker import MultipleLocator

    figure, axes = figures.new(1 + phase, 1, height=height, sharex=True, squeeze=False)
    axes = axes[:, 0]
    styles = case_styles(curves) if styles is None else styles
    for label, (omega, response) in curves.items():
        style = styles.get(label, {})
        hertz = np.asarray(omega) / (2 * np.pi)
        axes[0].semilogx(hertz, decibel(response), label=label, **style)
        if phase:
            angle = np.degrees(np.angle(response))
            if unwrap:
                angle = np.unwrap(angle, period=360)
                angle -= 360 * np.ceil(angle[0] / 360 - 1e-6)  # start between -360 and 0 degrees
            else:
                angle = (angle + 270) % 360 - 270
            axes[1].semilogx(hertz, angle, label=label, **style)
    axes[0].set_ylabel(quantity)
    if phase:
        axes[1].set_ylabel("phase (deg)")
        axes[1].yaxis.set_major_locator(MultipleLocator(180))
    axes[0].set(**{name: ends for name, ends in (("xlim", xlim), ("ylim", ylim)) if ends})
    axes[-1].set_xlabel("frequency (Hz)")
    axes[0].legend()
    return figure, axes


def plain(panels: int = 1, height: float = 2.8, **margins: float):
    """Panels beside each other without the constrained layout, which takes longer than an explorer may."""
    figure, axes = figures.new(1, panels, height=height)
    figure.set_layout_engine(None)
    figure.subplots_adjust(**{"left": 0.1, "bottom": 0.18, "right": 0.98, "top": 0.9} | margins)
    return figure, axes


def drawn(axis) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What a panel shows: x and y of its labelled lines, by label."""
    lines = {str(line.get_label()): line.get_data() for line in axis.lines}
    return {
        label: tuple(np.asarray(values, dtype=float) for values in data)
        for label, data in lines.items()
        if not label.startswith("_")
    }


def highest(axis, low: float = 0.0, high: float = np.inf) -> np.ndarray:
    """Place and height of the largest value of each line of a panel, for x from `low` to `high`: (lines, 2)."""
    parts = [(x, np.where((x >= low) & (x <= high), y, -np.inf)) for x, y in drawn(axis).values()]
    return np.array([(x[y.argmax()], y.max()) for x, y in parts])


def drawn_slope(axis, label: str, low: float, high: float) -> float:
    """Slope of a line in dB between two x, in decades a decade."""
    x, level = drawn(axis)[label]
    part = (x >= low) & (x <= high)
    return slope(x[part], 10 ** (level[part] / 20))


def plain_numbers(axis) -> None:
    """Numbers beside a logarithmic axis of about a decade as 6 and 20, not as multiples of powers of ten."""
    from matplotlib.ticker import LogFormatter

    axis.set_major_formatter(LogFormatter())
    axis.set_minor_formatter(LogFormatter())


def mark_limit(axis) -> None:
    """The peak that the thesis allows, 6 dB."""
    axis.axhline(20 * np.log10(SIX_DB), color=figures.BLACK, linestyle=":", linewidth=1.0)


def paint_magnitudes(
    panels: Mapping[str, Mapping[str, tuple]], quantity: str = "", rows: int = 1, **options
) -> tuple:
    """Magnitudes in dB, a panel a title, each from label to (omega in rad/s, response, line options): figure, axes."""
    figure, axes = figures.new(rows, len(panels) // rows, squeeze=False, **options)
    for axis, (title, lines) in zip(axes.ravel(), panels.items(), strict=True):
        for label, (omega, response, style) in lines.items():
            add_magnitude(axis, omega, response, label=label, **style)
        axis.set_title(title)
    figures.label(axes, "frequency (Hz)", quantity)
    return figure, axes


def paint_limited(
    panels: Mapping[str, Mapping[str, tuple]], bottom: float, top: float, height: float, rows: int = 1
):
    """Magnitudes of loop functions, a panel a title, with the allowed peak."""
    figure, axes = paint_magnitudes(panels, "magnitude (dB)", rows, height=height, sharex=True, sharey=True)
    for axis in axes.ravel():
        mark_limit(axis)
        axis.set_ylim(bottom, top)
    axes[0, 0].legend(ncols=2, loc="lower right", fontsize=7)
    return figure


def paint_over_masses(
    panels: Mapping[str, tuple[Sequence[Loop], Pid, str]],
    *,
    low_hz: float = 1.0,
    high_hz: float = 2e3,
    bottom: float = -50.0,
    label: str = "mass",
):
    """One loop function of every measured mass, a panel a case (loops, controller, function), with the allowed peak."""
    curves = {title: {} for title in panels}
    for title, (loops, controller, function) in panels.items():
        for number, loop in enumerate(loops, 1):
            hertz = loop.omega / (2 * np.pi)
            shown = (hertz >= low_hz) & (hertz <= high_hz)
            response = getattr(loop.at(controller), function)[shown]
            curves[title][f"{label} {number}"] = loop.omega[shown], response, {"linewidth": 1.0}
    return paint_limited(curves, bottom, 15, 3.2)


def paint_rejections(
    cases: Mapping[str, StateModel], omega: np.ndarray, sources: Sequence[str] = ("u_ff", "w", "v", "d")
):
    """Transfers from each disturbance to the true error for several closed loops, one panel a disturbance."""
    from matplotlib.ticker import NullFormatter

    rows = (len(sources) + 1) // 2
    figure, axes = figures.new(rows, 2, sharex=True, squeeze=False)
    colours = case_styles(cases)
    names = {"u_ff": "$u_{ff}$", "w": "$w$", "v": "$v$", "d": "$d$", "r": "$r$"}
    for axis, source in zip(axes.ravel(), sources, strict=False):
        for number, (label, loop) in enumerate(cases.items()):
            response = channel(loop, source, "e_true").frequency_response(omega)[0, 0]
            # The differences are local: the first case lies broad and grey below the others.
            style = {"color": figures.GREY, "linewidth": 2.5} if number == 0 else {"linewidth": 1.0}
            style |= {"linestyle": "--" if number > 1 else "-"}
            style |= {"color": colours[label]["color"]} if number and colours else {}
            add_magnitude(axis, omega, response, label=label, **style)
        axis.set_title(f"{names[source]} to $e_{{true}}$")
        axis.set_ylabel("magnitude (dB re 1 m/N)" if source in ("u_ff", "w") else "magnitude (dB)")
    figures.label(axes, "frequency (Hz)")
    for axis in axes[-1]:
        axis.xaxis.set_minor_formatter(NullFormatter())
    for axis in axes.ravel()[len(sources) :]:
        axis.set_axis_off()
    figures.legend_below(axes[0, 0], len(cases))
    return figure


def paint_controllers(cases: Mapping[str, tuple[Loop, Pid]], omega: np.ndarray):
    """Equivalent controllers of several loops, from r and from y to the plant input, with their phase."""
    figure, axes = figures.new(2, 2, sharex=True, sharey="row", height=4.6)
    styles = case_styles(cases)
    for label, (loop, controller) in cases.items():
        style = {"label": label, **styles.get(label, {})}
        response = loop.at(controller, omega)
        for column, c in enumerate((response.reference_controller, response.output_controller)):
            add_magnitude(axes[0, column], omega, c, **style)
            phase = np.degrees(np.unwrap(np.angle(c)))
            axes[1, column].semilogx(omega / (2 * np.pi), phase - 360 * np.round(phase[0] / 360), **style)
    for axis, title in zip(axes[0], ("from $r$", "from $y$ (sign turned)"), strict=True):
        axis.set_title(title)
    axes[0, 0].set_ylabel("magnitude (dB re 1 N/m)")
    axes[1, 0].set_ylabel("phase (deg)")
    figures.label(axes, "frequency (Hz)")
    axes[0, 0].legend(loc="best", fontsize=7)
    return figure


def paint_pole_zero(systems: Mapping[str, StateModel]):
    """Poles and zeros in the upper half-plane beside the magnitude, for systems with a few modes."""
    figure, axes = figures.new(1, 2, height=3.2)
    colours = [figures.BLUE, figures.GREEN, figures.RED]
    top = max(np.abs(system.poles).max() for system in systems.values())
    omega = np.geomspace(top / 30, top * 2, 1500)
    for colour, (label, system) in zip(colours, systems.items(), strict=True):
        for kind, marker, values in (("poles", "x", system.poles), ("zeros", "o", system.zeros)):
            values = top * in_order(values / top)
            upper = values[(values.imag >= -1e-6) & (np.abs(values) < 3 * top)]
            style = {"color": colour, "markerfacecolor": "none"}
            axes[0].plot(upper.real, upper.imag / (2 * np.pi), marker, label=f"{label}, {kind}", **style)
        add_magnitude(axes[1], omega, system.frequency_response(omega)[0, 0], color=colour, label=label)
    axes[0].set(xlabel="real part (1/s)", ylabel="imaginary part (Hz)")
    axes[0].legend(fontsize=7)
    axes[1].set(xlabel="frequency (Hz)", ylabel="magnitude (dB re 1 m/N)")
    axes[1].legend(fontsize=7)
    return figure
