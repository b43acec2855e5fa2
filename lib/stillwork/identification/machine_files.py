"""Your own machine from a file: a measured frequency response, hammer records, or mass and stiffness."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64

from stillwork.base.checks import InputError, pluralise, require_array, require_choice, require_number
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.identification.frequency_response import Identified, impact_response
from stillwork.lti.modal import ModalModel, modal_model
from stillwork.signals.column_words import HOLDS
from stillwork.signals.datafiles import read_arrays
from stillwork.signals.densities import frequency_axis
from stillwork.signals.headings import column_unit, heading, in_hertz
from stillwork.signals.records import is_time, sampling_rate
from stillwork.signals.spectra import response_arrays
from stillwork.signals.units import DRIVES, MOVES, Reading, Unit, meaning, unit_factor

FORMS = (
    "a frequency response (frequency, and complex values or magnitude and phase), hammer records (force and "
    "response), or the matrices M and K"
)
PADDING = 4  # lengths of a record that has died out: zeros appended to it give a finer grid
LONGEST_HIT = 0.2  # part of a record during which the force may exceed a tenth of its peak
COHERENCE_ROUNDING = 1e-3  # by which a coherence may exceed 1
DIED_OUT = 0.02  # of the peak, what the last tenth of a record may still hold
_SILENT = ("frequency", "time", "rate", "phase", "coherence")  # their units are none of a machine's


@by_value
@dataclass(frozen=True)
class MachineFile:
    """The machine of a file: either its accelerance, or a modal model."""

    kind: str  # ``frequency response``, ``hammer records`` or ``matrices``
    source: str  # file name
    # acceleration over force in 1/kg, or in what `units` make of it; coherence is NaN where the file has none
    accelerance: Identified | None = None
    model: ModalModel | None = None  # from force to the position of every sensor
    notes: tuple[str, ...] = ()  # what was done to it
    units: tuple[str, str] = (
        "m",
        "N",
    )  # of the position and of what drives it: ("rad", "N m"), ("count", "A"), ...
    readings: tuple[Reading, ...] = ()  # what each column that was used was taken for; none of matrices
    cut_off: bool = False  # hammer records that still ring at their ends, which widens their resonances

    def __post_init__(self):
        check_fields(self)


@checked
def kind_of(arrays: dict[str, np.ndarray]) -> str:
    """``frequency response``, ``hammer records`` or ``matrices``; `InputError` when it is none of them."""
    words = {_word(name) for name in arrays}
    if {"m", "k"} <= words or {"mass", "stiffness"} <= words:
        return "matrices"
    if frequency_axis(arrays):
        return "frequency response"
    if any(heading(name).quantity == "force" for name in arrays):
        return "hammer records"
    raise InputError(f"it holds {_held(arrays)}, but not {FORMS}; name its columns like this")


def _held(arrays: Mapping[str, np.ndarray]) -> str:
    """Names and shapes."""
    shapes = {name: " x ".join(map(str, array.shape)) or "1" for name, array in arrays.items()}
    return ", ".join(f"{name} ({shape})" for name, shape in shapes.items()) or "nothing"


@checked(missing=True)
def load_machine(
    file: Any,
    response_unit: str = "",
    force_unit: str = "",
    *,
    sample_rate: float | None = None,
    response: str = "",
    damping_ratio: float = 0.005,
    read_as: Mapping[str, str] | None = None,
) -> MachineFile:
    """Read a machine from a CSV, MAT, NPZ or universal file; the names of its columns decide which of the three forms it is.

    - Frequency response: ``frequency`` (Hz, or in the unit that its name states: ``freq_rad_s``) and either a complex array, also one of
      outputs by inputs (`response` chooses, e.g. ``h[2,1]``), or ``real`` and ``imaginary``, or ``magnitude``
      (``(dB)`` behind it when it is) and ``phase`` (degrees, or ``(rad)``); ``coherence`` if there is one.
    - Hammer records: ``force`` and one response, each hits by samples (in CSV ``force 1``, ``force 2``, ...),
      and ``fs`` or a time. A single hit is enough, but gives no coherence.
    - Matrices in SI units: ``M`` and ``K``, perhaps ``D``; ``input``, the force's share at each node, and
      ``output``, one row per sensor (in CSV columns ``M 1``, ``M 2``, ... and ``output 1``, ...); without
      ``output`` the sensor sits where the force acts.

    Parameters
    ----------
    file : str or Path or control.FrequencyResponseData or tuple
        Or a frequency response at hand: one of python-control (its frequency is rad/s), or (frequencies in Hz, complex response).
    response_unit, force_unit : str
        Units of the response and the force, e.g. ``m/s^2``, ``g``, ``um`` and ``N``, ``kN``; empty: as stated in brackets in
        the file, else m/s^2 and N (N m for a rotation). A machine that turns is in ``rad`` (or
        ``rad/s``, ``rad/s^2``) and ``N m``; units of a drive are ``count`` and ``A`` or ``V``. For matrices they
        only name what these are in.
    sample_rate : float, optional
        Hz, of hammer records without a time or a rate.
    response : str
        Name of the complex response to use if there are several.
    damping_ratio : float
        Damping ratio of the flexible modes, for matrices without damping.
    read_as : mapping of str to str, optional
        Of a frequency response, the unit to read a quantity in whatever its name states: ``frequency`` in ``Hz`` or
        ``rad/s``, ``magnitude`` in ``dB`` or ``1`` (linear), ``phase`` in ``deg`` or ``rad``.

    Returns
    -------
    MachineFile
        The measurement in SI units, and which of the three forms it has.

    Raises
    ------
    InputError
        When the file cannot be used; the message states what to do.

    Examples
    --------
    >>> free = {"M": np.diag([8.0, 2.0]), "K": [[1e6, -1e6], [-1e6, 1e6]], "input": [1.0, 0.0]}
    >>> np.savez("stage.npz", **free)
    >>> identification.load_machine("stage.npz").kind
    'matrices'
    """
    arrays = read_arrays(file) if isinstance(file, str | Path) else response_arrays(file)
    file = Path(file if isinstance(file, str | Path) else "the response")
    try:
        kind = kind_of(arrays)
        if kind == "matrices":
            units = _machine_units(response_unit or "m", force_unit)
            factor = unit_factor(response_unit or "m")[0] / unit_factor(force_unit or units[2])[0]
            if factor != 1:
                raise InputError(
                    "matrices are in m and N, rad and N m or similar, without the prefixes m, u or k"
                )
            model = _from_matrices(arrays, damping_ratio)
            return MachineFile(kind, file.name, model=model, units=(units[0], units[2]))
        named = response.partition("[")[0]
        read = [each for each in (response, named) if each in arrays] or [
            name for name in arrays if name in _called(arrays, heading(name).quantity, response)
        ]
        agreed = agreed_units({name: arrays[name] for name in read}, response_unit, force_unit)
        if kind == "hammer records":
            found, notes, taken, cut_off = _from_hammer(arrays, sample_rate, file.name)
        else:
            found, notes, taken = _from_response(arrays, response, read_as or {})
            require_motion(taken)
            cut_off = False
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None
    scaled = agreed.accelerance(found.omega, found.response)
    readings = tuple(
        _in_units(
            each, agreed.response, agreed.force, written=agreed.note == (), hammer=kind == "hammer records"
        )
        for each in taken
    )
    return MachineFile(
        kind,
        file.name,
        found._replace(response=scaled),
        notes=notes + agreed.note,
        units=agreed.units,
        readings=readings,
        cut_off=cut_off,
    )


class AgreedUnits(NamedTuple):
    """Units of a response and of what drives it, as given and stated, and what makes an accelerance of it."""

    response: str
    force: str
    factor: float  # of the response, to SI
    derivatives: int  # that it lacks
    units: tuple[str, str]  # of the position and of what drives it
    note: tuple[str, ...]  # on what was assumed

    def accelerance(self, omega: np.ndarray, response: np.ndarray) -> np.ndarray:
        """The response as acceleration over force, its frequencies (rad/s) along the first axis."""
        lines = omega.reshape(-1, *[1] * (response.ndim - 1))
        return self.factor * response * (1j * lines) ** self.derivatives


@checked
def agreed_units(arrays: Mapping[str, np.ndarray], response_unit: str, force_unit: str) -> AgreedUnits:
    """Units of the response and the force in these arrays: those given, else stated in their names, else m/s^2 and N."""
    _require_known(name for name, each in arrays.items() if each.size > 1 or heading(name).quantity)
    stated = stated_units(response_names(arrays))
    response_unit = _agreed("response_unit", response_unit, stated[0])
    force_unit = _agreed("force_unit", force_unit, stated[1])
    silent = [name for name, unit in (("response", response_unit), ("force", force_unit)) if not unit]
    response_unit = response_unit or "m/s^2"
    position, derivatives, drive = _machine_units(response_unit, force_unit)
    force_unit = force_unit or drive
    factor = unit_factor(response_unit)[0] / unit_factor(force_unit)[0]
    note = f"the unit of {' and '.join(silent)} is not stated; assumed: {response_unit} over {force_unit}"
    return AgreedUnits(
        response_unit, force_unit, factor, derivatives, (position, drive), (note,) if silent else ()
    )


def _in_units(each: Reading, response: str, force: str, *, written: bool, hammer: bool) -> Reading:
    """A reading of the response or the force with the units that `load_machine` agreed on."""
    if each.quantity in ("magnitude", "real", "imaginary", "complex"):
        unit = heading(each.column).meaning
        decibels = f"dB re {unit.reference if unit else 1:g} " if each.unit.lower().startswith("db") else ""
        return replace(each, unit=f"{decibels}{response}/{force}", written=written)
    if hammer and each.quantity in ("force", "response"):
        return replace(each, unit=force if each.quantity == "force" else response, written=written)
    return each


@checked(missing=True)
def load_ratio(file: str | Path, response: str = "") -> Identified:
    """A frequency response without unit (a ratio of two quantities of one unit) from a file, as `load_machine` reads it."""
    file = Path(file)
    arrays = read_arrays(file)
    if not frequency_axis(arrays):
        raise InputError(f"{file.name} holds {', '.join(arrays) or 'nothing'}, and no frequency; name it so")
    try:
        _require_known(arrays)
        found, _, readings = _from_response(arrays, response)
        for each in readings:
            unit = heading(each.column).meaning
            if each.quantity not in _SILENT and unit and unit.si not in ("1", unit.lower_si):
                raise InputError(
                    f"{each.column}: a ratio of two quantities of one unit has none; give such a ratio"
                )
        return found
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None


def _machine_units(response_unit: str, force_unit: str) -> tuple[str, int, str]:
    """Unit of the position, how many derivatives the response lacks, and the unit of what drives it."""
    _, unit = unit_factor(response_unit)
    if unit not in MOVES:
        raise InputError(
            f"response_unit is {response_unit!r}; give an acceleration, a velocity or a position"
        )
    position, derivatives = MOVES[unit]
    _, drive = unit_factor(force_unit or ("N m" if position == "rad" else "N"))
    if drive not in DRIVES:
        raise InputError(
            f"force_unit is {force_unit!r}; give a force such as N or kN, a torque N m, or A or V"
        )
    return position, derivatives, drive


@checked
def complex_responses(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Every complex response by name; those of a matrix of outputs by inputs as ``h[1,1]``, ``h[2,1]``, ..."""
    axis = frequency_axis(arrays)
    if not axis:
        raise InputError(f"arrays holds {', '.join(arrays) or 'nothing'}, and no frequency; name it so")
    lines = arrays[axis].size
    found = {}
    for name, array in arrays.items():
        axes = [axis for axis, length in enumerate(array.shape) if length == lines]
        if array.dtype.kind != "c" or not axes or lines == 1:
            continue
        rows = np.moveaxis(array, axes[0] if len(axes) == 1 else -1, -1)
        for place in np.ndindex(rows.shape[:-1]):
            numbers = ",".join(str(k + 1) for k in place)
            found[f"{name}[{numbers}]" if array.size > lines else name] = rows[place]
    return found


