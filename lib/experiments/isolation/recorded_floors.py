"""Floors as motions of the sensors over time: measured, or synthesised from a power spectral density."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.isolation.floors import SAMPLE_RATE, SENSORS
from stillwork.base.checks import InputError, pluralise, require_array, require_count, require_number
from stillwork.signals.criteria import criterion_density
from stillwork.signals.records import Record, resample, to_acceleration
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
    sample_rate: float  # Hz
    source: str  # where it comes from

    def __post_init__(self):
        require_array("acceleration", self.acceleration, ndim=2)
        require_number("sample_rate", self.sample_rate, above=0.0)

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


def synthesise_floor(
    frequencies_hz: ArrayLike,
    density: ArrayLike,
    duration: float,
    seed: int,
    *,
    common: float = 0.0,
    channels: int = SENSORS,
    sample_rate: float = SAMPLE_RATE,
    source: str = "synthesised",
) -> RecordedFloor:
    """Gaussian motion whose expected PSD is exactly the given one on every line 1/duration.

    Each Fourier line gets a random amplitude and phase; the motion is stationary and its end joins its start.
    Between the given frequencies the density runs straight, as `spectra.band_power` integrates it; outside it is
    zero. The density is one-sided, (m/s^2)^2/Hz, of all channels or of each; `common` the share of the power that all
    sensors see alike, 0 (independent, as the paper's three shakers) to 1 (the plate only translates, as ground waves far
    longer than the plate move it).
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    channels = require_count("channels", channels)
    s = require_array("density", density)
    s = require_array("density", s, shape=f.shape if s.ndim < 2 else (channels, *f.shape))
    if len(f) < 2 or f[0] <= 0 or np.any(np.diff(f) <= 0):
        raise InputError("frequencies_hz must be positive and rise; sort them and leave 0 Hz out")
    if np.any(s < 0):
        raise InputError("density holds negative values; give a power spectral density")
    require_number("common", common, at_least=0.0, at_most=1.0)
    require_number("sample_rate", sample_rate, above=0.0)
    require_number("duration", duration, at_least=2 / sample_rate)
    samples = round(duration * sample_rate)
    lines = np.fft.rfftfreq(samples, 1 / sample_rate)
    amplitude = np.sqrt([np.interp(lines, f, row, left=0.0, right=0.0) for row in np.atleast_2d(s)])
    # One-sided density = 2 |X|^2 / (rate samples), half of it in the real and half in the imaginary part.
    amplitude *= np.sqrt(sample_rate * samples) / 2
    draws = np.random.default_rng(seed).standard_normal((channels + 1, len(lines), 2)) @ [1, 1j]
    if samples % 2 == 0:
        draws[:, -1] = 2 * draws[:, -1].real  # the Nyquist line stands for itself, and is real
    mixed = np.sqrt(common) * draws[0] + np.sqrt(1 - common) * draws[1:]
    motion = np.fft.irfft(mixed * amplitude, samples, axis=1)
    return RecordedFloor(motion, float(sample_rate), source)


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


def ground_floor(duration: float, seed: int, *, gain: float = 1.0, **options) -> RecordedFloor:
    """Motion with the spectrum of `ground_spectrum`; the record has no phase, so the motion is synthesised."""
    ground = ground_spectrum(gain=gain)
    return synthesise_floor(
        ground.frequencies_hz, ground.levels, duration, seed, source=ground.source, **options
    )


def record_floor(
    record: Record, *, channels: int = SENSORS, sample_rate: float = SAMPLE_RATE
) -> RecordedFloor:
    """Measured record as a floor: acceleration without its mean, resampled for the loop.

    A sensor without a channel of its own moves as the mean of the others, so one channel is a plate that only
    translates.
    """
    channels = require_count("channels", channels)
    if len(record.signals) > channels:
        raise InputError(
            f"{record.source} holds {pluralise(len(record.signals), 'channel')}, the plate {pluralise(channels, 'sensor')}; "
            "choose channels when loading"
        )
    moved = resample(to_acceleration(record), sample_rate).signals
    moved = moved - moved.mean(axis=1, keepdims=True)
    missing = np.repeat(moved.mean(axis=0, keepdims=True), channels - len(moved), axis=0)
    return RecordedFloor(np.concatenate([moved, missing]), float(sample_rate), record.source)
