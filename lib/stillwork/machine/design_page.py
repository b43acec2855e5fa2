"""The page of the command ``design``: the machine, the uses of an observer, the box, and the controller's loops."""

import html

import numpy as np

from stillwork.control.bandwidth import SIX_DB
from stillwork.control.digital import DigitalController
from stillwork.control.machine_loops import HELD, SHOWN, AchievableBandwidth
from stillwork.control.uncertainty import Uncertainty
from stillwork.identification.machine import Machine
from stillwork.identification.modal_fit import ModalFit
from stillwork.machine import pictures
from stillwork.machine.hardware import own_functions
from stillwork.machine.html_page import page, picture, table
from stillwork.machine.machine_designs import Designed

SHOWN_FROM = 0.01  # %, of what the box holds
MANY = 3  # modes, of more than which the least and the most uncertain are named


def box_table(machine: Machine, spread: Uncertainty, margins: dict[str, float]) -> list[list[str]]:
    """Widths of the box and the largest peaks in it, as rows; the box around another response differs by its fit alone."""
    rows = []
    hertz = machine.sensors[0].frequencies / (2 * np.pi)
    words = {"frequency": "resonances", "residue": "parts of the modes", "damping": "damping ratios"}
    for name, title in words.items():
        shares = 100 * np.asarray(getattr(spread, name))[1:]
        if np.any(shares >= SHOWN_FROM):
            if np.ptp(shares) < 0.05 * shares.max():
                rows.append([title, f"± {shares.max():.3g} %"])
            elif len(shares) > MANY:
                least, most = (
                    f"{shares.min():.2g}",
                    f"{shares.max():.2g} % (at {hertz[1 + shares.argmax()]:.4g} Hz)",
                )
                rows.append([title, f"± {least} to {most}"])
            else:
                each = [
                    f"± {share:.2g} % at {at:.4g} Hz" for share, at in zip(shares, hertz[1:], strict=True)
                ]
                rows.append([title, ", ".join(each)])
    for name, title in (("gain", "gain, motor constant"), ("mass", "mass")):
        if (share := 100 * getattr(spread, name)) >= SHOWN_FROM:
            rows.append([title, f"± {share:.2g} %"])
    if spread.delay > 1e-9:
        rows.append(["delay", f"± {1e6 * spread.delay:.2g} us"])
    if spread.friction > SHOWN_FROM / 100 * (drag := machine.sensors[0].drag):
        rows.append(
            [
                "viscous friction over mass",
                f"{max(drag - spread.friction, 0):.3g} to {drag + spread.friction:.3g} 1/s",
            ]
        )
    if margins:
        sizes = ", ".join(f"{SHOWN[name]} {20 * np.log10(size):.2f} dB" for name, size in margins.items())
        rows.append(
            ["largest in the box", f"{sizes}; modulus margin {1 / margins['output_sensitivity']:.3f}"]
        )
    return rows


def report(
    made: Designed,
    answer: list[str],
    controllers: list[DigitalController],
    peaks: dict[str, dict[str, float]],
    computed: list[tuple[str, str]],
    helps: list[list[str]] | None,
    box: list[list[str]],
    about: list,
    beyond: str,
) -> str:
    """One page: the answer, the machine, the bandwidth of each use of an observer, the peaks of the choice, and how to run it."""
    machine, reached = made.machine, made.found[made.ranking[0]]
    where = list(next(iter(peaks.values())))
    sizes = [[SHOWN[name], *(f"{peak[column]:.2f}" for column in where)] for name, peak in peaks.items()]
    shown = ", ".join(f"{hertz:.4g}" for hertz in machine.resonances_hz)
    facts = [
        ["mass" if machine.units[0] == "m" else "inertia", f"{machine.mass:.4g} {machine.mass_unit}"],
        ["resonances", f"{shown} Hz" if shown else f"none up to {machine.rigid_to_hz:.4g} Hz"],
        *map(list, about),
        *(["note", note] for note in machine.notes),
    ]
    changes = [["not searched: give --what-helps", "", ""]] if helps is None else helps
    return page(
        "design.html",
        source=html.escape(machine.source),
        kind=": a controller",
        answer="".join(f"<p>{html.escape(line)}</p>\n" for line in answer),
        facts=table([], facts),
        box=table([], box or [["everything", "exactly as in the model: no uncertainty was stated"]]),
        beyond=html.escape(beyond[:1].upper() + beyond[1:]),
        uses=uses_table(made),
        peaks=table(["peak", *where], sizes),
        computed=table([], list(map(list, computed))),
        helps=table(["change", "use", "bandwidth (Hz)"], changes or [["none of those tried", "", ""]]),
        machine=picture(paint_machine(machine), "accelerance of the model and of the measurement"),
        loops=picture(paint_loops(reached, controllers), "sensitivities of the sampled loop"),
    )