@checked
def response_names(arrays: Mapping[str, np.ndarray]) -> list[str]:
    """Names that may state the unit of a frequency response; of other files all. What stands beside it may hold anything."""
    if not frequency_axis(arrays):
        return list(arrays)
    parts = ("magnitude", "real", "imaginary")
    return [
        name for name, array in arrays.items() if np.iscomplexobj(array) or heading(name).quantity in parts
    ]


@checked
def stated_units(names: Iterable[str]) -> tuple[str, str]:
    """Units of response and force from brackets such as ``(m/s^2/N)``, ``((m/s2)/N)``, ``(g)`` and ``(N)``; empty: none."""
    units: dict[str, str] = {}
    for name in names:
        found = heading(name)
        unit = found.meaning
        if unit is None or unit.power or found.quantity in _SILENT:
            continue
        stated = {}
        if unit.ratio:
            stated = {"response": unit.upper, "force": unit.lower}
        elif not unit.lower and unit.si in MOVES and found.quantity != "force":
            stated = {"response": unit.upper}
        elif not unit.lower and unit.si in DRIVES:
            stated = {"force": unit.upper}
        for kind, text in stated.items():
            if unit_factor(units.setdefault(kind, text)) != unit_factor(text):
                raise InputError(
                    f"the {kind} is in {units[kind]} and in {text}, and columns of mixed units are not taken; give those of one unit "
                    "in a file of their own, or, of a matrix, leave the units (SI) out of the names and state sensing and units in a "
                    "table [decoupling]"
                )
    return units.get("response", ""), units.get("force", "")


