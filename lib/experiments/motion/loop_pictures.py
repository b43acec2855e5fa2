"""Closed loops with different uses of the observer: what they reject, and their equivalent controllers."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from experiments.motion.designs import stage_observer
from experiments.motion.machines import published_noise, stage
from experiments.motion.pictures import add_magnitude, case_styles
from stillwork.control.applications import Application, compensator
from stillwork.control.bandwidth import Loop
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import Pid
from stillwork.lti.state_space import StateModel
from workbook import figures


def gain_cases(
    position: int,
    controller: Pid,
    application: Application,
    low_gain: float,
    noise_model: float | None = None,
) -> dict[str, StateModel]:
    """Closed loops without observer, with the published (high-gain) observer, and with one of `low_gain` times its R."""
    published = published_noise()
    noise = {"high gain": published, "low gain": replace(published, sensor=low_gain * published.sensor)}
    blocks = {
        name: compensator(stage_observer(position, each, noise_model), application)
        for name, each in noise.items()
    }
    plant = stage().at([0], [position - 1])
    cases = {"no observer": None} | blocks
    return {name: closed_loop(plant, each, controller.state_space()) for name, each in cases.items()}


def over_first(cases: Mapping[str, StateModel], name: str, at: np.ndarray) -> dict[str, np.ndarray]:
    """Transfers of a loop to the true error over those of the first, by source, at some frequencies (rad/s)."""
    loops = cases[name], next(iter(cases.values()))
    found = {}
    for source in ("u_ff", "w", "v", "d"):
        mine, base = (channel(each, source, "e_true").frequency_response(at)[0, 0] for each in loops)
        found[source] = np.abs(mine / base)
    return found


def paint_over_first(
    cases: Mapping[str, StateModel],
    omega: np.ndarray,
    resonances: Sequence[float] | np.ndarray,
    xlim: tuple[float, float],
):
    """Transfers to the true error over those of the first case (dB), from u_ff, w, v and d, with the `resonances` (Hz).

    The ratio is local and small, and two cases may coincide: the second is drawn broad, the third dashed on it.
    """
    figure, axes = figures.new(2, 2, sharex=True)
    (base, first), *others = cases.items()
    styles = (
        {"color": figures.SKY, "linewidth": 3.0},
        {"color": figures.RED, "linewidth": 1.2, "linestyle": "--"},
    )
    for axis, (source, name) in zip(
        axes.ravel(), {"u_ff": "$u_{ff}$", "w": "$w$", "v": "$v$", "d": "$d$"}.items(), strict=True
    ):
        below = channel(first, source, "e_true").frequency_response(omega)[0, 0]
        for (label, loop), style in zip(others, styles, strict=True):
            above = channel(loop, source, "e_true").frequency_response(omega)[0, 0]
            add_magnitude(axis, omega, above / below, label=label, **style)
        axis.axhline(0, color=figures.BLACK, linewidth=0.8)
        for hertz in resonances:
            axis.axvline(hertz, color=figures.GREY, linestyle=":", linewidth=1)
        axis.set(title=f"{name} to $e_{{true}}$", xlim=xlim)
    figures.label(axes, "frequency (Hz)", f"over {base} (dB)")
    figures.legend_below(axes[0, 0], len(others))
    return figure


def paint_controllers(
    cases: Mapping[str, tuple[Loop, Pid]], omega: np.ndarray, styles: Mapping[str, dict] | None = None
):
    """Equivalent controllers of several loops, from r and from y to the plant input, with their phase."""
    figure, axes = figures.new(2, 2, sharex=True, sharey="row", height=4.6)
    styles = case_styles(cases) if styles is None else styles
    for label, (loop, controller) in cases.items():
        style = {"label": label, **styles.get(label, {})}
        response = loop.at(controller, omega)
        for column, c in enumerate((response.reference_controller, response.output_controller)):
            add_magnitude(axes[0, column], omega, c, **style)
            phase = np.degrees(np.unwrap(np.angle(c)))
            axes[1, column].semilogx(omega / (2 * np.pi), phase - 360 * np.round(phase[0] / 360), **style)
    for axis, title in zip(axes[0], ("from $r$", "from $y$, times −1"), strict=True):
        axis.set_title(title)
    axes[0, 0].set_ylabel("magnitude (dB re 1 N/m)")
    axes[1, 0].set_ylabel("phase (deg)")
    figures.label(axes, "frequency (Hz)")
    axes[0, 0].legend(loc="best", fontsize=7)
    return figure
