"""Your own machine from a file: a measured frequency response, hammer records, or mass and stiffness."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from stillwork.base.checks import InputError, pluralise, require_array, require_choice, require_number
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.identification.frequency_response import Identified, impact_response
from stillwork.lti.modal import ModalModel, modal_model
from stillwork.signals.datafiles import read_arrays
from stillwork.signals.records import LAST_BRACKETS, UNITS_TEXT, is_time, sampling_rate, unit_factor
from stillwork.signals.units import Reading

FORMS = (
    "a frequency response (frequency, and complex values or magnitude and phase), hammer records (force and "
    "response), or the matrices M and K"
)
POSITIONS, DRIVES = ("m", "rad", "count"), ("N", "N m", "A", "V")
# Of an acceleration, a velocity and a position
MOVES = {f"{each}{over}": (each, k) for each in POSITIONS for k, over in enumerate(("/s^2", "/s", ""))}
PADDING = 4  # lengths of a record that has died out: zeros appended to it give a finer grid
LONGEST_HIT = 0.2  # part of a record during which the force may exceed a tenth of its peak
DIED_OUT = 0.02  # of the peak, what the last tenth of a record may still hold
_PLAIN = ("", "-", "1", "s", "ms", "rad", "deg", "degrees", "°")  # in brackets of time, phase and coherence
_FREQUENCIES = ("frequency", "frequencies", "freq", "freqs", "f", "hz", "hertz", "omega")
_ANGLES = (*_FREQUENCIES, "phase", "angle", "w")
_HERTZ = {"hz": 1.0, "khz": 1e3, "rad/s": 1 / (2 * np.pi)}


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

    def __post_init__(self):
        check_fields(self)


@checked
def kind_of(arrays: dict[str, np.ndarray]) -> str:
    """``frequency response``, ``hammer records`` or ``matrices``; `InputError` when it is none of them."""
    words = {_word(name) for name in arrays}
    if {"m", "k"} <= words or {"mass", "stiffness"} <= words:
        return "matrices"
    if _frequency_name(arrays):
        return "frequency response"
    if "force" in words or "hammer" in words:
        return "hammer records"
    raise InputError(
        f"it holds {', '.join(arrays) or 'nothing'}, but not {FORMS}; name its columns like this"
    )


@checked(missing=True)
def load_machine(
    file: str | Path,
    response_unit: str = "",
    force_unit: str = "",
    *,
    sample_rate: float | None = None,
    response: str = "",
    damping_ratio: float = 0.005,
    read_as: Mapping[str, str] | None = None,
) -> MachineFile:
    """Read a machine from a CSV, MAT, NPZ or universal file; the names of its columns decide which of the three forms it is.

    - Frequency response: ``frequency`` (Hz, or with ``(rad/s)`` behind it) and either a complex array, also one of
      outputs by inputs (`response` chooses, e.g. ``h[2,1]``), or ``real`` and ``imaginary``, or ``magnitude``
      (``(dB)`` behind it when it is) and ``phase`` (degrees, or ``(rad)``); ``coherence`` if there is one.
    - Hammer records: ``force`` and one response, each hits by samples (in CSV ``force 1``, ``force 2``, ...),
      and ``fs`` or a time. A single hit is enough, but gives no coherence.
    - Matrices in SI units: ``M`` and ``K``, perhaps ``D``; ``input``, the force's share at each node, and
      ``output``, one row per sensor (in CSV columns ``M 1``, ``M 2``, ... and ``output 1``, ...); without
      ``output`` the sensor sits where the force acts.

    Parameters
    ----------
    file : str or Path
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
    file = Path(file)
    arrays = read_arrays(file)
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
        read = [each for each in (response, named) if each in arrays] or list(arrays)
        stated = stated_units(read)
        response_unit = _agreed("response_unit", response_unit, stated[0])
        force_unit = _agreed("force_unit", force_unit, stated[1])
        silent = [name for name, unit in (("response", response_unit), ("force", force_unit)) if not unit]
        response_unit = response_unit or "m/s^2"
        if unknown := _unknown_unit(read):
            raise InputError(
                f"{unknown}: the unit is not known; convert it to one of {UNITS_TEXT} and name it so, or leave the brackets "
                "out of the name and give response_unit and force_unit"
            )
        position, derivatives, drive = _machine_units(response_unit, force_unit)
        force_unit = force_unit or drive
        factor, force = unit_factor(response_unit)[0], unit_factor(force_unit)[0]
        if kind == "hammer records":
            found, notes, taken = _from_hammer(arrays, sample_rate, file.name)
        else:
            found, notes, taken = _from_response(arrays, response, read_as or {})
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None
    if silent:
        notes += (
            f"the unit of {' and '.join(silent)} is not stated; assumed: {response_unit} over {force_unit}",
        )
    scaled = factor / force * found.response * (1j * found.omega) ** derivatives
    readings = tuple(
        _in_units(each, response_unit, force_unit, written=silent == [], hammer=kind == "hammer records")
        for each in taken
    )
    return MachineFile(
        kind,
        file.name,
        found._replace(response=scaled),
        notes=notes,
        units=(position, drive),
        readings=readings,
    )