def _require_known(names: Iterable[str]) -> None:
    """Refuse a name that holds a unit which is not known, or none of its quantity."""
    for name in names:
        found = heading(name)
        if (
            found.meaning
            and found.quantity in ("acceleration", "velocity", "position")
            and found.meaning.si not in HOLDS[found.quantity][1]
        ):
            found = replace(found, unknown=found.unit)  # counts of an accelerometer
        refusal = found.refusal(found.quantity or "real")
        if refusal and (inverse := _inverse(found.unknown)):
            raise InputError(
                f"{name}: {found.unknown!r} is a force over a motion, the inverse of a response; give 1 over its numbers, the "
                f"phase with the other sign, and name them so: {inverse}"
            )
        if refusal:
            raise InputError(
                f"{name}: {refusal}; give response_unit and force_unit where they differ from m/s^2 and N, and where this "
                "column is not the response, a part of the name of the one that is, as response"
            )


def _inverse(unit: str) -> str:
    """The unit of the response of which one of a mass, a damper or a stiffness, such as N/(m/s^2), is the inverse; or nothing."""
    upper, _, lower = unit.partition("/")
    lower = lower.strip("()[] ")
    turned = meaning(f"{lower}/{upper}")
    return f"{lower}/{upper}" if turned and turned.ratio else ""


