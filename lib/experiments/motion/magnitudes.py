"""Lines of magnitude in dB over frequency, and of the allowed peak."""

import numpy as np

from stillwork.control.bandwidth import SIX_DB
from stillwork.workbook import figures


def decibel(response) -> np.ndarray:
    """Magnitude in dB."""
    return 20 * np.log10(np.abs(response))


def add_magnitude(axis, omega, response, **style) -> None:
    """Add the magnitude in dB of a response over frequencies (rad/s) in Hz."""
    axis.semilogx(np.asarray(omega) / (2 * np.pi), decibel(response), **style)


def mark_limit(axis) -> None:
    """The peak that the thesis allows, 6 dB."""
    axis.axhline(20 * np.log10(SIX_DB), color=figures.BLACK, linestyle=":", linewidth=1.0)