def _in_units(each: Reading, response: str, force: str, *, written: bool, hammer: bool) -> Reading:
    """A reading of the response or the force with the units that `load_machine` agreed on."""
    if each.quantity in ("magnitude", "real", "imaginary", "complex"):
        decibels = "dB re 1 " if each.unit == "dB" else ""
        return replace(each, unit=f"{decibels}{response}/{force}", written=written)
    if hammer and each.quantity in ("force", "response"):
        return replace(each, unit=force if each.quantity == "force" else response, written=written)
    return each


@checked(missing=True)
def load_ratio(file: str | Path, response: str = "") -> Identified:
    """A frequency response without unit (a ratio of two quantities of one unit) from a file, as `load_machine` reads it."""
    file = Path(file)
    arrays = read_arrays(file)
    if _frequency_name(arrays) is None:
        raise InputError(f"{file.name} holds {', '.join(arrays) or 'nothing'}, and no frequency; name it so")
    try:
        return _from_response(arrays, response)[0]
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
    axis = _frequency_name(arrays)
    if axis is None:
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
def stated_units(names: Iterable[str]) -> tuple[str, str]:
    """Units of response and force from brackets such as ``(m/s^2/N)``, ``((m/s2)/N)``, ``(g)`` and ``(N)``; empty: none."""
    units: dict[str, str] = {}
    for name in names:
        whole = _in_brackets(name)
        top, _, below = whole.rpartition("/")
        top, below = top.strip("() "), below.strip("() ")
        if is_unit(top, tuple(MOVES)) and is_unit(below, DRIVES):
            stated = {"response": top, "force": below}
        else:
            kinds = (("response", tuple(MOVES)), ("force", DRIVES))
            # rad and rad/s behind a phase and a frequency are no motion of the machine.
            stated = {
                kind: whole for kind, wanted in kinds if _word(name) not in _ANGLES and is_unit(whole, wanted)
            }
        for kind, unit in stated.items():
            if unit_factor(units.setdefault(kind, unit)) != unit_factor(unit):
                raise InputError(
                    f"the {kind} is in {units[kind]} and in {unit}; give one unit to all of its columns"
                )
    return units.get("response", ""), units.get("force", "")


def _in_brackets(name: str) -> str:
    """What stands in the brackets at the end of a name, after ``dB re 1``."""
    found = LAST_BRACKETS.search(name)
    return re.sub(r"(?i)^dB\b\s*((re\s*)?1\s+|re\s+)?", "", found[1]) if found else ""


def _unknown_unit(names: Iterable[str]) -> str:
    """The first name whose brackets hold nothing that is known of a machine; empty when there is none."""
    for name in names:
        if _in_brackets(name).lower() not in (*_PLAIN, *_HERTZ) and stated_units([name]) == ("", ""):
            return name
    return ""