def require_motion(taken: Iterable[Reading]) -> None:
    """Refuse a response whose unit is written, and none of a motion over what drives it."""
    for each in taken:
        unit = heading(each.column).meaning
        if each.quantity in ("magnitude", "real", "imaginary", "complex") and unit and not unit.ratio:
            if unit.lower or unit.si not in (*MOVES, "1"):
                raise InputError(
                    f"{each.column}: {heading(each.column).unit} is no motion over a force or over another drive; multiply it by "
                    "what the sensor has for a unit, and name it e.g. magnitude (m/s^2/N)"
                )


def _agreed(name: str, given: str, stated: str) -> str:
    """The unit that is given or stated in the file; `InputError` when they are two."""
    if given and stated and unit_factor(given) != unit_factor(stated):
        raise InputError(
            f"{name} is {given!r}, but the file states {stated!r}; leave it out, or correct the file"
        )
    return given or stated


def _from_response(
    arrays: dict[str, np.ndarray], response: str, read_as: Mapping[str, str] | None = None
) -> tuple[Identified, tuple[str, ...], list[Reading]]:
    axis = frequency_axis(arrays)  # there is one: `kind_of` found it
    unit, reading = column_unit(axis, "frequency", (read_as or {}).get("frequency", ""))
    hertz = in_hertz(unit) * require_array(axis, np.ravel(arrays[axis]), ndim=1)
    same = {
        name: np.ravel(array) for name, array in arrays.items() if array.size == hertz.size and name != axis
    }
    same |= complex_responses(arrays)
    values, readings = one_response(arrays, same, response, read_as or {})
    notes = tuple(f"taken: {each.column}" for each in readings if each.quantity == "complex")
    values = require_array("response", values, dtype=complex)
    seen = np.full(hertz.size, np.nan)
    if len(names := _called(same, "coherence", response)) > 1:
        raise InputError(f"it holds several coherences ({', '.join(names)}); leave all but one out")
    for name in names:
        unit, taken = column_unit(name, "coherence")
        seen, readings = unit.factor * same[name].real, [*readings, taken]
        if np.nanmax(seen, initial=0.0) > 1 + COHERENCE_ROUNDING:
            raise InputError(
                f"{name} reaches {np.nanmax(seen):.4g}, and a coherence is at most 1; name it coherence (%) if it is in per cent"
            )
    if np.any(np.diff(hertz) <= 0):
        raise InputError("the frequency does not rise from line to line; sort the rows")
    kept = (hertz > 0) & (np.abs(values) > 0)
    if kept.sum() < 32:
        raise InputError(f"{int(kept.sum())} usable lines are too few for a fit; give at least 32")
    found = Identified(2 * np.pi * hertz[kept], values[kept], seen[kept].astype(float))
    return found, notes, [reading, *readings]


