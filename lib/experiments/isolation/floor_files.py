"""A floor of one's own: a measured record, or measured spectra, as motions of the floor sensors (notebook 08)."""

import re
from pathlib import Path

import numpy as np
from scipy import linalg

from experiments.isolation.recorded_floors import (
    LOUDEST,
    RecordedFloor,
    ground_spectrum,
    record_floor,
    synthesise_floor,
)
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, nearest, require_number
from stillwork.signals.datafiles import read_columns
from stillwork.signals.records import MOTION_UNITS, PASS_SHARE, is_time, load_record, unit_factor

SHORTEST_S = 15.0  # two thirds of it are the adaptation's own time constant of 10 s
QUIETEST = 1e-8  # m/s^2 rms: the quietest ground on Earth (Peterson's low noise model) has that at 1-10 Hz
DENSITIES_SAID = "(m/s^2)^2/Hz, (m/s)^2/Hz, g^2/Hz or m/s^2/sqrt(Hz), say, with m, u or n before a unit"
_FREQUENCY_WORDS = ("frequency", "frequencies", "freq", "f", "hz")


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
        quietest ground on Earth, since its unit is wrong.
    """
    rate = twin.instruments.sample_rate
    require_number("ground_s", duration_s, at_least=SHORTEST_S)
    options = {"common": common, "sample_rate": rate}
    lowest, highest = _suspension_hz(twin)
    if not floor_record:
        ground = ground_spectrum(gain=ground_gain)
        f, density, source = ground.frequencies_hz, ground.levels, ground.source
        floor = synthesise_floor(
            f, density, duration_s, seed, channels=twin.sensors, source=source, **options
        )
    elif _density_unit(unit):
        path = Path(floor_record)
        f, density = _read_spectra(path, unit, channels, twin.sensors)
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
        floor = _recorded(floor_record, unit, rate_hz, channels, twin, highest)
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
    return floor


def _recorded(floor_record, unit, rate_hz, channels, twin, highest) -> RecordedFloor:
    path = Path(floor_record)
    if path.suffix.lower() in (".csv", ".txt", ".tsv", ".npz", ".mat") and not rate_hz:
        columns = read_columns(path)
        if _frequency_axis(columns) and not any(is_time(name) for name in columns):
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


def _density_unit(unit: str) -> tuple[str, int] | None:
    """Unit of the motion in a unit of a density, and the power to which the density has it; None for a record's."""
    plain = unit.strip().replace("²", "^2").replace("√Hz", "sqrt(Hz)").replace(" ", "")
    for pattern, power in (
        (r"\((.+)\)\^2/Hz", 2),
        (r"(\w+)\^2/Hz", 2),
        (r"\(?(.+?)\)?/(?:sqrt\(Hz\)|rtHz|Hz\^0\.5|Hz\^\(1/2\))", 1),
    ):
        if found := re.fullmatch(pattern, plain):
            return found[1], power
    if "hz" in plain.lower():
        raise InputError(f"unit is {unit!r}; give a density as {DENSITIES_SAID}")
    return None


def _read_spectra(path: Path, unit: str, channels: list[str], most: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and acceleration PSDs in (m/s^2)^2/Hz, (channels, frequencies), of a file of spectra.

    Raises
    ------
    InputError
        When there is no column of frequencies, or a spectrum cannot be one of a motion.
    """
    columns = read_columns(path)
    axis = _frequency_axis(columns)
    if not axis:
        raise InputError(
            f"{path.name} has no column named frequency (in Hz), which a density in {unit} needs; "
            "name it, or give the unit of a record"
        )
    f = columns.pop(axis)
    named = {name: column for name, column in columns.items() if column.size == f.size}
    for name in channels:
        if name not in named:
            raise InputError(
                f"{path.name} has no spectrum {name!r}{nearest(name, named)}; it has {', '.join(named)}"
            )
    named = {name: named[name] for name in channels} if channels else named
    if not 0 < len(named) <= most:
        raise InputError(
            f"{path.name} holds {len(named)} spectra ({', '.join(named)}) beside {axis!r}; choose 1 to {most}"
        )
    motion, power = _density_unit(unit)
    factor, si_unit = unit_factor(motion)
    if si_unit not in MOTION_UNITS:
        raise InputError(f"unit is {unit!r}; a floor needs a density of m/s^2, m/s or m")
    known = f > 0
    if known.sum() < 2:
        raise InputError(f"{path.name}: {axis!r} holds {known.sum()} frequencies above zero; give at least 2")
    rows = np.array(list(named.values()))[:, known]
    if not np.isfinite(rows).all() or np.any(rows < 0):
        raise InputError(f"{path.name} holds a density that is missing, infinite or negative; mend it")
    squares = (factor * rows) ** 2 if power == 1 else factor**2 * rows
    return f[known], squares * (2 * np.pi * f[known]) ** (2 * MOTION_UNITS.index(si_unit))


def _frequency_axis(columns: dict[str, np.ndarray]) -> str:
    """Name of the column of frequencies; empty where there is none."""
    for name, column in columns.items():
        words = re.split(r"[\s_(\[.]", name.strip().lower())
        if words[0] in _FREQUENCY_WORDS and column.size > 1:
            return name
    return ""


def _suspension_hz(twin: Twin) -> tuple[float, float]:
    squares = linalg.eigvalsh(twin.plant.stiffness, twin.plant.mass)
    return tuple(np.sqrt(squares[[0, -1]]) / (2 * np.pi))
