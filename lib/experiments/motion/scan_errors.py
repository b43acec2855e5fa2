"""Tracking errors over a move, as explorers show them."""

from collections.abc import Mapping

import numpy as np

from stillwork.control.setpoint import Setpoint
from workbook import figures


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
