"""Power that the feedforward removes, and the limit that output noise sets (section 5.2.2, Fig. 8)."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.isolation.performance import third_octaves
from stillwork.base.checks import require_array
from stillwork.signals.spectra import Spectrum, band_power

BAND_HZ = (1.0, 300.0)  # the paper's range of interest
RESOLUTION_HZ = 0.25  # fine enough for the suspension's skirt at 1 Hz


def reduction_percent(
    frequencies_hz: ArrayLike, before: ArrayLike, after: ArrayLike
) -> Float64[np.ndarray, " channels"]:
    """Share of the power at 1-300 Hz that is gone, per cent, for densities of shape (channels, frequencies)."""
    left, total = (
        np.array([band_power(frequencies_hz, row, *BAND_HZ) for row in rows]) for rows in (after, before)
    )
    return 100 * (1 - left / total)


def without_lines(spectrum: Spectrum, lines_hz: ArrayLike) -> Spectrum:
    """Spectrum with a straight bridge over two bins on either side of each line (a Hann window's main lobe)."""
    f, density = spectrum.frequencies_hz, spectrum.density.copy()
    for line in require_array("lines_hz", lines_hz, ndim=1):
        middle = int(np.argmin(np.abs(f - line)))
        ends = [max(middle - 3, 0), min(middle + 3, len(f) - 1)]
        inside = slice(ends[0] + 1, ends[1])
        density[:, inside] = [np.interp(f[inside], f[ends], row[ends]) for row in density]
    return Spectrum(f, density, spectrum.averages)


def limit_ratio_db(
    frequencies_hz: ArrayLike, density: ArrayLike, limit: ArrayLike, lines_hz: ArrayLike
) -> tuple[Float64[np.ndarray, " bands"], Float64[np.ndarray, "3 bands"]]:
    """Mean density of several runs over that of the limit, in one-third-octave bands from 3 to 200 Hz, dB.

    Densities have shape (runs, 3, frequencies); mains lines are bridged because their size in the twins is assumed.
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    centres, inside = third_octaves(f)
    over, under = (
        without_lines(Spectrum(f, np.mean(np.asarray(each), axis=0), len(each)), lines_hz).density
        for each in (density, limit)
    )
    ratio = [over[:, band].mean(axis=1) / under[:, band].mean(axis=1) for band in inside]
    return centres, 10 * np.log10(np.stack(ratio, axis=1))
