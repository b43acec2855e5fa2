"""Panels of magnitudes in dB over frequency, and the allowed peak."""

from collections.abc import Mapping

import numpy as np

from stillwork.control.bandwidth import SIX_DB
from stillwork.workbook import figures


def decibel(response) -> np.ndarray:
    """Magnitude in dB."""
    return 20 * np.log10(np.abs(response))


def add_magnitude(axis, omega, response, **style) -> None:
    """Draw the magnitude in dB of a response over frequencies (rad/s) in Hz."""
    axis.semilogx(np.asarray(omega) / (2 * np.pi), decibel(response), **style)


def mark_limit(axis) -> None:
    """The peak that the thesis allows, 6 dB."""
    axis.axhline(20 * np.log10(SIX_DB), color=figures.BLACK, linestyle=":", linewidth=1.0)


def paint_magnitudes(
    panels: Mapping[str, Mapping[str, tuple]], quantity: str = "", rows: int = 1, **options
) -> tuple:
    """Magnitudes in dB, a panel a title, each from label to (omega in rad/s, response, line options): figure, axes."""
    figure, axes = figures.new(rows, len(panels) // rows, squeeze=False, **options)
    for axis, (title, lines) in zip(axes.ravel(), panels.items(), strict=True):
        for label, (omega, response, style) in lines.items():
            add_magnitude(axis, omega, response, label=label, **style)
        axis.set_title(title)
    figures.label(axes, "frequency (Hz)", quantity)
    return figure, axes
