"""Power spectral densities of motions from files: CSV, MAT or NPZ with a column of frequencies."""

from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, pluralise, require_choice
from stillwork.base.validation import checked
from stillwork.signals.datafiles import read_columns
from stillwork.signals.headings import column_unit, heading, in_hertz, is_bare_abscissa
from stillwork.signals.records import stated_unit, unknown_unit
from stillwork.signals.units import MOTION_UNITS, meaning, unit_factor

DENSITY_UNITS_TEXT = (
    "(m/s^2)^2/Hz, (m/s)^2/Hz, g^2/Hz or m/s^2/sqrt(Hz), for example, with m, u or n before a unit"
)
# What a column beside a frequency holds when it is a part of a response, and no density.
_PARTS = ("real", "imaginary", "magnitude", "phase", "coherence")


@checked
def density_unit(unit: str) -> tuple[str, int] | None:
    """Unit of the motion in a unit of a density, and the power to which the density has it; None for a record's."""
    found = meaning(unit)
    if found and found.power:
        return found.upper, found.power
    if "hz" in unit.lower():
        raise InputError(f"unit is {unit!r}; give a density as {DENSITY_UNITS_TEXT}")
    return None


@checked
def stated_density(name: str) -> str:
    """Unit of a density in a name, in brackets or at its end, as ``ground_m_rthz`` does; empty: none."""
    found = heading(name)
    return found.unit.replace("rtHz", "sqrt(Hz)") if found.meaning and found.meaning.power else ""


@checked
def spectra_of(columns: dict[str, np.ndarray]) -> dict[str, str]:
    """Names of the densities beside a frequency, each with the unit in its name; empty if there are none."""
    axis = frequency_axis(columns)
    others = {
        name: column
        for name, column in columns.items()
        if column.size > 1 and (heading(name).quantity != "frequency" or column.dtype.kind == "c")
    }
    if not axis or any(
        column.dtype.kind == "c" or (heading(name).quantity in _PARTS and not stated_density(name))
        for name, column in others.items()
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
    f = columns[axis]
    named = {
        name: column
        for name, column in columns.items()
        if column.size == f.size and heading(name).quantity != "frequency"
    }
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
    if np.any(np.diff(f) <= 0):
        again = f[1:][np.diff(f) <= 0][0]
        raise InputError(f"{path.name}: {axis!r} holds {again:.6g} Hz twice; leave one of the lines out")
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
    """Name of the column of frequencies, or of a bare X-Axis beside a response's parts; empty where there is none.

    Two that disagree are refused.
    """
    real = {name: column for name, column in columns.items() if column.size > 1 and column.dtype.kind != "c"}
    names = [name for name in real if heading(name).quantity == "frequency"]
    quantities = {heading(name).quantity for name in real}
    response = {"real", "imaginary"} <= quantities or {"magnitude", "phase"} <= quantities
    response = response or any(column.dtype.kind == "c" for column in columns.values())
    if not names and response and not {"time", "rate"} & quantities:
        names = [name for name in real if is_bare_abscissa(name)]
    for other in names[1:]:
        one, two = (hertz_in(name) * np.ravel(columns[name]) for name in (names[0], other))
        if one.shape != two.shape or not np.allclose(one, two, rtol=1e-3, equal_nan=True):
            raise InputError(f"{names[0]} and {other} are not the same frequencies; leave one of them out")
    return names[0] if names else ""


@checked
def hertz_in(axis: str) -> float:
    """Hz in the unit that the name of a column of frequencies states; without any 1 (``omega``: rad/s)."""
    return in_hertz(column_unit(axis, "frequency")[0])