@checked
def is_unit(text: str, wanted: tuple[str, ...]) -> bool:
    """Whether `text` is a unit of one of these SI units."""
    try:
        return unit_factor(text)[1] in wanted
    except InputError:
        return False


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
    read_as = read_as or {}
    axis = str(_frequency_name(arrays))  # there is one: `kind_of` found it
    written = _bracket(axis)
    unit = read_as.get("frequency", "").lower() or written or ("rad/s" if _word(axis) == "omega" else "hz")
    per_hertz = _HERTZ[require_choice(f"{axis}: unit", unit, _HERTZ)]
    hertz = per_hertz * require_array(axis, np.ravel(arrays[axis].real), ndim=1)
    spelled = {"hz": "Hz", "khz": "kHz", "rad/s": "rad/s"}[unit]
    readings = [Reading("frequency", spelled, axis, bool(written) or _word(axis) == "omega")]
    notes = []
    same = {
        name: np.ravel(array) for name, array in arrays.items() if array.size == hertz.size and name != axis
    }
    same |= complex_responses(arrays)
    complex_ones = [name for name in same if np.iscomplexobj(same[name])]
    if complex_ones:
        if len(complex_ones) > 1 and not response:
            raise InputError(
                f"it holds {len(complex_ones)} responses; choose with response={complex_ones[0]!r}"
            )
        name = require_choice("response", response or complex_ones[0], complex_ones)
        values = same[name]
        notes.append(f"taken: {name}")
        readings.append(Reading("complex", "", name, False))
    elif (real := _named(same, "real", "re")) and (imaginary := _named(same, "imaginary", "imag", "im")):
        values = same[real] + 1j * same[imaginary]
        readings += [Reading("real", "", real, False), Reading("imaginary", "", imaginary, False)]
    elif (size := _named(same, "magnitude", "mag", "amplitude", "gain")) and (
        angle := _named(same, "phase", "angle")
    ):
        decibels = read_as.get("magnitude", _bracket(size)).lower().startswith("db")
        radians = read_as.get("phase", _bracket(angle)) == "rad"
        sizes = 10 ** (same[size] / 20) if decibels else same[size]
        values = sizes * np.exp(1j * (same[angle] if radians else np.radians(same[angle])))
        readings += [
            Reading("magnitude", "dB" if decibels else "", size, bool(_bracket(size))),
            Reading("phase", "rad" if radians else "deg", angle, bool(_bracket(angle))),
        ]
    else:
        raise InputError(
            "there is no response beside the frequency; give complex values, real and imaginary, or magnitude "
            "and phase"
        )
    values = require_array("response", values, dtype=complex)
    coherence = _named(same, "coherence", "coh")
    seen = np.full(hertz.size, np.nan) if coherence is None else same[coherence].real
    if coherence:
        readings.append(Reading("coherence", "1", coherence, False))
    if np.any(np.diff(hertz) <= 0):
        raise InputError("the frequency does not rise from line to line; sort the rows")
    kept = (hertz > 0) & (np.abs(values) > 0)
    if kept.sum() < 32:
        raise InputError(f"{int(kept.sum())} usable lines are too few for a fit; give at least 32")
    found = Identified(2 * np.pi * hertz[kept], values[kept], seen[kept].astype(float))
    return found, tuple(notes), readings


def _from_hammer(
    arrays: dict[str, np.ndarray], sample_rate: float | None, source: str
) -> tuple[Identified, tuple[str, ...], list[Reading]]:
    rate = sampling_rate(source, arrays, sample_rate)
    forces = [name for name in arrays if _word(name) in ("force", "hammer") and arrays[name].size > 1]
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
    if tail.max() <= DIED_OUT:
        force, response = (
            np.pad(rows, ((0, 0), (0, (PADDING - 1) * rows.shape[1]))) for rows in (force, response)
        )
    else:
        notes.append(
            f"the response still holds {100 * tail.max():.0f} % of its peak at the end of a record: the cut "
            "widens its resonances; record longer"
        )
    readings = [Reading("force", "", name, False) for name in forces]
    readings += [Reading("response", "", name, False) for name in responses]
    return impact_response(force, response, rate), tuple(notes), readings


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


def _frequency_name(arrays: dict[str, np.ndarray]) -> str | None:
    return _named(
        {name: array for name, array in arrays.items() if array.size > 1},
        *_FREQUENCIES,
    )


def _named(arrays: dict[str, np.ndarray], *words: str) -> str | None:
    return next((name for name in arrays if _word(name) in words), None)


def _word(name: str) -> str:
    """First word of a name, without the structure that it is a member of: ``force_n`` and ``force (N)`` are force."""
    return re.split(r"[\s(\[{（_\d]", name.lower().rpartition(".")[2].strip(), maxsplit=1)[0]


def _bracket(name: str) -> str:
    found = re.search(r"[(\[{（](.+)[)\]}）]", name)
    return found[1].strip().lower() if found else ""
