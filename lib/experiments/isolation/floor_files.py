"""A floor of one's own: a measured record, or measured spectra, as motions of the floor sensors (notebook 08)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import linalg

from experiments.isolation.recorded_floors import (
    LOUDEST,
    RecordedFloor,
    ground_floor,
    record_floor,
    synthesise_floor,
)
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_number
from stillwork.signals.datafiles import read_columns
from stillwork.signals.densities import DENSITIES_SAID, density_unit, frequency_axis, read_densities
from stillwork.signals.records import PASS_SHARE, is_time, load_record

SHORTEST_S = 15.0  # two thirds of it are the adaptation's own time constant of 10 s
FADE_S = 1.0  # at the beginning of a record; the first 5 s are judged by nobody
FARTHEST = 0.1  # m rms: no floor travels so far, a drifting sensor seems to (chosen)
QUIETEST = 1e-8  # m/s^2 rms: the quietest ground on Earth (Peterson's low noise model) has that at 1-10 Hz


def open_floor(
    floor_record: str,
    unit: str,
    rate_hz: float,
    channels: list[str],
    *,
    twin: Twin,
    ground_gain: float,
    common: float,
    duration_s: float,
    seed: int,
) -> RecordedFloor:
    """Floor from a record or from spectra, or the measured ground when no file is named.

    A record of one or two channels gives one or two: the feedforward hears no sensor that was not there. One
    spectrum moves all of the rig's sensors alike, several each its own.

    Parameters
    ----------
    floor_record : str
        Path of a CSV, MAT, NPZ or universal file, see `stillwork.signals.records.load_record`; empty for the
        ground. Spectra stand beside a column or array named ``frequency``, in Hz.
    unit : str
        Of the record; a density, such as ``(m/s)^2/Hz`` or ``m/s^2/sqrt(Hz)``, says that the file holds spectra.
    rate_hz : float
        Of the record; 0 where the file tells it.
    channels : list of str
        Channels to take, as many as floor sensors at most; empty for all.
    twin : Twin
        Whose sensors the floor moves.
    ground_gain, common, duration_s, seed
        Of a motion that is made from spectra: its amplitude relative to them, share of its power that all
        sensors see alike, seconds, and seed.

    Raises
    ------
    InputError
        For everything that makes the file unusable; it says what to do. A floor that does not reach the rig's
        suspension is refused, since it cannot teach the feedforward anything; so is one beyond 1 g, or below the
        quietest ground on Earth, since its unit is wrong, and a record of a sensor that drifts.
    """
    rate = twin.instruments.sample_rate
    require_number("ground_s", duration_s, at_least=SHORTEST_S)
    options = {"common": common, "sample_rate": rate}
    lowest, highest = _suspension_hz(twin)
    measured = False
    if not floor_record:
        floor = ground_floor(duration_s, seed, gain=ground_gain, channels=twin.sensors, **options)
    elif density_unit(unit):
        path = Path(floor_record)
        f, density = read_densities(path, unit, channels, twin.sensors)
        if f[0] > lowest or f[-1] < highest:
            raise InputError(
                f"{path.name} holds {f[0]:.3g} to {f[-1]:.3g} Hz and misses suspension frequencies of the rig "
                f"({lowest:.3g} to {highest:.3g} Hz); give spectra that cover them"
            )
        if len(density) == 1:
            density = np.repeat(density, twin.sensors, axis=0)
        source = f"spectra of {path.name}"
        floor = synthesise_floor(
            f, ground_gain**2 * density, duration_s, seed, channels=len(density), source=source, **options
        )
    else:
        floor, measured = _recorded(floor_record, unit, rate_hz, channels, twin, highest), True
    peak, rms = np.abs(floor.acceleration).max(), floor.acceleration.std(axis=1).max()
    if peak > LOUDEST:
        raise InputError(
            f"{floor.source}: the floor accelerates by up to {peak:.3g} m/s^2, beyond 1 g, where nothing stays on it; "
            f"check the unit {unit!r}, or cut out what shook the sensor alone"
        )
    if rms < QUIETEST:
        raise InputError(
            f"{floor.source}: the floor accelerates by {rms:.1g} m/s^2 rms, less than the quietest ground on Earth; "
            f"check the unit {unit!r}"
        )
    return _from_rest(floor) if measured else floor  # a wrong unit travels far, too, and is no drift


def _recorded(floor_record, unit, rate_hz, channels, twin, highest) -> RecordedFloor:
    path = Path(floor_record)
    if path.suffix.lower() in (".csv", ".txt", ".tsv", ".npz", ".mat") and not rate_hz:
        columns = read_columns(path)
        if frequency_axis(columns) and not any(is_time(name) for name in columns):
            raise InputError(
                f"{path.name} holds spectra over frequency; say their unit as a density: {DENSITIES_SAID}"
            )
    record = load_record(
        path,
        unit,
        sample_rate=rate_hz or None,
        channels=channels or None,
        most_channels=twin.sensors,
    )
    if record.duration < SHORTEST_S:
        raise InputError(
            f"{record.source} lasts {record.duration:.3g} s, too short for an adaptation that averages over 10 s; "
            f"give at least {SHORTEST_S:g} s"
        )
    if record.sample_rate * PASS_SHARE / 2 < highest:
        raise InputError(
            f"{record.source} is sampled at {record.sample_rate:.4g} Hz and tells nothing above "
            f"{record.sample_rate * PASS_SHARE / 2:.3g} Hz, where the rig has suspension frequencies up to "
            f"{highest:.3g} Hz; measure at {2 * highest / PASS_SHARE:.3g} Hz at least"
        )
    return record_floor(record, channels=len(record.signals), sample_rate=twin.instruments.sample_rate)


def _from_rest(floor: RecordedFloor) -> RecordedFloor:
    """The loop starts at rest: a floor that does not, by an offset or in mid-motion, would be a step that no floor makes."""
    if (travel := _travel(floor)) > FARTHEST:
        raise InputError(
            f"{floor.source}: integrated twice, the floor travels {travel:.2g} m rms, which is a sensor that drifts; "
            "take a high-pass of some 0.5 Hz over the record"
        )
    fade = np.minimum(np.arange(floor.acceleration.shape[1]) / (FADE_S * floor.sample_rate), 1.0)
    return replace(floor, acceleration=floor.acceleration * np.sin(np.pi / 2 * fade) ** 2)


def _travel(floor: RecordedFloor) -> float:
    """Rms displacement of the sensor that moves farthest, m, without what is slower than half the record."""
    samples = floor.acceleration.shape[1]
    omega = 2 * np.pi * np.fft.rfftfreq(samples, 1 / floor.sample_rate)[2:]
    lines = np.fft.rfft(floor.acceleration * np.hanning(samples), axis=1)[:, 2:] / omega**2
    # A Hann window keeps 3/8 of the power.
    return float(np.sqrt(2 * np.sum(np.abs(lines) ** 2, axis=1).max() * 8 / 3) / samples)


def _suspension_hz(twin: Twin) -> tuple[float, float]:
    squares = linalg.eigvalsh(twin.plant.stiffness, twin.plant.mass)
    return tuple(np.sqrt(squares[[0, -1]]) / (2 * np.pi))
