"""What figures of several notebooks share: names and colours, magnitudes in dB, Bode diagrams, loop functions, and numbers read off their lines."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from experiments.motion.machines import parameters
from stillwork.control.bandwidth import SIX_DB, Loop
from stillwork.control.pid import Pid
from stillwork.control.setpoint import Setpoint
from workbook import figures

LABELS = {
    "input_sensitivity": "input sensitivity $S_I$",
    "output_sensitivity": "output sensitivity $S_O$",
    "true_tracking": r"$r$ to $e_{true}$",
}


# One colour a use of the observer, in every figure.
_WITHOUT = ("PID", "PID with notches", "no observer", "original", "plant", "plant $P$")
CASES = dict.fromkeys(_WITHOUT, figures.BLACK) | dict.fromkeys(("MC", "compensated $P_{eq}$"), figures.BLUE)
CASES |= {"AD": figures.GREEN, "MC and AD": figures.RED}


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
    """Add the magnitude in dB of a response over frequencies (rad/s) in Hz."""
    if axis.get_xscale() != "log":  # `semilogx` makes the axis anew for each line, and explorers draw many
        axis.set_xscale("log")
    axis.plot(np.asarray(omega) / (2 * np.pi), decibel(response), **style)


def mark_limit(axis) -> None:
    """The peak that the thesis allows, 6 dB."""
    axis.axhline(20 * np.log10(SIX_DB), color=figures.BLACK, linestyle=":", linewidth=1.0)


def mark_printed(axis, x: float, label: str, at: float = 0.97) -> None:
    """A printed frequency (or time) as a dashed line over a panel, named beside it at a height in parts of the panel's."""
    ends = axis.get_ylim()
    axis.plot([x, x], ends, color=figures.BLACK, linewidth=1.1, linestyle=(0, (6, 2)), label=label)
    axis.set_ylim(ends)
    place = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "rotation": 90}
    axis.annotate(
        label, (x, at), (-2, 0), ha="right", va="top" if at > 0.5 else "bottom", fontsize=7, **place
    )


def mark_slope(axis, slope: float, hertz: tuple[float, float], level: float, label: str) -> None:
    """A printed slope as a line in dB between two frequencies, from `level` at the lower one."""
    ends = [level, level + 20 * slope * np.log10(hertz[1] / hertz[0])]
    axis.plot(hertz, ends, color=figures.BLACK, linewidth=1.1, linestyle=(0, (6, 2)), label=label)


def add_zoom(
    axis, place: Sequence[float] | np.ndarray, x: tuple[float, float], y: tuple[float, float]
) -> None:
    """Repeat a panel's labelled lines from `x` to `y` in an inset at `place`: left, bottom, width, height in parts."""
    inset = axis.inset_axes(place, xlim=x, ylim=y)
    for line in axis.get_legend_handles_labels()[0]:
        style = {
            "color": line.get_color(),
            "linestyle": line.get_linestyle(),
            "linewidth": line.get_linewidth(),
        }
        inset.plot(*line.get_data(), **style)
    inset.tick_params(labelsize=6)
    lines = axis.indicate_inset_zoom(inset, edgecolor=figures.BLACK).connectors
    # The two of four that do not cross: Matplotlib's own choice takes the frame's data for its place.
    axis.get_xlim(), axis.get_ylim()  # as they will be
    frame = (axis.transScale + axis.transLimits).transform([(x[0], y[0]), (x[1], y[1])])
    left, bottom, width, height = place
    (x0, y0), (x1, y1) = (frame < [(left, bottom), (left + width, bottom + height)]).tolist()
    for line, shown in zip(lines, (x0 != y0, x0 == y1, x1 == y0, x1 != y1), strict=True):
        line.set_visible(shown)


def plain_numbers(axis) -> None:
    """Numbers beside a logarithmic axis of about a decade as 6 and 20, not as multiples of powers of ten."""
    from matplotlib.ticker import LogFormatter

    axis.set_major_formatter(LogFormatter())
    axis.set_minor_formatter(LogFormatter())


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