def uses_table(made: Designed) -> str:
    """Bandwidth of each use of an observer, or why it has none, and their order."""
    columns = list(dict.fromkeys(key for each in made.found.values() for key in each.summary))
    rows = [
        [use, *(each.summary.get(key, "") for key in columns), made.words(use).rstrip("; ") or each.reason]
        for use, each in made.found.items()
    ]
    words = "".join(f"<p>{html.escape(line)}</p>\n" for line in (*made.notes, made.ranking_line))
    return words + table(["use", *columns, "remark"], rows)


@pictures.house_style()
def paint_machine(machine: Machine):
    """Accelerance of the model at every sensor, and of the measurement at the first."""
    figure, axis = pictures.new(1, 1, height=3.0)
    resonances, end = machine.resonances_hz, machine.rigid_to_hz if np.isfinite(machine.rigid_to_hz) else 1e3
    last = float(resonances.max(initial=end))
    hertz = np.unique(np.concatenate([np.geomspace(end / 10, 2 * last, 3000), resonances]))
    if machine.measured is not None:
        seen = machine.measured.omega / (2 * np.pi)
        shown = (seen >= hertz[0]) & (seen <= hertz[-1])
        size = 20 * np.log10(np.abs(machine.measured.response[shown]))
        axis.semilogx(seen[shown], size, linewidth=0.6, color=pictures.GREY, label="measured, sensor 1")
    for number, sensor in enumerate(machine.sensors, 1):
        omega = 2 * np.pi * hertz
        size = 20 * np.log10(np.abs(omega**2 * sensor.frequency_response(omega)[0, 0]))
        axis.semilogx(hertz, size, linewidth=1.0, label=f"model, sensor {number}")
    axis.set(xlabel="frequency (Hz)", ylabel=f"acceleration over force (dB re 1/({machine.mass_unit}))")
    axis.legend()
    return figure


@pictures.house_style()
def paint_stabilisation(fit: ModalFit):
    """Which poles became modes: the fitted accelerance over the poles of each order, those of a mode in its colour."""
    diagram, modes = fit.diagram, fit.model.frequencies[fit.model.rigid_modes :]
    figure, (upper, lower) = pictures.new(
        2, 1, height=4.2, sharex=True, gridspec_kw={"height_ratios": [1, 2]}
    )
    hertz = fit.omega / (2 * np.pi)
    level = -(fit.omega**2) * fit.model.frequency_response(fit.omega)[0, 0]
    upper.plot(hertz, 20 * np.log10(np.abs(level)), color=pictures.BLACK, linewidth=0.8, label="fit")
    upper.set_ylabel("fit (dB re 1/kg)")
    near = np.abs(diagram.frequency[:, None] / modes - 1) < 0.005
    taken = diagram.stable & near.any(axis=1)
    for chosen, style, label in (
        (~diagram.stable, {"color": pictures.GREY, "alpha": 0.25}, "pole that moves with the order"),
        (
            diagram.stable & ~taken,
            {"color": pictures.BLUE, "alpha": 0.4},
            "pole that stays, not needed by the fit",
        ),
        (taken, {"color": pictures.RED}, "pole that stays, taken as a mode"),
    ):
        at = diagram.frequency[chosen] / (2 * np.pi)
        lower.plot(at, diagram.order[chosen], ".", markersize=3, label=label, **style)
    for number, mode in enumerate(modes / (2 * np.pi)):
        for axis in (upper, lower):
            label = "_mode" if number or axis is upper else "mode"
            axis.axvline(mode, color=pictures.RED, linewidth=0.5, zorder=1, label=label)
    lower.set(xlabel="frequency (Hz)", ylabel="order of the\npolynomial fraction")
    pictures.legend_below(lower, 2)
    return figure


@pictures.house_style()
def paint_loops(reached: AchievableBandwidth, controllers: list[DigitalController]):
    """Both sensitivities of every sensor with the written coefficients, and their limit."""
    figure, axes = pictures.new(1, 2, height=2.8, sharey=True)
    colours = (pictures.RED, pictures.BLUE, pictures.GREEN, pictures.ORANGE)
    for number, loop in enumerate(reached.loops):
        pair = loop, controllers[number % len(controllers)]
        hertz = loop.omega / (2 * np.pi)
        for axis, name, response in zip(axes, HELD, own_functions(*pair), strict=True):
            axis.semilogx(hertz, 20 * np.log10(np.abs(response)), linewidth=0.8, color=colours[number % 4])
            axis.axhline(20 * np.log10(SIX_DB), color=pictures.BLACK, linestyle=":", linewidth=1.0)
            axis.set(title=SHOWN[name], xlabel="frequency (Hz)", ylim=(-50, 15))
    axes[0].set_ylabel("magnitude (dB)")
    return figure
