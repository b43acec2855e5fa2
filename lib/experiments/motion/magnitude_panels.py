"""Panels of magnitudes in dB over frequency."""

from collections.abc import Mapping

from experiments.motion.magnitudes import add_magnitude
from workbook import figures


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
