"""Figures of the joint design."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from experiments.motion.joint import CHANNELS, JointDesign, StageResponses
from experiments.motion.joint_search import Verified, search_grid, stable_on
from experiments.motion.machines import stage
from experiments.motion.pictures import CASES, LABELS, add_magnitude, mark_limit
from experiments.motion.uncertainty import perturbed
from stillwork.lti.modal import ModalModel
from stillwork.workbook import figures


def paint_ladder(found: Mapping[str, Verified], published_hz: float):
    """First crossing of every design at the mass of the published number."""
    figure, axis = figures.new(1, 1, height=2.9)
    rows = np.arange(len(found))[::-1]
    axis.plot(
        [each.crossing_hz[4] for each in found.values()],
        rows,
        "o",
        color=CASES["MC and AD"],
        label="first crossing, mass 5",
    )
    figures.mark_published(axis, published_hz, rows[list(found).index("published")])
    axis.set_yticks(rows, list(found))
    axis.set_xlabel("bandwidth (Hz)")
    axis.set_xlim(left=0)
    axis.legend(loc="center left")
    return figure


TOP_DB = 20.0  # where larger peaks are cut


def paint_peaks_over_plants(peaks: Mapping[str, Mapping[str, np.ndarray]]):
    """Largest peak of every design on every perturbed plant, by panel; unstable ones lie on the upper edge."""
    figure, axes = figures.new(1, len(peaks), height=3.2, sharey=True, squeeze=False)
    for axis, (title, designs) in zip(axes[0], peaks.items(), strict=True):
        for place, (name, values) in enumerate(designs.items()):
            shown = np.minimum(20 * np.log10(values), TOP_DB)
            across = place + np.linspace(-0.3, 0.3, len(shown))
            axis.plot(across, shown, ".", markersize=4, color=CASES["MC and AD"], label=name)
            axis.annotate(
                f"{np.mean(~np.isfinite(values)):.0%}\nunstable",
                (place, TOP_DB + 0.8),
                ha="center",
                fontsize=6,
            )
        mark_limit(axis)
        axis.set_xticks(range(len(designs)), [name.replace(" ", "\n", 1) for name in designs], fontsize=6)
        axis.set_ylim(0, TOP_DB + 4)
        axis.set_title(title)
    axes[0, 0].set_ylabel(f"largest peak (dB), cut at {TOP_DB:g}")
    return figure


def paint_joint(designs: Mapping[str, JointDesign], design: str, frequency_error: float, bandwidth: float):
    """Explorer: the constrained functions, of the worst mass each, with frequencies and the bandwidth off by some %."""
    chosen = designs[design]
    chosen = replace(chosen, bandwidth_hz=chosen.bandwidth_hz * bandwidth / 100)
    plant = _shifted(frequency_error / 100)
    responses = StageResponses(search_grid([plant], 150, 8), [plant])
    found = responses.loops(chosen).response
    figure, axis = figures.new(1, 1, height=2.8)
    figure.set_layout_engine(None)
    figure.subplots_adjust(left=0.1, right=0.98, bottom=0.17, top=0.9)
    peak = 0.0
    for name in CHANNELS:
        largest = np.abs(getattr(found, name)[0]).max(axis=0)
        peak = max(peak, float(largest.max()))
        add_magnitude(axis, responses.omega, largest, label=LABELS[name])
    mark_limit(axis)
    verdict = f"largest peak {20 * np.log10(peak):.1f} dB" if stable_on(chosen, [plant])[0] else "unstable"
    axis.set_title(f"worst of the seven masses: {verdict}")
    axis.set_xlabel("frequency (Hz)")
    axis.set_ylabel("magnitude (dB)")
    axis.set_ylim(-40, 20)
    axis.legend(loc="lower left")
    return figure


def _shifted(error: float) -> ModalModel:
    """The stage with all its flexible frequencies off by one relative error."""
    nominal = stage()
    errors = np.zeros((len(nominal.frequencies), 4))
    errors[nominal.rigid_modes :, 0] = error
    return perturbed(nominal, errors)
