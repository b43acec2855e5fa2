"""Measured records: read from CSV, MAT, NPZ or UFF, checked, in SI units, evenly sampled."""

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import signal, special

from stillwork.base.bounds import Count
from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
    require_choice,
    require_number,
)
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.signals.datafiles import read_columns
from stillwork.signals.headings import column_unit, heading
from stillwork.signals.units import MOTION_UNITS, QUANTITIES, SI_UNITS, UNITS_TEXT, is_unit, unit_factor

# A step of time may differ from the period by this share: printed times are often that coarse. An instant off by
# d seconds falsifies a component at f by at most 2 pi f d of its size, 6 % at a tenth of the sample rate.
STEP_TOLERANCE = 0.1
DRIFT_TOLERANCE = 1.0  # periods that a slow clock may leave the even grid over the whole record
RATE_TOLERANCE = 0.01  # a stated rate may differ so much from the time column's
PLAUSIBLE_RATES_HZ = (10.0, 1e6)  # outside, a time column is in ms or a rate in kHz
SHORTEST_SAMPLES = 256

# Resampling filter: passes up to 0.8 of the lower Nyquist frequency, stops from it on, by 80 dB.
PASS_SHARE = 0.8
STOP_DB = 80.0
MOST_PHASES = 1000  # of a polyphase filter
LATEST = 1e-4  # samples by which the last one of a record may be off its time


@by_value
@dataclass(frozen=True)
class Record:
    """Evenly sampled measured signals.

    Attributes
    ----------
    signals : ndarray, shape (channels, samples)
        In `unit`.
    sample_rate : float
        Hz.
    unit : str
        ``m/s^2``, ``m/s``, ``m``, ``N``, ``N m``, ``V``, ``A``, ``Pa``, ``rad``, ``rad/s``, ``rad/s^2``, ``count``,
        ``count/s``, ``count/s^2`` or ``1``.
    names : tuple of str
        One per channel.
    source : str
        File name.
    notes : tuple of str
        What its file does not state and was assumed.

    Raises
    ------
    InputError
        When the rate is implausible, the samples are too few, or unit and names do not fit.

    Examples
    --------
    >>> record = signals.Record(np.zeros((1, 4000)), 1000.0, "m/s^2", ("floor",), "floor.csv")
    >>> record.duration  # s
    4.0
    """

    signals: Float64[np.ndarray, "channels samples"]
    sample_rate: float
    unit: str
    names: tuple[str, ...]
    source: str
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        check_fields(self)
        low, high = PLAUSIBLE_RATES_HZ
        if not low <= self.sample_rate <= high:
            raise InputError(
                f"{self.source}: a sample rate of {self.sample_rate:.4g} Hz is implausible for vibration "
                f"({low:g} Hz to {high:g} Hz); give time in s, the rate in Hz"
            )
        if self.signals.shape[1] < SHORTEST_SAMPLES:
            raise InputError(
                f"{self.source} holds {pluralise(self.signals.shape[1], 'sample')}, too short a record; "
                f"give at least {SHORTEST_SAMPLES}"
            )
        if self.unit not in SI_UNITS:
            raise InputError(f"unit is {self.unit!r}; convert to {', '.join(QUANTITIES)} or 1")
        if len(self.names) != len(self.signals):
            raise InputError(
                f"names has {pluralise(len(self.names), 'entry')} for {pluralise(len(self.signals), 'channel')}; name each"
            )

    @property
    def duration(self) -> float:
        """Seconds."""
        return self.signals.shape[1] / self.sample_rate


