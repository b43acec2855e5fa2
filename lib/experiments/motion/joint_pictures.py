"""Figures of the joint design."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from matplotlib.lines import Line2D

from experiments.motion.explorer_panels import plain
from experiments.motion.joint import JointDesign, compensated
from experiments.motion.joint_designs import Stored
from experiments.motion.joint_search import PEAKS, Judged, grid, judge, serve, six
from experiments.motion.machines import stage
from experiments.motion.magnitudes import add_magnitude, mark_limit
from experiments.motion.uncertainty import detuned
from workbook import figures

SIZES = {0.0: figures.RED, 0.02: figures.BLUE, 0.05: figures.GREEN}  # of the errors that a design serves
# of what a search was free to change
MARKS = {
    "joint": "o",
    "two steps": "^",
    "observer free": "D",
    "controller free": "s",
    "largest bandwidth": "v",
}
TOP_DB = 20.0  # where larger peaks are cut


def paint_front(
    designs: Mapping[str, Stored],
    nominal: Mapping[str, Judged],
    unstable: Mapping[str, float],
    published: Judged,
):
    """Scan error over the noise in the control force; marks by what was free, hollow where stages were unstable.

    `unstable` is the share of such stages, written beside the designs that have any.
    """
    figure, axis = figures.new(1, 1, height=3.4)
    at = {name: (1e3 * found.force[0], 1e9 * found.error[0]) for name, found in nominal.items()}
    for size, colour in SIZES.items():
        ours = [name for name, each in designs.items() if each.size == size and name.startswith("joint")]
        points = np.array(sorted(at[name] for name in ours))
        axis.plot(*points.T, "-", color=colour, linewidth=1.0, label=f"joint, for errors of {size:.0%}")
    for name, stored in designs.items():
        free, colour = name.partition(",")[0], SIZES[stored.size]
        fill = "white" if unstable[name] else colour
        axis.plot(*at[name], MARKS[free], color=colour, markerfacecolor=fill, markersize=5, label=name)
        if unstable[name]:
            note = f"{unstable[name]:.0%} unstable"
            axis.annotate(note, at[name], (5, 3), textcoords="offset points", fontsize=6)
    late = 1e3 * published.force[0], 1e9 * published.error[0]
    axis.plot(*late, "x", color=figures.BLACK, label="as published, late")
    axis.set_xscale("log")
    axis.set_xticks([2, 5, 10, 20, 30], ["2", "5", "10", "20", "30"])
    axis.minorticks_off()
    axis.set(xlabel="rms of the control force under noise (mN)", ylabel="rms error in the scan (nm)")
    axis.set_ylim(1.0, None)
    legend = [line for line in axis.lines if line.get_linestyle() == "-"] + axis.lines[-1:]
    legend += [
        Line2D([], [], linestyle="", marker=MARKS[free], color=figures.GREY, label=free) for free in MARKS
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=3)
    return figure


def paint_peaks_over_plants(judged: Mapping[str, Mapping[str, Judged]]):
    """Largest peak of every design on every perturbed plant, by panel; unstable ones lie on the upper edge."""
    figure, axes = figures.new(1, len(judged), height=3.2, sharey=True, squeeze=False)
    for axis, (title, designs) in zip(axes[0], judged.items(), strict=True):
        for place, (name, found) in enumerate(designs.items()):
            shown = np.minimum(found.peaks.max(axis=1), TOP_DB)
            across = place + np.linspace(-0.3, 0.3, len(shown))
            axis.plot(across, shown, ".", markersize=4, color=figures.RED, label=name)
            axis.annotate(
                f"{np.mean(~found.stable):.0%}\nunstable", (place, TOP_DB + 0.8), ha="center", fontsize=6
            )
        mark_limit(axis)
        axis.set_xticks(range(len(designs)), [name.replace(" ", "\n", 1) for name in designs], fontsize=6)
        axis.set(ylim=(0, TOP_DB + 4), title=title)
    axes[0, 0].set_ylabel(f"largest peak (dB), cut at {TOP_DB:g}")
    return figure


def paint_joint(
    designs: Mapping[str, JointDesign], design: str, frequency_error: float, bandwidth: float, delay: float
):
    """Explorer: the six functions, of the worst mass each, with frequencies, bandwidth (%) and delay (samples) moved."""
    chosen = designs[design]
    chosen = replace(chosen, bandwidth_hz=chosen.bandwidth_hz * bandwidth / 100)
    nominal = stage()
    plant = detuned(nominal, np.full(len(nominal.frequencies) - nominal.rigid_modes, frequency_error / 100))
    judged = judge(chosen, [plant], delay)
    values = six(serve(plant, delay).plant, compensated(chosen, grid(), delay)).max(axis=1)
    figure, axis = plain(bottom=0.17)
    for name, magnitude in zip(PEAKS, values, strict=True):
        add_magnitude(axis, grid()[1:-1], magnitude[1:-1], label=name)
    mark_limit(axis)
    verdict = "unstable"
    if judged.stable[0]:
        verdict = f"largest peak {judged.peaks.max():.1f} dB, scan error {1e9 * judged.error[0]:.2f} nm"
    axis.set(title=f"worst of the seven masses: {verdict}", xlabel="frequency (Hz)", ylabel="magnitude (dB)")
    axis.set_ylim(-40, 20)
    axis.legend(loc="lower left", ncols=2)
    return figure
