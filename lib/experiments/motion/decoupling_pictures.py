"""Figures of the decoupled machine: every entry of a transfer matrix in its place."""

from collections.abc import Mapping

import numpy as np

from experiments.motion.beam import beam, beam_parameters
from experiments.motion.decoupling_schemes import Settings, actuators_of, published_settings, with_scheme
from experiments.motion.pictures import decibel, plain
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.state_space import StateModel
from workbook import figures

COLOURS = (figures.BLUE, figures.GREEN, figures.RED, figures.ORANGE)

ROUNDING_DB = -240.0  # an entry that is everywhere this far below the largest one is not drawn


def paint_transfer_matrix(
    systems: Mapping[str, StateModel],
    *,
    slopes: Mapping[tuple[int, int], float] | None = None,
    signals: tuple[str, str] = ("u", "q"),
    quantity: str = "magnitude (dB re 1 s²)",
    low_hz: float = 1.0,
):
    """Magnitudes of several systems with two inputs and two outputs, one panel per entry; the first drawn broad.

    `slopes` are the published slopes of some entries (row, column), drawn as a guide beside the last system.
    """
    poles = np.concatenate([system.poles for system in systems.values()])
    omega = resonance_grid(poles[np.abs(poles) > 2 * np.pi * low_hz], low_hz, 2e3, 250, 25)
    hertz = omega / (2 * np.pi)
    figure, axes = figures.new(2, 2, height=5.0, sharex=True, squeeze=False)
    for number, (name, system) in enumerate(systems.items()):
        response = decibel(system.frequency_response(omega))
        style = {"color": COLOURS[number], "linewidth": 1.1, "linestyle": "--" if number > 1 else "-"}
        if not number:
            style |= {"linewidth": 2.4, "alpha": 0.55}
        for place, axis in np.ndenumerate(axes):
            if np.any(response[place] > ROUNDING_DB + response.max(axis=(0, 1))):
                axis.semilogx(hertz, response[place], label=name, **style)
    low = (hertz >= 1.5 * low_hz) & (hertz <= 8 * low_hz)
    for place, value in (slopes or {}).items():
        axis, text = axes[place], f"published slope {value:+g}" if value else "published slope 0"
        start = response[place][low][0] + (12 if value else -15)  # response is that of the last system
        guide = start + 20 * value * np.log10(hertz[low] / hertz[low][0])
        axis.semilogx(hertz[low], guide, color=figures.BLACK, linestyle=":", label=text)
        axis.annotate(
            text, (hertz[low][-1], guide[-1]), (3, 0), textcoords="offset points", va="center", fontsize=7
        )
    source, target = signals
    for (row, column), axis in np.ndenumerate(axes):
        axis.set_title(f"{source}{column + 1} to {target}{row + 1}")
        if not axis.lines:
            axis.annotate("zero up to rounding", (0.5, 0.5), xycoords="axes fraction", ha="center")
            axis.set_yticks([])
    figures.label(axes, "frequency (Hz)", quantity)
    figure.align_ylabels(axes[:, 0])
    figure.legend(
        axes[0, 0].lines[: len(systems)], list(systems), loc="outside lower center", ncols=len(systems)
    )
    return figure


def paint_slope_ranges(
    slopes: Mapping[str, np.ndarray],
    above: Mapping[str, np.ndarray],
    published: Mapping[str, tuple[float, float]],
):
    """Slopes of both off-diagonal entries over the machines of a study, one row a scheme, with the published ones.

    `slopes` in the limit and `above`, at 0.03 to 0.3 Hz, have shape (runs, 2, 2), and are the same where the limit is
    only rounding: that is drawn once. `published` are those of q1 from u2 and of q2 from u1.
    """
    figure, axes = figures.new(1, 2, height=0.34 * len(slopes) + 1.6, sharey=True)
    rows = np.arange(len(slopes))
    entries = (("u2 to q1", (0, 1)), ("u1 to q2", (1, 0)))
    for number, (axis, (title, place)) in enumerate(zip(axes, entries, strict=True)):
        for row, name in zip(rows, slopes, strict=True):
            kinds = [(above, 0.24, figures.ORANGE, "machines, 0.03 to 0.3 Hz")]
            if not np.array_equal(slopes[name], above[name]):
                kinds.append((slopes, -0.24, figures.BLUE, "machines, in the limit"))
            for values, offset, colour, label in kinds:
                value = values[name][(slice(None), *place)]
                at = (
                    row + offset + np.linspace(-0.14, 0.14, len(value))
                )  # a machine a height: none hides another
                axis.plot(value, at, ".", color=colour, markersize=2, label=label)
        figures.mark_published(axis, [published[name][number] for name in slopes], rows)
        least = min(min(pair) for pair in published.values())
        axis.set(title=title, xlabel="slope (decades per decade)", xlim=(least - 0.3, 0.3))
    axes[0].set_yticks(rows, list(slopes))
    axes[0].invert_yaxis()
    shown = {line.get_label(): line for line in axes[0].lines}
    names = ["machines, in the limit", "machines, 0.03 to 0.3 Hz", "published"]
    texts = [names[0] + ", 1 to 10 µHz", *names[1:]]
    figure.legend([shown[name] for name in names], texts, loc="outside lower center", ncols=3, markerscale=2)
    return figure


def paint_decoupling(scheme: str, increase: float, selectivity: float, second: float, taper: float):
    """Explorer: the off-diagonal entries with one scheme for another place of the second actuator."""
    places = beam_parameters()["assumed"]
    actuators = [places["actuators"][0], second, *places["actuators"][2:]]
    machine = beam(actuators, places["sensors"], taper=taper)
    plant = machine.at(range(actuators_of(scheme, machine)), range(2))
    printed = published_settings()
    settings = Settings(increase, printed.damped, selectivity, printed.stiffness_factor, selectivity)
    figure, axis = plain(left=0.09, top=0.95)
    omega = resonance_grid(plant.poles, 1.0, 2e3, 120, 12)
    for name, colour in (("undamped", figures.GREY), (scheme, figures.BLUE)):
        response = decibel(with_scheme(name, plant, settings).frequency_response(omega))
        for entry, style, place in (("u2 to q1", "-", (0, 1)), ("u1 to q2", "--", (1, 0))):
            label = f"{name}, {entry}"
            axis.semilogx(omega / (2 * np.pi), response[place], style, color=colour, label=label)
    axis.set(xlabel="frequency (Hz)", ylabel="magnitude (dB re 1 s²)", ylim=(-220, -40))
    axis.legend(fontsize=7, ncols=2)
    return figure
