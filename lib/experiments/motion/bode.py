"""Bode diagrams of single responses."""

from collections.abc import Mapping

import numpy as np

from experiments.motion.legends import case_styles
from experiments.motion.magnitudes import decibel
from workbook import figures


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
