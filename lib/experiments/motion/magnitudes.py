"""Lines of magnitude in dB over frequency and of the allowed peak, and plain numbers beside an axis."""

import numpy as np

from stillwork.control.bandwidth import SIX_DB
from workbook import figures


def decibel(response) -> np.ndarray:
    """Magnitude in dB."""
    return 20 * np.log10(np.abs(response))


def add_magnitude(axis, omega, response, **style) -> None:
    """Add the magnitude in dB of a response over frequencies (rad/s) in Hz."""
    axis.semilogx(np.asarray(omega) / (2 * np.pi), decibel(response), **style)


def mark_limit(axis) -> None:
    """The peak that the thesis allows, 6 dB."""
    axis.axhline(20 * np.log10(SIX_DB), color=figures.BLACK, linestyle=":", linewidth=1.0)


def plain_numbers(axis) -> None:
    """Numbers beside a logarithmic axis of about a decade as 6 and 20, not as multiples of powers of ten."""
    from matplotlib.ticker import LogFormatter

    axis.set_major_formatter(LogFormatter())
    axis.set_minor_formatter(LogFormatter())