def paint_bode(
    curves: Mapping[str, tuple[np.ndarray, np.ndarray]],
    quantity: str,
    *,
    phase: bool = False,
    unwrap: bool = True,
    styles: Mapping[str, dict] | None = None,
    height: float | None = None,
    **limits: tuple[float, float],
):
    """Magnitude (and phase) of single responses, by label (omega in rad/s, response), on one pair of axes.

    Without `unwrap` the phase stays between -270 and 90 degrees. `limits` of the magnitude: `xlim` in Hz, `ylim` in dB.
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
    axes[0].set(**limits)
    axes[-1].set_xlabel("frequency (Hz)")
    axes[0].legend()
    return figure, axes


def paint_limited(
    panels: Mapping[str, Mapping[str, tuple]], bottom: float, top: float, height: float, rows: int = 1
):
    """Magnitudes of loop functions, a panel a title, with the allowed peak."""
    figure, axes = paint_magnitudes(panels, "magnitude (dB)", rows, height=height, sharex=True, sharey=True)
    for axis in axes.ravel():
        mark_limit(axis)
        axis.set_ylim(bottom, top)
        place = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points", "fontsize": 7}
        axis.annotate("limit, 6 dB", (0, 20 * np.log10(SIX_DB)), (3, 2), **place)
    axes[0, 0].legend(ncols=2, loc="lower right", fontsize=7)
    return figure


def magnitudes_over_masses(
    panels: Mapping[str, tuple[Sequence[Loop], Pid, str]],
    low_hz: float = 1.0,
    high_hz: float = 2e3,
    label: str = "mass",
) -> dict[str, dict[str, tuple]]:
    """The lines of `paint_over_masses`, as `paint_magnitudes` takes them."""
    curves = {title: {} for title in panels}
    responses = {}  # of a loop with a controller: panels often show two functions of it
    for title, (loops, controller, function) in panels.items():
        for number, loop in enumerate(loops, 1):
            hertz = loop.omega / (2 * np.pi)
            shown = (hertz >= low_hz) & (hertz <= high_hz)
            if (known := (id(loop), id(controller))) not in responses:
                responses[known] = loop.at(controller)
            response = getattr(responses[known], function)[shown]
            curves[title][f"{label} {number}"] = loop.omega[shown], response, {"linewidth": 1.0}
    return curves


def paint_over_masses(
    panels: Mapping[str, tuple[Sequence[Loop], Pid, str]],
    *,
    low_hz: float = 1.0,
    high_hz: float = 2e3,
    bottom: float = -50.0,
    label: str = "mass",
    zoom: tuple | None = None,
):
    """One loop function of every measured mass, a panel per case (loops, controller, function), with the allowed peak.

    `zoom` is what `add_zoom` needs for an inset in every panel.
    """
    curves = magnitudes_over_masses(panels, low_hz, high_hz, label)
    figure = paint_limited(curves, bottom, 15, 3.2)
    if zoom:
        for axis in figure.axes:
            add_zoom(axis, *zoom)
    return figure


def plain(panels: int = 1, height: float = 2.8, **margins: float):
    """Panels beside each other without the constrained layout, which takes longer than an explorer may."""
    figure, axes = figures.new(1, panels, height=height)
    figure.set_layout_engine(None)
    figure.subplots_adjust(**{"left": 0.1, "bottom": 0.18, "right": 0.98, "top": 0.9} | margins)
    return figure, axes


def paint_setpoint(setpoint: Setpoint, rows: Sequence[int] = range(5), height: float = 6.4):
    """The move and its derivatives, by their order, a panel each, with settling, the scan and the printed limits of Table 3.6."""
    printed = parameters("setpoint")
    limits = (0.17, *(printed[name] for name in ("velocity", "acceleration", "jerk", "snap")))
    names = ("position (m)", "velocity (m/s)", "acceleration (m/s²)", "jerk (m/s³)", "snap (m/s⁴)")
    settling = (setpoint.acceleration_end, setpoint.scan[0])
    figure, axes = figures.new(len(rows), 1, height=height, sharex=True)
    for axis, row in zip(axes, rows, strict=True):
        line = setpoint.derivatives[row]
        axis.plot(setpoint.time, line, label=names[row])
        axis.axvspan(*settling, color=figures.YELLOW, alpha=0.25, linewidth=0, label="settling")
        axis.axvspan(*setpoint.scan, color=figures.GREY, alpha=0.12, linewidth=0, label="scan")
        highest = setpoint.time[np.argmax(line > 0.9999 * line.max())]
        figures.mark_published(axis, highest, limits[row], "printed limit")
        axis.set_ylabel(names[row].replace(" (", "\n("))
    axes[-1].set_xlabel("time (s)")
    axes[1].legend(handles=[*axes[1].patches, axes[1].lines[1]], loc="lower center")
    figure.align_ylabels()
    return figure


def paint_errors(setpoint: Setpoint, errors: Mapping[str, np.ndarray], title: str = ""):
    """Tracking errors in nm over the move by label, the scan in grey: what explorers show."""
    figure, axis = figures.new(1, 1, height=2.8)
    for label, error in errors.items():
        axis.plot(setpoint.time, 1e9 * error, linewidth=0.9, label=label)
    axis.axvspan(*setpoint.scan, color=figures.GREY, alpha=0.12, linewidth=0)
    axis.set_title(title)
    figures.label(axis, "time (s)", "error (nm)")
    axis.legend(fontsize=7)
    return figure


def labelled_lines(axis) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """What a panel shows: x and y of its labelled lines, by label."""
    return {
        label: tuple(np.asarray(values, dtype=float) for values in line.get_data())
        for line in axis.lines
        if not (label := str(line.get_label())).startswith("_")
    }


def turning_points(x: np.ndarray, level: np.ndarray, kind: str) -> np.ndarray:
    """Where a line in dB has its ``peaks`` or ``dips`` of at least 0.1 dB."""
    from scipy.signal import find_peaks

    return x[find_peaks(level if kind == "peaks" else -level, prominence=0.1)[0]]


def depth(axis, label: str, at: float) -> float:
    """How far a line dips within 3 % of `at`, below its lower value at 10 % to either side (dB)."""
    x, level = labelled_lines(axis)[label]
    beside = np.interp([0.9 * at, 1.1 * at], x, level).min()
    return float(beside - level[np.abs(x / at - 1) < 0.03].min())


def highest(axis, low: float = 0.0, high: float = np.inf) -> np.ndarray:
    """Place and height of the largest value of each line of a panel, for x from `low` to `high`: (lines, 2)."""
    parts = [(x, np.where((x >= low) & (x <= high), y, -np.inf)) for x, y in labelled_lines(axis).values()]
    return np.array([(x[y.argmax()], y.max()) for x, y in parts])
