"""Figure and explorer of tracking (notebook 11)."""

from collections.abc import Mapping

import numpy as np

from experiments.motion.machines import published_setpoint, stage, stage_mass
from experiments.motion.scan_errors import paint_errors
from stillwork.control.feedforward import Feedforward, error_loop, tracking_error
from stillwork.control.loops import closed_loop
from stillwork.control.pid import PidFamily
from stillwork.control.setpoint import Setpoint
from stillwork.signals.moving_average import rms
from workbook import figures


def paint_tracking(setpoint: Setpoint, errors: Mapping[str, np.ndarray]):
    """Tracking errors in nm over the move, one panel a case, with the scaled acceleration and the scan."""
    figure, axes = figures.new(2, 2, height=4.4, sharex=True, sharey=True)
    scaled = setpoint.derivatives[2] / np.abs(setpoint.derivatives[2]).max()
    top = 1e9 * max(np.abs(error).max() for error in errors.values())
    for axis, (name, error) in zip(axes.ravel(), errors.items(), strict=True):
        style = {"color": figures.GREY, "linewidth": 0.8, "label": "acceleration, scaled"}
        axis.plot(setpoint.time, top * scaled, **style)
        axis.plot(setpoint.time, 1e9 * error, linewidth=0.9, color=figures.BLUE, label="error")
        axis.axvspan(*setpoint.scan, color=figures.GREY, alpha=0.12, linewidth=0)
        axis.set_title(f"{name}: {1e9 * rms(error[setpoint.scanning]):.2f} nm rms in the scan")
    axes[0, 0].set_xlim(0, setpoint.time[setpoint.time <= setpoint.scan[1]][-1] + 0.02)
    axes[0, 0].legend(loc="upper right", fontsize=7)
    figures.label(axes, "time (s)", "error (nm)")
    return figure


def paint_feedforward(acceleration_kg: float, snap: float, bandwidth_hz: float):
    """Explorer: the error of the loop without observer for given feedforward gains."""
    setpoint = published_setpoint()
    controller = PidFamily(stage_mass())(bandwidth_hz).state_space()
    loop = error_loop(closed_loop(stage().at([0], [4]), None, controller))
    error = tracking_error(loop, setpoint, Feedforward(acceleration=acceleration_kg, snap=1e-6 * snap))
    size = 1e9 * rms(error[setpoint.scanning])
    return paint_errors(setpoint, {"error": error}, f"{size:.1f} nm rms in the scan (grey)")