@checked
def load_record(
    path: str | Path,
    unit: str = "",
    *,
    sample_rate: float | None = None,
    channels: list[str] | None = None,
    most_channels: int | None = None,
) -> Record:
    """Read a measured record; nothing in the file is executed.

    A CSV file has one column per channel, with or without a line of names, separated by comma, semicolon, tab or
    blanks; lines that start with # are skipped. In MAT (up to version 7) and NPZ files every numeric array of
    the common length is a channel or a set of channels. A column or array named ``t`` or ``time`` (or
    ``time (ms)``, ``t_us``, ...) is the time, in s unless it states another unit; a scalar named ``fs`` or ``sample_rate`` is the
    rate in Hz. Universal files give their time responses, see `stillwork.signals.universal`.

    Parameters
    ----------
    path : str or Path
        ``.csv`` (also ``.txt``, ``.tsv``), ``.mat``, ``.npz``, ``.uff`` or ``.unv``.
    unit : str, optional
        Unit of the channels whose names state none in brackets, e.g. ``m/s^2``, ``mg``, ``mm/s``, ``um``, ``N``; see `UNITS`.
        Where a name states another one, the file is refused.
    sample_rate : float, optional
        Hz; needed when the file has neither a time nor a rate.
    channels : list of str, optional
        Names of the channels to read, in order; a member of a MATLAB structure as ``name.member``.
    most_channels : int, optional
        More channels than this are refused.

    Returns
    -------
    Record
        Channels by samples, with their unit, names and sample rate.

    Raises
    ------
    InputError
        For an unknown, missing or contradictory unit, also one in a channel's brackets, channels of several
        quantities, an unknown channel, NaN, a channel that never moves, gaps, uneven time, an implausible or contradictory rate, too short a record or too many
        channels. The message states what to do.

    Examples
    --------
    >>> time = np.arange(1000) / 500
    >>> table = np.column_stack([time, np.sin(time)])
    >>> np.savetxt("floor.csv", table, header="time,floor (mm/s)", comments="", delimiter=",")
    >>> record = signals.load_record("floor.csv")
    >>> record.unit, float(record.signals.max().round(6))
    ('m/s', 0.001)
    """
    if unit:
        unit_factor(unit)
    record = load_unscaled(path, sample_rate=sample_rate, channels=channels, most_channels=most_channels)
    factors, units = zip(*(channel_unit(record.source, each, unit) for each in record.names), strict=True)
    if len(set(units)) > 1:
        listing = ", ".join(f"{name}: {each}" for name, each in zip(record.names, units, strict=True))
        raise InputError(
            f"{record.source}: channels are of several quantities ({listing}); choose those of one with channels=[...]"
        )
    return replace(record, signals=record.signals * np.array(factors)[:, None], unit=units[0])


@checked
def load_unscaled(
    path: str | Path,
    *,
    sample_rate: float | None = None,
    channels: list[str] | None = None,
    most_channels: Count | None = None,
) -> Record:
    """`load_record` without scaling, in unit ``1`` whatever the names state."""
    path = Path(path)
    columns = read_columns(path)
    rate = sampling_rate(path.name, columns, sample_rate)
    notes = () if sample_rate is not None else _assumed(columns)
    columns = {name: column for name, column in columns.items() if not is_time(name) and column.size > 1}
    if channels is not None:
        columns = {
            name: columns[require_choice(f"channel of {path.name}", name, columns)] for name in channels
        }
    if not columns:
        raise InputError(f"{path.name} holds no channel; give numeric columns beside the time")
    if most_channels is not None and len(columns) > most_channels:
        raise InputError(
            f"{path.name} holds {len(columns)} channels ({', '.join(columns)}), at most {most_channels} can be "
            "used; choose with channels=[...]"
        )
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        listing = ", ".join(f"{name}: {n}" for name, n in lengths.items())
        raise InputError(f"{path.name}: channels differ in length ({listing}); choose with channels=[...]")
    for name, column in columns.items():
        _require_whole(f"{path.name}, channel {name}", column, rate)
        if np.ptp(column) == 0:
            raise InputError(
                f"{path.name}, channel {name} stands at {column[0]:.4g} throughout; leave it out with "
                "channels=[...] or correct the sensor"
            )
    return Record(np.array(list(columns.values())), rate, "1", tuple(columns), path.name, notes)


def _assumed(columns: dict[str, np.ndarray]) -> tuple[str, ...]:
    """The units that its time or rate was taken in, where the name states none."""
    taken = [
        column_unit(name, heading(name).quantity)[1]
        for name, column in columns.items()
        if heading(name).quantity == ("time" if column.size > 1 else "rate")
    ]
    return tuple(
        f"{each.column!r} states no unit; taken as {each.unit}" for each in taken if not each.written
    )


@checked
def stated_unit(name: str) -> str:
    """The unit that a channel's name states; empty when there is none that is known."""
    found = heading(name)
    return found.unit if found.meaning and is_unit(found.unit, SI_UNITS) else ""


