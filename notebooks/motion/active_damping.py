"""Active damping: what notebook 07 alone needs, with its appendix."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from experiments.motion.designs import (
    DESIGNS,
    Design,
    design_controller,
    quick_limit,
    stage_loops,
    stage_observer,
)
from experiments.motion.loop_conditions import slope, static_gain
from experiments.motion.loop_pictures import paint_controllers
from experiments.motion.machines import stage
from experiments.motion.pictures import (
    add_magnitude,
    depth,
    highest,
    labelled_lines,
    mark_printed,
    paint_bode,
    paint_over_masses,
)
from stillwork.base.rounding import in_order
from stillwork.control.applications import Application, compensator
from stillwork.control.bandwidth import Loop, make_loop
from stillwork.control.feedback import SELECTIONS, damping_gain, fed_back, place, stiffness_gain
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import from_control
from stillwork.signals.moving_average import moving
from workbook import figures

FLEXIBLE = ("flex1", "flex2", "flex3")


def first_crossing(setting: Design, position: int) -> float:
    """First crossing at one mass (Hz) of a design's largest bandwidth, see `quick_limit`; NaN: there is none."""
    found = quick_limit(setting)
    return np.nan if found is None else float(found[1].crossing_hz[position - 1])


def damped_ratios(model: ModalModel, increase: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Table 3.4: damping ratios of A + BK by selection of the gain, from its eigenvalues and from its diagonal."""
    rows, diagonal, states = {"original": model.damping}, {}, model.state_space()
    for selection in SELECTIONS:
        gain = damping_gain(model, increase, selection)
        rows[selection] = fed_back(model, gain).damping
        closed = states.a + states.b @ gain
        diagonal[selection] = [0.0, *(-np.diag(closed)[3::2] / (2 * model.frequencies[1:]))]
    names = ["rigid", *FLEXIBLE]
    return tuple(pd.DataFrame(each, index=names) + 0.0 for each in (rows, diagonal))


def rigid_poles_after_placement(model: ModalModel, increase: float) -> np.ndarray:
    """Largest real part of a rigid-body pole after Ackermann's formula has placed all poles, over the first resonance.

    On 21 stages whose frequencies differ from the model's by up to 1 %: what rounding leaves varies from
    one to the next. The wanted poles are those of (3.33), with the double one at zero left where it is.
    """
    found = []
    for shift in np.linspace(-0.01, 0.01, 21):
        machine = replace(model, frequencies=(1 + shift) * model.frequencies)
        states, ratios = machine.state_space(), machine.damping[1:] + increase
        upper = machine.frequencies[1:] * (-ratios + 1j * np.sqrt(1 - ratios**2))
        gain = place(states, np.concatenate([[0, 0], upper, upper.conj()]))
        poles = np.linalg.eigvals(states.a + states.b @ gain)
        slow = poles[np.argsort(np.abs(poles))[:2]]
        found.append(slow.real.max() / machine.frequencies[1])
    return np.array(found)


def paint_pole_zero(systems: Mapping):
    """Poles and zeros in the upper half-plane beside the magnitude, for `control.StateSpace` models with a few modes.

    What comes later is drawn smaller, so that what coincides stays visible.
    """
    systems = {name: from_control(system) for name, system in systems.items()}
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


def paint_crossings(
    x: Sequence[float], curves: Mapping[str, Sequence[float]], printed: tuple, quantity: str, position: int
):
    """First crossings at a mass over what is varied, a line a case, with the `printed` ones (places, Hz)."""
    figure, axis = figures.new(1, 1, height=2.8)
    for name, values in curves.items():
        axis.semilogx(x, values, "o-", label=name)
    figures.mark_published(axis, *printed)
    axis.set_xticks(x, [f"{each:g}" for each in x])
    axis.minorticks_off()
    axis.set(xlabel=quantity, ylabel=f"first crossing, mass {position} (Hz)")
    axis.legend()
    return figure


# === Appendix =====================================================================================================


def appendix(
    page,
    *,
    position: int,
    redesign: str,
    target: float,
    selectivity: float,
    selectivities: Sequence[float] | np.ndarray,
    exposure: float,
    table: tuple[pd.DataFrame, pd.DataFrame],
    small: ModalModel,
    moved: Mapping,
) -> None:
    """What this notebook judges beside its answer.

    `table` are the ratios of Table 3.4 from eigenvalues and diagonals, `small` the model of Figs. 3.18 and 3.19 and `moved`
    what state feedback makes of it.
    """
    plant = stage().at([0], [position - 1])
    increase, original = target - float(plant.damping[1]), design_controller("PID", redesign)
    damped = {
        name: make_loop(
            plant, compensator(stage_observer(position), Application(damping=increase, selection=name))
        )
        for name in SELECTIONS
    }
    _of_poles_and_zeros(page, small, moved)
    _of_table_3_4(page, truncate(plant, 4, 3), increase, *table)
    _of_selections(page, plant, damped, original)
    _of_old_controller(page, plant, damped["each mode"], original)
    _of_selectivity(page, plant, increase, position, selectivity, selectivities)
    _of_controllers(page, plant, damped["each mode"], original, design_controller("AD", redesign), position)
    _of_stiffness(page, small, exposure)


def _wide(plant: ModalModel, damped: Loop) -> np.ndarray:
    return resonance_grid(np.concatenate([plant.poles, damped.compensator.poles]), 50.0, 2.5e3, 600, 60)


def _of_poles_and_zeros(page, small: ModalModel, moved: Mapping) -> None:
    page.text("## State feedback: zeros")
    zeros = {name: np.sort(np.abs(from_control(system).zeros)) for name, system in moved.items()}
    shift = max(np.max(np.abs(each / zeros["original"] - 1)) for each in zeros.values())
    page.check("motion.damping.zeros", round(float(shift), 13))  # what is left is rounding


def _of_table_3_4(
    page, reduced: ModalModel, increase: float, ratios: pd.DataFrame, diagonal: pd.DataFrame
) -> None:
    page.text(r"""
## Table 3.4: the other modes, and the diagonal

The row of (3.31) prints the diagonal of $A + BK$. "Numerical issues result in closed loop rigid body poles that are unstable": on
how many of 21 stages, with frequencies up to 1 % apart, does Ackermann's formula do this?
""")
    page.show("diagonal of A + BK", diagonal.round(4))
    for selection, claim in zip(SELECTIONS, ("each", "minimal", "placement"), strict=True):
        for mode in FLEXIBLE[1:]:
            page.check(f"motion.table-3-4.{claim}.{mode}", ratios.loc[mode, selection])
    rigid = rigid_poles_after_placement(reduced, increase)
    page.show(
        f"unstable on {np.sum(rigid > 0)} of {len(rigid)} stages, with the rigid-body gains set to zero on none"
    )
    page.check("motion.table-3-4.rigid-poles-unstable", float(np.any(rigid > 1e-12)))


def _of_selections(page, plant: ModalModel, damped: Mapping[str, Loop], original) -> None:
    page.text("""
## The damped plant

For the three selections (Fig. 3.21). Pole placement and (3.31) "overlap".
""")
    bare, wide = make_loop(plant), _wide(plant, damped["each mode"])
    seen = {"undamped": (wide, bare.at(original, wide).equivalent_plant)}
    seen |= {name: (wide, loop.at(original, wide).equivalent_plant) for name, loop in damped.items()}
    dashed = {"each mode": {"linewidth": 3}, "pole placement": {"linestyle": "--", "color": figures.BLACK}}
    figure, axes = paint_bode(seen, "magnitude (dB re 1 m/N)", styles=dashed, height=3.4, ylim=(-230, -110))
    lines = labelled_lines(axes[0])
    page.check("motion.fig-3-21.overlap", np.abs(lines["each mode"][1] - lines["pole placement"][1]).max())
    page.save("fig-3-21", figure)


def _of_old_controller(page, plant: ModalModel, damped: Loop, original) -> None:
    page.text("""
## With the old controller

The damped plant (Fig. 3.22a), and the input sensitivity without observer (Fig. 3.2b) and with AD (Fig. 3.22b).
""")
    bare, wide = make_loop(plant), _wide(plant, damped)
    seen = {
        "plant $P$": (wide, bare.at(original, wide).equivalent_plant),
        "with AD": (wide, damped.at(original, wide).equivalent_plant),
    }
    page.save("fig-3-22a", paint_bode(seen, "magnitude (dB re 1 m/N)", phase=True, ylim=(-230, -110))[0])
    panels = {
        "$S_I$, no observer": stage_loops(Design()),
        "$S_I$ with AD": stage_loops(DESIGNS["AD, no band-pass"]),
    }
    figure = paint_over_masses(
        {title: (loops, original, "input_sensitivity") for title, loops in panels.items()},
        high_hz=1e4,
        zoom=((0.52, 0.37, 0.44, 0.27), (455, 485), (-6, 7)),
    )
    resonances = plant.frequencies[1:4] / (2 * np.pi)
    before, after = (
        np.array([highest(axis, 0.9 * at, 1.1 * at)[:, 1].max() for at in resonances]) for axis in figure.axes
    )
    page.check("motion.fig-3-22.peaks-reduced", np.mean(after < before))
    for axis in figure.axes:
        mark_printed(axis, 37.0, "printed bandwidth: 37 Hz", at=0.03)
    page.save("fig-3-22b", figure)


def _of_selectivity(
    page,
    plant: ModalModel,
    increase: float,
    position: int,
    selectivity: float,
    selectivities: Sequence[float] | np.ndarray,
) -> None:
    page.text(r"""
## Which selectivity

The first 0 dB crossing over $Q$ for a band-pass at each resonance and for a common one at the first. The thesis finds $Q = 2$, (3.35).
""")
    curves = {
        name: [
            first_crossing(Design(Application(damping=increase, selectivity=q, common=at)), position)
            for q in selectivities
        ]
        for name, at in (("individual band-pass", None), ("common band-pass", float(plant.frequencies[1])))
    }
    page.save("selectivity", paint_crossings(selectivities, curves, (2.0, 77.0), "selectivity $Q$", position))
    best = selectivities[int(np.argmax(curves["individual band-pass"]))]
    page.check("motion.bandwidth.selectivity", best)


def _of_controllers(page, plant: ModalModel, damped: Loop, original, redesigned, position: int) -> None:
    page.text("""
## The equivalent controller

No integrator is lost (Theorem 3.3.1), because the damping force comes from velocities. From $r$ the controller resembles a PID
with notches; from $y$ its gain rises at the resonances (Fig. 3.25).
""")
    bare, filtered = make_loop(plant), stage_loops(DESIGNS["AD"])[position - 1]
    peaks = resonance_grid(damped.compensator.poles, 50.0, 3e3, 2, 60)
    low = np.union1d(2 * np.pi * np.geomspace(0.05, 1e4, 800), peaks)
    cases = {
        "original": (bare, original),
        "with AD": (filtered, original),
        "with AD, redesigned": (filtered, redesigned),
    }
    figure, resonances = paint_controllers(cases, low), plant.frequencies[1:4] / (2 * np.pi)
    deep = [depth(figure.axes[0], "with AD", at) for at in resonances]
    hertz, drawn = labelled_lines(figure.axes[1])["with AD"]
    over = drawn - labelled_lines(figure.axes[1])["original"][1]
    rise = [over[np.abs(hertz / at - 1) < 0.01].max() for at in resonances]
    page.check("motion.fig-3-25.notches-from-reference", np.mean(np.array(deep) > 3))
    page.check("motion.fig-3-25.gain-rises", np.mean(np.array(rise) > 3))
    for hertz in (37.0, 77.0):
        mark_printed(figure.axes[1], hertz, f"printed: {hertz:g} Hz", at=0.03)
    page.save("fig-3-25", figure)
    peak = np.abs(damped.compensator.frequency_response(_wide(plant, damped))[0, 1]).max()
    static = abs(static_gain(damped.compensator)[0, 1])
    page.check("motion.integral-action.theorem-3-3-1", round(float(static / peak), 13))  # rounding
    still = 2 * np.pi * np.geomspace(1e-3, 1e-2, 20)
    page.check("motion.slopes.damping", slope(still, damped.at(original, still).output_sensitivity))


def _of_stiffness(page, small: ModalModel, exposure: float) -> None:
    page.text(r"""
## Active stiffness

Active stiffness can move a resonance to a multiple of $1/T$, where the moving average of a scan is zero (Remark 3.3.3). The
ring-down of the first mode before and after:
""")
    zero = 2 * np.pi * np.ceil(small.frequencies[1] * exposure / (2 * np.pi)) / exposure  # rad/s
    there, time = fed_back(small, stiffness_gain(small, zero / small.frequencies[1])), np.arange(0, 0.1, 1e-5)
    averages = {}
    for name, mode in {"before": small, "after": there}.items():
        decay = np.exp(-mode.damping[1] * mode.frequencies[1] * time)
        ring = decay * np.cos(mode.frequencies[1] * time)
        averages[name] = np.abs(moving(ring, 1e-5, exposure).average).max()
        page.show(f"{name}: {mode.frequencies[1] / (2 * np.pi):.1f} Hz, largest average {averages[name]:.4f}")
    page.check("motion.stiffness.average-zero", float(averages["after"] < averages["before"]))
