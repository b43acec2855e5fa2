"""Published limits of floor vibration: VC and ISO curves."""

from typing import Annotated

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Vector, one_of
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import checked
from stillwork.signals.spectra import band_power

# One-third-octave band at f: from 2^(-1/6) f to 2^(1/6) f.
BAND_EDGE = 2.0 ** (1 / 6)
BAND_WIDTH = BAND_EDGE - 1 / BAND_EDGE
HIGHEST_HZ = 81.0  # the last centre of a criterion is 80 Hz, by powers of two 80.6 Hz

# Root-mean-square velocity per one-third-octave band, m/s: Amick, Gendreau, Busch and Gordon, "Evolving criteria
# for research facilities: vibration", SPIE 5933 (2005), and IEST-RP-CC012; H to M continue by halves.
_LEVELS = {
    **dict(
        zip(
            (f"VC-{letter}" for letter in "ABCDEFGHIJKLM"),
            np.array([50, 25, 12.5, 6.25, 3.12, 1.56, 0.78, 0.39, 0.195, 0.097, 0.048, 0.024, 0.012]) * 1e-6,
            strict=True,
        )
    ),
    "ISO workshop": 800e-6,  # ISO 2631-2 guide levels
    "ISO office": 400e-6,
    "ISO residence": 200e-6,
    "ISO operating theatre": 100e-6,
}
# Ungar and Gordon's names of 1983 for the first five.
_LEVELS.update({f"BBN-{letter}": _LEVELS[f"VC-{letter}"] for letter in "ABCDE"})
CRITERIA = tuple(_LEVELS)


@checked
def one_third_octave_velocity(
    frequencies_hz: Vector, acceleration_density: ArrayLike
) -> tuple[Float64[np.ndarray, " bands"], Float64[np.ndarray, " bands"]]:
    """Root-mean-square velocity (m/s) in the one-third-octave bands that a rising grid covers, from an acceleration PSD.

    The bands have centres 2^(k/3) Hz; they lie inside the grid and hold at least three of its points.
    """
    s = require_array("acceleration_density", acceleration_density, shape=frequencies_hz.shape)
    f, s = frequencies_hz[frequencies_hz > 0], s[frequencies_hz > 0]
    velocity_density = s / (2 * np.pi * f) ** 2
    first = np.ceil(3 * np.log2(f[0] * BAND_EDGE) - 1e-9)
    last = np.floor(3 * np.log2(f[-1] / BAND_EDGE) + 1e-9)
    bands = [
        (centre, band_power(f, velocity_density, max(low, f[0]), min(high, f[-1])))
        for centre in 2.0 ** (np.arange(first, last + 1) / 3)
        for low, high in [(centre / BAND_EDGE, centre * BAND_EDGE)]
        if np.count_nonzero((f >= low) & (f <= high)) >= 3
    ]
    if not bands:
        raise InputError("frequencies_hz covers no one-third-octave band; give a wider or finer grid")
    centres, powers = np.array(bands).T
    return centres, np.sqrt(powers)


@checked
def criterion_velocity(
    name: Annotated[str, one_of(CRITERIA)], frequencies_hz: Vector
) -> Float64[np.ndarray, " frequencies"]:
    """Limit of a vibration criterion: rms velocity in m/s per one-third-octave band.

    ``VC-A`` to ``VC-M``, ``BBN-A`` to ``BBN-E`` (the earlier names of VC-A to VC-E) or an ISO level, e.g.
    ``ISO office``: flat from 8 Hz (VC-C and finer: 1 Hz) to 80 Hz and continued so beyond both ends, except that VC-A, VC-B
    and the ISO levels rise below 8 Hz with constant acceleration; they are defined from 4 Hz.
    """
    if np.any(frequencies_hz < 0):
        raise InputError("frequencies_hz holds negative ones; give them from 0 on")
    level = np.full(frequencies_hz.shape, _LEVELS[name])
    if _LEVELS[name] >= _LEVELS["VC-B"]:
        level *= np.maximum(1.0, 8.0 / np.where(frequencies_hz > 0, frequencies_hz, np.inf))
    return level


@checked
def criterion_density(name: str, frequencies_hz: Vector) -> Float64[np.ndarray, " frequencies"]:
    """Acceleration PSD in (m/s^2)^2/Hz that just meets a vibration criterion in every band.

    The band at f is 0.2316 f wide: S_a = (2 pi f)^2 v^2 / (0.2316 f). See `criterion_velocity`.
    """
    return (2 * np.pi * criterion_velocity(name, frequencies_hz)) ** 2 * frequencies_hz / BAND_WIDTH


@checked
def criterion_met(centres_hz: Vector, velocity: ArrayLike) -> str:
    """Finest of VC-A to VC-M that one-third-octave velocities meet in every band in which it is defined, or ``none``.

    These are the bands from 4 Hz (VC-A and VC-B) or from 1 Hz (VC-C and finer) to 80 Hz. Where some of them are
    not given, the range that is stands behind the name: ``VC-D (5 to 81 Hz)``.

    References
    ----------
    Amick, Gendreau, Busch and Gordon, Evolving criteria for research facilities: vibration, SPIE 5933 (2005).
    """
    v = require_array("velocity", velocity, shape=centres_hz.shape)
    if not np.any((centres_hz > 7.9) & (centres_hz < HIGHEST_HZ)):
        raise InputError("centres_hz holds no band from 8 to 80 Hz; the criteria cannot be judged")
    for name in reversed([name for name in CRITERIA if name.startswith("VC")]):
        lowest = 4.0 if name in ("VC-A", "VC-B") else 1.0
        judged = (centres_hz > lowest / 1.01) & (centres_hz < HIGHEST_HZ)
        if np.all(v[judged] <= criterion_velocity(name, centres_hz[judged])):
            first, last = centres_hz[judged].min(), centres_hz[judged].max()
            whole = first < BAND_EDGE * lowest and last > 80 / BAND_EDGE
            return name if whole else f"{name} ({first:.2g} to {last:.2g} Hz)"
    return "none"