@checked
def unknown_unit(name: str) -> str:
    """What a channel's name states where a unit stands, and is none of a channel; empty: nothing, or numbers."""
    found = heading(name)
    return found.unknown or ("" if stated_unit(name) else found.unit)


@checked
def channel_unit(source: str, name: str, unit: str, argument: str = "unit") -> tuple[float, str]:
    """Factor to SI and the SI unit of a channel: that of its name's brackets, or the one given; never two that differ."""
    stated = stated_unit(name)
    if not (unit or stated):
        raise InputError(
            f"{argument} is not given, and {source} states none for {name!r}; give it ({UNITS_TEXT})"
        )
    if unit and (odd := unknown_unit(name)):
        raise InputError(
            f"{argument} is {unit!r}, but {source} names the channel {name!r}, and {odd!r} is no unit that is known; convert "
            f"the channel to {unit} and name it so, or leave the brackets out of its name"
        )
    if unit and stated and unit_factor(unit) != unit_factor(stated):
        raise InputError(
            f"{argument} is {unit!r}, but {source} names the channel {name!r}; leave {argument} empty, or correct one of them"
        )
    return unit_factor(stated or unit)


@checked
def resample(record: Record, sample_rate: float) -> Record:
    """Record at another rate, with a linear-phase anti-alias filter and no delay.

    Content up to 0.8 of the lower Nyquist frequency passes within 0.1 %; what would fold back, or appear as an
    image, is 80 dB down. No sample is further than `LATEST` samples from its time, whatever the ratio of the rates.
    Beyond its ends a record counts as the line between them, which falsifies some 30 samples of the lower rate at either end.
    It lasts as long as before, to less than one new sample more: as each sample stands for a whole period, the last new
    samples may lie behind the record's last one, by less than one period of the record.
    """
    low, high = PLAUSIBLE_RATES_HZ
    require_number("sample_rate", sample_rate, at_least=low, at_most=high)
    exact = Fraction(sample_rate) / Fraction(record.sample_rate)
    fraction = max(exact, 1 / exact).limit_denominator(MOST_PHASES)
    fraction = fraction if exact > 1 else 1 / fraction
    if abs(1 - fraction / exact) * record.signals.shape[1] > LATEST:
        return replace(record, signals=_at_rate(record.signals, float(exact)), sample_rate=float(sample_rate))
    if fraction == 1:
        return replace(record, sample_rate=float(sample_rate))
    larger = max(fraction.numerator, fraction.denominator)
    taps, beta = signal.kaiserord(STOP_DB + 6, (1 - PASS_SHARE) / larger)
    window = signal.firwin(taps | 1, (1 + PASS_SHARE) / 2 / larger, window=("kaiser", beta))
    moved = signal.resample_poly(
        record.signals, fraction.numerator, fraction.denominator, axis=1, window=window, padtype="line"
    )
    return replace(record, signals=moved, sample_rate=float(sample_rate))


