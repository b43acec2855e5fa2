"""Checks of a floor's record or spectra for what may disturb an adaptation."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError
from stillwork.base.validation import checked

CREST = 20.0  # peak over rms from which on it may be a spike: footsteps on a slab reach 15 (chosen)
STUCK_S = 0.25  # s of one value, of a sensor that sticks (chosen)
SLOW_HZ, HEARD_HZ = (0.5, 1.0), (6.0, 100.0)  # what may break an adaptation, and what it learns from
LOUDEST = 9.80665  # m/s^2: beyond 1 g nothing stays on a floor
QUIETEST = 1e-8  # m/s^2 rms: the quietest ground on Earth (Peterson's low noise model) has that at 1-10 Hz


@checked
def require_floor_level(source: str, unit: str, peak: float, rms: float) -> None:
    """Refuse a floor (m/s^2) that is louder than a floor can be, or quieter: its unit is wrong."""
    hint = f"check the unit{unit and f' {unit!r}'}"
    if peak > LOUDEST:
        raise InputError(
            f"{source}: the floor accelerates by up to {peak:.3g} m/s^2, beyond 1 g, where nothing stays on it; "
            f"{hint}, or cut out the part in which only the sensor was shaken"
        )
    if rms < QUIETEST:
        raise InputError(
            f"{source}: the floor accelerates by {rms:.1g} m/s^2 rms, less than the quietest ground on Earth; {hint}"
        )


@checked
def sensor_faults(
    acceleration: Float64[np.ndarray, "sensors samples"], sample_rate: Positive
) -> Iterator[str]:
    """Sensors with spikes or constant readings, with advice, one sentence each."""
    for k, row in enumerate(acceleration):
        name, size = f"Floor sensor {k + 1}", row.std()
        peak = np.abs(row - row.mean()).max()
        if peak > CREST * size:
            at = np.abs(row - row.mean()).argmax() / sample_rate
            yield (
                f"{name} peaks at {peak / size:.0f} times its rms, at {at:.3g} s: if nothing hit the floor there, "
                "it is a spike of the sensor; cut it out of the record."
            )
        length, at = _longest_still(row, 1e-6 * size)
        if length > STUCK_S * sample_rate:
            yield (
                f"{name} gives one value for {length / sample_rate:.2g} s, from {at / sample_rate:.3g} s "
                "on: it sticks; leave the channel out, or cut that part out."
            )


@checked
def slow_ratio(
    frequencies_hz: Float64[np.ndarray, " frequencies"],
    density: Float64[np.ndarray, "sensors frequencies"],
) -> float:
    """Acceleration per √Hz at `SLOW_HZ` over that at `HEARD_HZ`, at the sensor where it is largest; 0 if unknown."""
    slow, heard = (
        density[:, (frequencies_hz >= low) & (frequencies_hz <= high)] for low, high in (SLOW_HZ, HEARD_HZ)
    )
    if not slow.size or not heard.size:
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):  # of a silent sensor
        return float(np.sqrt(np.nan_to_num((slow.mean(axis=1) / np.median(heard, axis=1)).max())))


def _longest_still(row: np.ndarray, within: float) -> tuple[int, int]:
    """Samples of the longest stretch in which a signal keeps its value, and where it begins."""
    moving = np.flatnonzero(np.abs(np.diff(row)) > within)
    ends = np.concatenate([[-1], moving, [len(row) - 1]])
    longest = int(np.argmax(np.diff(ends)))
    return int(np.diff(ends)[longest]), int(ends[longest] + 1)