def one_response(
    arrays: dict[str, np.ndarray], same: dict[str, np.ndarray], response: str, read_as: Mapping[str, str]
) -> tuple[np.ndarray, list[Reading]]:
    """The complex response of columns of one length, in the unit that these state, and what they were taken for."""
    complex_ones = [name for name in same if np.iscomplexobj(same[name])]
    if len(complex_ones) > 1 and not response:
        raise InputError(
            f"it holds {len(complex_ones)} responses ({', '.join(complex_ones)}); choose one as response"
        )
    if complex_ones:
        parted = [name for name in complex_ones if response in name]
        name = parted[0] if len(parted) == 1 else require_choice("response", response, complex_ones)
        unit = heading(name).meaning
        if unit and (unit.decibels or unit.power):
            raise InputError(
                f"{name}: complex values in {heading(name).unit} are no response; give them linear"
            )
        return same[name], [Reading("complex", "", name, False)]
    pairs = {
        each: [_called(same, quantity, response) for quantity in each]
        for each in (("real", "imaginary"), ("magnitude", "phase"))
    }
    whole = {
        pair: [names[0] for names in each] for pair, each in pairs.items() if [*map(len, each)] == [1, 1]
    }
    if not whole and (
        several := [name for each in pairs.values() for names in each if all(each) for name in names]
    ):
        raise InputError(
            f"it holds several responses ({', '.join(several)}); choose with a part of their names as response, or leave some out, "
            "or name the entries of a matrix h11, h12, ..."
        )
    if not whole:
        raise InputError(
            f"there is no response beside the frequency in {_held(arrays)}; give complex values, real and imaginary, or "
            "magnitude and phase"
        )
    (first, second), names = next(iter(whole.items()))
    (one, taken), (other, also) = (
        column_unit(name, each, read_as.get(each, ""))
        for name, each in zip(names, (first, second), strict=True)
    )
    x, y = (same[name] for name in names)
    if first == "real":
        # A unit other than 1 and % is the response's, which `load_machine` knows.
        return _plain(one) * x + 1j * _plain(other) * y, [taken, also]
    if not one.decibels and np.any(x < 0):
        raise InputError(
            f"{names[0]} falls to {np.nanmin(x):.4g}, and no linear magnitude is negative; "
            f"name it {_in_decibels(names[0])} if it is in dB"
        )
    size = one.reference * 10 ** (x / 20) if one.decibels else x
    return _plain(one) * size * np.exp(1j * other.factor * y), [taken, also]


def _in_decibels(name: str) -> str:
    """A magnitude's name as it would be in dB: re 1 of the unit of a response, where it has one."""
    unit = heading(name).unit
    if "/" in unit:
        return name.replace(unit, f"dB re 1 {unit}")
    return f"{name.partition('(')[0].strip()} (dB)"


def _plain(unit: Unit) -> float:
    return unit.factor if unit.si == "1" else 1.0


def _called(same: Mapping[str, np.ndarray], quantity: str, response: str) -> list[str]:
    """The names of the columns of a quantity, or those of them that `response` is a part of."""
    names = [name for name in same if heading(name).quantity == quantity]
    return [name for name in names if response and response in name] or names


