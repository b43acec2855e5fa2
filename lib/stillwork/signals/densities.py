"""Power spectral densities of motions from files: CSV, MAT or NPZ with a column of frequencies."""

import re
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, pluralise, require_choice
from stillwork.base.validation import checked
from stillwork.signals.datafiles import read_columns
from stillwork.signals.records import (
    BRACKETS,
    LAST_BRACKETS,
    MOTION_UNITS,
    stated_unit,
    unit_factor,
    unknown_unit,
)

DENSITY_UNITS_TEXT = (
    "(m/s^2)^2/Hz, (m/s)^2/Hz, g^2/Hz or m/s^2/sqrt(Hz), for example, with m, u or n before a unit"
)
# What a column beside a frequency is called when it is a part of a response, and no density.
_PARTS = re.compile(r"\b(re|real|im|imag|imaginary|mag|magnitude|amplitude|gain|phase|angle|coherence|coh)\b")
_SUFFIX = re.compile(r"_([munpk]?[mg])(_s2|_s)?_(rthz|sqrthz|2_hz)$")
# Units of a column of frequencies, in lower case; mhz is mHz, since floors have these and no column here is in MHz.
HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e-3, "rad/s": 1 / (2 * np.pi)}
_FREQUENCY_WORDS = ("frequency", "frequencies", "freq", "f", "hz")


@checked
def density_unit(unit: str) -> tuple[str, int] | None:
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
        raise InputError(f"unit is {unit!r}; give a density as {DENSITY_UNITS_TEXT}")
    return None


@checked
def stated_density(name: str) -> str:
    """Unit of a density in a name, in brackets or at its end, as ``ground_m_rthz`` does; empty: none."""
    if found := LAST_BRACKETS.search(name):
        try:
            return found[1] if density_unit(found[1]) else ""
        except InputError:
            return ""
    if found := _SUFFIX.search(name.strip().lower()):
        motion = found[1] + {"_s2": "/s^2", "_s": "/s", None: ""}[found[2]]
        return f"({motion})^2/Hz" if found[3] == "2_hz" else f"{motion}/sqrt(Hz)"
    return ""


@checked
def spectra_of(columns: dict[str, np.ndarray]) -> dict[str, str]:
    """Names of the densities beside a frequency, each with the unit in its name; empty if there are none."""
    axis = frequency_axis(columns)
    others = {name: column for name, column in columns.items() if name != axis and column.size > 1}
    if not axis or any(
        column.dtype.kind == "c" or _PARTS.search(name.lower()) for name, column in others.items()
    ):
        return {}
    return {name: stated_density(name) for name in others}


@checked
def read_densities(path: Path, unit: str, channels: list[str], most: int) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and acceleration PSDs in (m/s^2)^2/Hz, (channels, frequencies), of a file of spectra.

    `unit` is that of the spectra whose names state none, in brackets (``x (m/s^2/sqrt(Hz))``) or at their end
    (``x_m_s2_rthz``, `stated_density`); a name that states another is refused.
    """
    columns = read_columns(path)
    axis = frequency_axis(columns)
    if not axis:
        raise InputError(
            f"{path.name} has no column named frequency (in Hz), which densities need; name it, or give the unit of a "
            "record"
        )
    f = columns.pop(axis)
    named = {name: column for name, column in columns.items() if column.size == f.size}
    for name in channels:
        require_choice(f"spectrum of {path.name}", name, named)
    named = {name: named[name] for name in channels} if channels else named
    if not 0 < len(named) <= most:
        raise InputError(
            f"{path.name} holds {len(named)} spectra ({', '.join(named)}) beside {axis!r}; choose 1 to {most}"
        )
    scales = [_scale(path.name, name, unit) for name in named]
    f = hertz_in(axis) * f
    known = f > 0
    if known.sum() < 2:
        raise InputError(
            f"{path.name}: {axis!r} holds {pluralise(known.sum(), 'frequency')} above zero; give at least 2"
        )
    rows = np.array(list(named.values()))[:, known]
    if not np.isfinite(rows).all() or np.any(rows < 0):
        raise InputError(f"{path.name} holds a density that is missing, infinite or negative; correct it")
    order = np.argsort(f[known], kind="stable")  # some analysers write the highest frequency first
    f, rows = f[known][order], rows[:, order]
    squares = [
        factor**2 * (row**2 if power == 1 else row) * (2 * np.pi * f) ** (2 * derivatives)
        for row, (factor, power, derivatives) in zip(rows, scales, strict=True)
    ]
    return f, np.array(squares)


def _scale(source: str, name: str, unit: str) -> tuple[float, int, int]:
    """Factor to SI of the motion, the power to which the density has it, and derivatives that lack to acceleration."""
    stated = agreed_density(source, name, unit)
    if not stated:
        raise InputError(
            f"unit is not given, and {source} states none for {name!r}; give a density as {DENSITY_UNITS_TEXT}"
        )
    return _meaning(stated)


@checked
def agreed_density(source: str, name: str, unit: str) -> str:
    """Unit of a density that its name states, or the one given; never two that differ, and empty where there is none."""
    stated = stated_density(name)
    if unit and not stated and (odd := unknown_unit(name) or stated_unit(name)):
        raise InputError(
            f"unit is {unit!r}, but {source} names the spectrum {name!r}, and {odd!r} is no density; convert the spectrum to "
            f"{unit} and name it so, or leave the brackets out of its name"
        )
    if unit and stated and _factors(unit) != _factors(stated):
        raise InputError(
            f"unit is {unit!r}, but {source} names the spectrum {name!r}; leave it empty, or correct one of them"
        )
    return stated or unit


def _factors(unit: str) -> tuple | None:
    unit_and_power = density_unit(unit)
    return unit_and_power and (unit_factor(unit_and_power[0]), unit_and_power[1])


def _meaning(unit: str) -> tuple[float, int, int]:
    if not (unit_and_power := density_unit(unit)):
        raise InputError(f"unit is {unit!r}; give a density as {DENSITY_UNITS_TEXT}")
    factor, si_unit = unit_factor(unit_and_power[0])
    if si_unit not in MOTION_UNITS:
        raise InputError(f"unit is {unit!r}; a floor needs a density of m/s^2, m/s or m")
    return factor, unit_and_power[1], MOTION_UNITS.index(si_unit)


@checked
def frequency_axis(columns: dict[str, np.ndarray]) -> str:
    """Name of the column of frequencies; empty where there is none."""
    for name, column in columns.items():
        words = re.split(r"[\s_(\[{（.]", name.strip().lower())
        if words[0] in _FREQUENCY_WORDS and column.size > 1 and column.dtype.kind != "c":
            return name
    return ""


@checked
def hertz_in(axis: str) -> float:
    """Hz in the unit behind the name of a column of frequencies, in brackets or after ``_``; without any 1.

    Another unit in brackets is refused.
    """
    if found := BRACKETS.search(axis):
        unit = found[1].strip()
        unit = unit if unit == "MHz" else unit.lower()  # which is refused: it is no mHz
        return HERTZ[require_choice(f"{axis}: unit", unit, HERTZ)]
    return HERTZ.get(axis.strip().lower().rpartition("_")[2], 1.0)
