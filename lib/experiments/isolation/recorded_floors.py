"""Floors as motions of the sensors over time: measured, or synthesised from a power spectral density."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.isolation.floors import SENSORS
from stillwork.base.bounds import Positive
from stillwork.base.checks import require_array, require_number
from stillwork.base.validation import check_fields
from stillwork.signals.criteria import criterion_density
from stillwork.signals.units import STANDARD_GRAVITY
from workbook import paths

# The range of interest of the FeRLS paper ends here; a criterion continued further would be no measurement.
UPPER_HZ = 300.0
GROUND_UPPER_HZ = 100.0  # the measured ground spectra end here
# Of the named criteria the one nearest to the measured ground at 100 Hz.
GROUND_CRITERION = "VC-L"
# m/s^2: beyond 1 g what stands on a floor leaves it; jumping on the shipped slab reaches a sixth of it.
LOUDEST = STANDARD_GRAVITY


@dataclass(frozen=True)
class RecordedFloor:
    """Accelerations of the floor sensors over time."""

    acceleration: Float64[np.ndarray, "channels samples"]  # m/s^2
    sample_rate: Positive  # Hz
    source: str  # where it comes from

    def __post_init__(self):
        check_fields(self)

    @property
    def channels(self) -> int:
        return len(self.acceleration)

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.acceleration.shape[1] / self.sample_rate


@dataclass(frozen=True)
class SpectralFloor:
    """Floor known by its power spectral density alone, the same and independent at all sensors."""

    frequencies_hz: Float64[np.ndarray, " frequencies"]  # positive and rising
    # acceleration PSD, (m/s^2)^2/Hz; straight in between, zero outside
    levels: Float64[np.ndarray, " frequencies"]
    source: str  # where it comes from
    channels: int = SENSORS

    def density(self, frequencies_hz: ArrayLike) -> Float64[np.ndarray, "channels frequencies"]:
        """Acceleration PSD of every sensor, (m/s^2)^2/Hz."""
        f = require_array("frequencies_hz", frequencies_hz, ndim=1)
        each = np.interp(f, self.frequencies_hz, self.levels, left=0.0, right=0.0)
        return np.tile(each, (self.channels, 1))


def measured_ground_density() -> tuple[
    Float64[np.ndarray, " frequencies"], Float64[np.ndarray, " frequencies"]
]:
    """Measured vertical ground (`data/isolation/ligo_llo_ground`), mean over four days: Hz from 0.01 to 100, and PSD."""
    file = paths.data("isolation", "ligo_llo_ground/ground_velocity_density.npz")
    with np.load(file, allow_pickle=False) as ground:
        f = ground["frequencies_hz"]
        velocity = ground["velocity_density_Z"].astype(float).mean(axis=0)
    return f, velocity * (2 * np.pi * f) ** 2


def ground_spectrum(*, gain: float = 1.0) -> SpectralFloor:
    """Measured vertical ground spectrum below 100 Hz and a vibration criterion above.

    The records end at 100 Hz; above it the floor is assumed to follow the criterion's curve.
    """
    require_number("gain", gain, above=0.0)
    f, density = measured_ground_density()
    below = f < GROUND_UPPER_HZ
    above = np.geomspace(GROUND_UPPER_HZ, UPPER_HZ, 50)
    return SpectralFloor(
        np.concatenate([f[below], above]),
        gain**2 * np.concatenate([density[below], criterion_density(GROUND_CRITERION, above)]),
        f"measured ground to 100 Hz, {GROUND_CRITERION} above",
    )
