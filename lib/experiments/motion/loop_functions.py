"""Loop functions of all measured masses or places, with the allowed peak."""

from collections.abc import Mapping, Sequence

import numpy as np

from experiments.motion.magnitude_panels import paint_magnitudes
from experiments.motion.magnitudes import mark_limit
from stillwork.control.bandwidth import Loop
from stillwork.control.pid import Pid


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
