"""Functions in universal files (UFF, UNV): dataset 58 in ASCII and in binary, read by pyuff."""

import contextlib
import io
import itertools
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, pluralise
from stillwork.base.extras import require_package
from stillwork.base.validation import checked
from stillwork.signals.units import meaning

_FUNCTION = 58
_UNITS = 164
# Systems of dataset 164 by code: how many of their units of length and of force make 1 m and 1 N, as I-DEAS defines them.
_SYSTEMS = {
    1: (1, 1), 2: (3.28084, 0.2248089), 3: (1, 0.1019716), 4: (3.28084, 7.233014), 5: (1000, 1000), 6: (100, 100),
    7: (39.37008, 0.2248089), 8: (1000, 0.1019716), 10: (1000, 1),
}  # fmt: skip
_OWN = (0, 9)  # codes of no system, and of the user's own: the labels state the units
# Function types of dataset 58 that are read, with the axis that each stands over.
_KINDS = {
    1: ("", "time (s)"),
    2: ("auto spectrum", "frequency (Hz)"),
    3: ("cross spectrum", "frequency (Hz)"),
    4: ("frf", "frequency (Hz)"),
    6: ("coherence", "frequency (Hz)"),
    9: ("density", "frequency (Hz)"),
}
_QUANTITIES = {8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force"}
# Kinds of data: lengths and forces in one, and its SI unit.
_DIMENSIONS = {8: (1, 0, "m"), 9: (0, 1, "N"), 11: (1, 0, "m/s"), 12: (1, 0, "m/s^2"), 13: (0, 1, "N")}
_DIRECTIONS = {
    0: "",
    **{s * (k + 1): f"{'+' if s > 0 else '-'}{'XYZ'[k]}" for s in (1, -1) for k in range(3)},
}
# Axes of one file that differ by less than the printed digits are one axis.
_SAME = 1e-5


@checked
def read_universal(path: str | Path) -> dict[str, np.ndarray]:
    """Every measured function of a universal file by name, and the axes that they stand over.

    Time responses stand over ``time (s)``; frequency responses (complex, named ``frf ...``), spectra and
    coherences over ``frequency (Hz)``. A name holds quantity, place and direction, and the unit where the file
    labels it: ``acceleration 2+Z (m/s2)``, ``frf 2+Z/1+Z ((m/s2)/N)``. A second function of a name gets a number.
    """
    pyuff = require_package("pyuff")
    path = Path(path)
    try:
        # pyuff prints where it is unsure, and numpy warns; what counts is checked below.
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            file = pyuff.UFF(str(path))
            sets = [
                file.read_sets(number)
                for number, kind in enumerate(file.get_set_types())
                if int(kind) in (_FUNCTION, _UNITS)
            ]
    except Exception as error:  # whatever its parser stumbles over comes out as a plain Exception
        raise InputError(
            f"{path.name} cannot be read as a universal file ({error}); export dataset 58 again, or CSV"
        ) from None
    found: dict[str, np.ndarray] = {}
    system = None
    for one in sets:
        if one["type"] == _UNITS:
            system = _system(path, one)
            continue
        wanted, got = one["num_pts"], len(one.get("data", ()))  # none where its type is unknown
        if got < wanted:
            raise InputError(
                f"{path.name}: a function declares {pluralise(wanted, 'value')} but holds {got}; export it again"
            )
        if one["func_type"] in _KINDS:
            _take(path, found, one, system)
    if not found:
        raise InputError(
            f"{path.name} holds no measured function; export time responses or frequency responses (dataset 58)"
        )
    return found


def _system(path: Path, units: dict) -> tuple[float, float] | None:
    """How many of a file's units of length and of force make 1 m and 1 N; None where the labels alone state the units."""
    code, factors = int(units["units_code"]), (float(units["length"]), float(units["force"]))
    if code in _OWN:
        return None
    if code != 1 and not np.allclose(factors, _SYSTEMS.get(code, np.nan), rtol=1e-3):
        raise InputError(
            f"{path.name} is in the unit system {code} ({units['units_description'].strip() or 'without a name'}) with factors of "
            f"{factors[0]:g} for length and {factors[1]:g} for force, which do not belong together; export it in SI units (code 1)"
        )
    return _SYSTEMS[1] if code == 1 else factors


def _take(path: Path, found: dict[str, np.ndarray], one: dict, system: tuple[float, float] | None) -> None:
    kind, axis = _KINDS[one["func_type"]]
    count = one["num_pts"]
    add_axis(path, found, axis, np.asarray(one["x"], dtype=float)[:count])
    data = np.asarray(one["data"])[:count]
    if kind in ("coherence", "density", "auto spectrum"):  # real by nature, sometimes stored as complex
        data = data.real
    factor, unit = _unit(path, one, kind, system)
    if factor != 1:
        data = data * factor
    found[next(name for name in _names(kind, one, unit) if name not in found)] = data


@checked
def add_axis(path: Path, found: dict[str, np.ndarray], axis: str, x: np.ndarray) -> None:
    """Add the axis that functions stand over; `InputError` where it is another one than those before stand over."""
    if axis not in found:
        found[axis] = x
    elif len(found[axis]) != len(x) or np.abs(x - found[axis]).max() > _SAME * np.abs(x).max():
        raise InputError(
            f"{path.name} holds functions over different axes of {axis}; export those that belong together "
            "to a file of their own"
        )


def _unit(path: Path, one: dict, kind: str, system: tuple[float, float] | None) -> tuple[float, str]:
    """A factor and the unit that a function then has: as its labels state, else in SI by the kinds of its data."""
    sides = ("ordinate", "orddenom") if kind == "frf" else ("ordinate",)
    labels = [_text(one.get(f"{side}_axis_units_lab")) for side in sides]
    kinds = [_DIMENSIONS.get(one[f"{side}_spec_data_type"]) for side in sides]
    if kind == "coherence" or ((whole := meaning(labels[0])) and (whole.lower or whole.power)):
        return 1.0, labels[0]
    if system is None and kind == "frf" and not any(labels) and kinds[0] and kinds[0][2] in ("m", "m/s"):
        system = _SYSTEMS[1]  # not what a response without a unit is taken for
    factor = 1.0
    for number, (label, known) in enumerate(zip(labels, kinds, strict=True)):
        follows = kind in ("", "frf")
        if label or system is None or (system == _SYSTEMS[1] and not (known and follows)):
            continue
        if known is None or not follows:
            raise InputError(
                f"{path.name} has {system[0]:g} units of length to the metre and {system[1]:g} of force to the newton, and a function "
                "without a label whose unit does not follow from them; export it in SI units (code 1)"
            )
        factor *= (system[0] ** known[0] * system[1] ** known[1]) ** (2 * number - 1)
        labels[number] = known[2]
    return factor, "/".join(filter(None, labels)) if labels[0] else ""


def _names(kind: str, one: dict, unit: str) -> Iterator[str]:
    quantity = kind or _QUANTITIES.get(one["ordinate_spec_data_type"], "")
    place = _place(one, "rsp") or ("" if one["id1"].strip() == "NONE" else one["id1"].strip())
    if kind and (reference := _place(one, "ref")):
        place = f"{place}/{reference}"
    first = " ".join(filter(None, (quantity, place))) or "response"
    end = f" ({unit})" if unit else ""
    yield first + end
    yield from (f"{first} #{number}{end}" for number in itertools.count(2))


def _place(one: dict, side: str) -> str:
    """Name or node of one end, with its direction; empty if the file does not state it."""
    name, node = _text(one.get(f"{side}_ent_name")), one[f"{side}_node"]
    if not node or str(node) in name:
        return name
    return f"{name} {node}{_DIRECTIONS.get(one[f'{side}_dir'], '')}".strip()


def _text(value) -> str:
    text = str(value or "").strip()
    return "" if text == "NONE" else text