def _from_hammer(
    arrays: dict[str, np.ndarray], sample_rate: float | None, source: str
) -> tuple[Identified, tuple[str, ...], list[Reading], bool]:
    rate = sampling_rate(source, arrays, sample_rate)
    forces = [name for name in arrays if heading(name).quantity == "force" and arrays[name].size > 1]
    if not forces:
        raise InputError("the force holds one number; give its samples, hits by samples")
    length = max(arrays[name].shape[-1] for name in forces)
    responses = [
        name
        for name, array in arrays.items()
        if name not in forces and not is_time(name) and array.size >= length
    ]
    force, response = (_hits(arrays, names) for names in (forces, responses))
    if force.shape != response.shape:
        raise InputError(
            f"force holds {pluralise(len(force), 'hit')} of {pluralise(force.shape[1], 'sample')} ({', '.join(forces)}), the response "
            f"{len(response)} of {response.shape[-1]} ({', '.join(responses) or 'none'}); give one response per hit"
        )
    for name, rows in (("force", force), ("response", response)):
        if np.any(np.ptp(rows, axis=1) == 0):
            raise InputError(
                f"{name} does not move in hit {int(np.argmin(np.ptp(rows, axis=1))) + 1}; leave it out"
            )
    if (share := np.mean(np.abs(force) > 0.1 * np.abs(force).max(axis=1, keepdims=True))) > LONGEST_HIT:
        raise InputError(
            f"force acts during {100 * share:.0f} % of the record, which is no hit; give a frequency response instead"
        )
    # A record's own offset must go before zeros are appended to it.
    force, response = (
        rows - rows[:, -rows.shape[1] // 10 :].mean(axis=1, keepdims=True) for rows in (force, response)
    )
    tail = np.abs(response[:, -response.shape[1] // 10 :]).max(axis=1) / np.abs(response).max(axis=1)
    notes = [f"{len(force)} hits" if len(force) > 1 else "1 hit: the coherence needs at least two"]
    cut_off = bool(tail.max() > DIED_OUT)
    if not cut_off:
        force, response = (
            np.pad(rows, ((0, 0), (0, (PADDING - 1) * rows.shape[1]))) for rows in (force, response)
        )
    else:
        notes.append(
            f"the response still holds {100 * tail.max():.0f} % of its peak at the end of a record: "
            "the cut widens its resonances; record longer"
        )
    readings = [Reading("force", "", name, False) for name in forces]
    readings += [Reading("response", "", name, False) for name in responses]
    return impact_response(force, response, rate), tuple(notes), readings, cut_off


def _hits(arrays: dict[str, np.ndarray], names: list[str]) -> Float64[np.ndarray, "hits samples"]:
    rows = []
    for name in names:
        array = np.atleast_2d(require_array(name, arrays[name]))
        if array.ndim > 2:
            raise InputError(f"{name} has shape {array.shape}; give hits by samples")
        rows += list(array if array.shape[0] <= array.shape[1] else array.T)
    if len({len(row) for row in rows}) > 1:
        raise InputError(f"{', '.join(names)} differ in length; give hits of one length")
    return np.array(rows, dtype=float).reshape(len(rows), -1)


def _from_matrices(arrays: dict[str, np.ndarray], damping_ratio: float) -> ModalModel:
    mass, stiffness = (_matrix(arrays, *names) for names in (("m", "mass"), ("k", "stiffness")))
    if mass is None or stiffness is None:
        raise InputError(
            "M or K holds one number; give matrices of 2 nodes at least, or it has no flexible mode"
        )
    damping = _matrix(arrays, "d", "c", "damping")
    nodes = len(mass)
    taken = _matrix(arrays, "input")
    if taken is None:
        raise InputError(
            "input is missing; give the force's share at each node, e.g. 1 at one and 0 elsewhere"
        )
    if taken.size != nodes:
        raise InputError(
            f"input holds {pluralise(taken.size, 'number')} for {pluralise(nodes, 'node')}; give the force's share at each"
        )
    outputs = _matrix(arrays, "output")
    outputs = taken.reshape(1, nodes) if outputs is None else np.atleast_2d(outputs)
    if outputs.shape[1] != nodes and outputs.shape[0] == nodes:
        outputs = outputs.T
    return modal_model(
        require_array("M", mass, shape=(nodes, nodes)),
        require_array("K", stiffness, shape=(nodes, nodes)),
        taken.reshape(nodes, 1),
        require_array("output", outputs, shape=(None, nodes)),
        damping_ratio=require_number("damping_ratio", damping_ratio, at_least=0.0, below=1.0),
        damping_matrix=damping,
    )


def _matrix(arrays: dict[str, np.ndarray], *words: str) -> np.ndarray | None:
    """An array of that name, or the columns ``name 1``, ``name 2``, ... put together."""
    columns = [array for name, array in arrays.items() if _word(name) in words and array.size > 1]
    if not columns:
        return None
    if any(column.dtype.kind == "c" for column in columns):
        raise InputError(f"{words[0].upper()} is complex; give real matrices")
    if len(columns) == 1:
        return np.squeeze(columns[0]).astype(float)
    if len({column.shape for column in columns}) > 1:
        raise InputError(f"the columns of {words[0].upper()} differ in length; give a full table")
    return np.column_stack([column.ravel() for column in columns]).astype(float)


def _word(name: str) -> str:
    """First word of a name, without the structure that it is a member of: ``force_n`` and ``force (N)`` are force."""
    return re.split(r"[\s(\[{（_\d]", name.lower().rpartition(".")[2].strip(), maxsplit=1)[0]