def _at_rate(rows: np.ndarray, ratio: float) -> np.ndarray:
    """Rows at `ratio` times their rate: the sum of all samples' band-limited pulses under the same Kaiser window."""
    slower = min(ratio, 1.0)
    taps, beta = signal.kaiserord(STOP_DB + 6, 1 - PASS_SHARE)
    half, cutoff = int(np.ceil(taps / 2 / slower)), slower * (1 + PASS_SHARE) / 2
    samples = rows.shape[1]
    line = np.linspace(rows[:, 0], rows[:, -1], samples, axis=1)
    padded = np.pad(rows - line, ((0, 0), (half, half)))
    times = np.arange(int(np.ceil(samples * ratio - LATEST))) / ratio
    moved = rows[:, :1] + (rows[:, -1:] - rows[:, :1]) / max(samples - 1, 1) * times
    for some in np.array_split(np.arange(len(times)), 1 + len(times) * half // 1_000_000):
        places = np.floor(times[some, None]).astype(int) + np.arange(1 - half, half + 1)
        away = places - times[some, None]
        window = special.i0(beta * np.sqrt(np.maximum(1 - (away / half) ** 2, 0.0))) / special.i0(beta)
        moved[:, some] += np.einsum(
            "tk,rtk->rt", cutoff * np.sinc(cutoff * away) * window, padded[:, places + half]
        )
    return moved


@checked
def to_acceleration(record: Record) -> Record:
    """Record as acceleration in m/s^2: velocity is differentiated once, displacement twice.

    Done by Fourier transform, so exact up to the Nyquist frequency; the line between the ends is subtracted and
    5 % at either end are faded in and out, because the transform assumes a periodic record.
    """
    if record.unit not in MOTION_UNITS:
        raise InputError(f"{record.source} is in {record.unit}; an acceleration needs m/s^2, m/s or m")
    order = MOTION_UNITS.index(record.unit)
    if order == 0:
        return record
    samples = record.signals.shape[1]
    faded = signal.detrend(record.signals, axis=1) * signal.windows.tukey(samples, 0.1)
    omega = 2 * np.pi * np.fft.rfftfreq(samples, 1 / record.sample_rate)
    moved = np.fft.irfft(np.fft.rfft(faded, axis=1) * (1j * omega) ** order, samples, axis=1)
    return replace(record, signals=moved, unit="m/s^2")


@checked
def sample_rate_of(times: ArrayLike, source: str = "time") -> float:
    """Rate in Hz of evenly spaced instants in s.

    A gap is a step of 1.5 periods or more; uneven is a step that differs from the period by more than a tenth of it,
    or an instant that leaves the even grid by a period.
    """
    t = require_array(f"{source}: time", times, ndim=1)
    if len(t) < 2:
        raise InputError(f"{source}: time holds {len(t)} instants; give at least 2")
    steps = np.diff(t)
    if np.any(steps <= 0):
        at = int(np.argmax(steps <= 0))
        raise InputError(
            f"{source}: time does not rise after row {at + 1} (t = {t[at]:.6g} s); sort or cut there"
        )
    period = float(np.median(steps))
    if np.any(steps >= 1.5 * period):
        at = int(np.argmax(steps >= 1.5 * period))
        raise InputError(
            f"{source}: {int(np.sum(steps >= 1.5 * period))} gap(s) in time, the first of {steps[at]:.4g} s after "
            f"t = {t[at]:.6g} s; cut the record there or fill the gap"
        )
    index = np.arange(len(t))
    slope, start = np.polyfit(index, t - t[0], 1)
    drift = np.abs(t - t[0] - (start + slope * index)) / slope
    jitter = np.abs(steps / period - 1)
    for share, tolerance, meaning in (
        (jitter, STEP_TOLERANCE, "a step differs from the period by"),
        (drift, DRIFT_TOLERANCE, "an instant is off the even grid by"),
    ):
        if share.max() > tolerance:
            raise InputError(
                f"{source}: time is uneven: {meaning} {share.max():.2g} periods at t = {t[share.argmax()]:.6g} s "
                f"({tolerance:g} allowed); interpolate to an even grid, or give sample_rate without the time"
            )
    return 1 / float(slope)


@checked
def sampling_rate(source: str, columns: dict[str, np.ndarray], stated: float | None = None) -> float:
    """Rate in Hz from a file's columns (a time or a scalar) or as stated; the two must agree to 1 %."""
    if stated is not None:
        require_number("sample_rate", stated, above=0.0)
    found = stated
    for name, column in columns.items():
        if is_time(name) and column.size > 1:
            found = sample_rate_of(np.ravel(column) * column_unit(name, "time")[0].factor, source)
        elif column.size == 1 and heading(name).quantity == "rate":
            hertz = column_unit(name, "rate")[0].factor
            found = hertz * require_number(f"{source}: {name}", column.item(), above=0.0)
        else:
            continue
        if stated is not None and abs(found - stated) > RATE_TOLERANCE * stated:
            raise InputError(
                f"sample_rate is {stated:g} Hz, but {name!r} of {source} gives {found:.6g} Hz; leave one out or correct it"
            )
    if found is None:
        raise InputError(f"{source} has no time and no rate; give sample_rate in Hz or a column named time")
    return float(found)


@checked
def is_time(name: str) -> bool:
    """Whether a column of that name holds the time."""
    return heading(name).quantity == "time"


def _require_whole(source: str, column: np.ndarray, rate: float) -> None:
    bad = ~np.isfinite(column)
    if bad.any():
        first = int(bad.argmax())
        raise InputError(
            f"{source}: {pluralise(int(bad.sum()), 'value')} missing or not finite, the first at t = {first / rate:.4g} s "
            f"(row {first + 1}); cut the record there or repair it"
        )
