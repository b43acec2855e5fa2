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

_FUNCTION = 58
_UNITS = 164
_SI_CODES = (0, 1, 9)  # not stated, SI, stated in the labels
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
    for units in (one for one in sets if one["type"] == _UNITS):
        if int(units["units_code"]) not in _SI_CODES:
            raise InputError(
                f"{path.name} is in the unit system {int(units['units_code'])} "
                f"({units['units_description'].strip() or 'not SI'}); export it in SI units (code 1)"
            )
    found: dict[str, np.ndarray] = {}
    for one in (one for one in sets if one["type"] == _FUNCTION):
        wanted, got = one["num_pts"], len(one.get("data", ()))  # none where its type is unknown
        if got < wanted:
            raise InputError(
                f"{path.name}: a function declares {pluralise(wanted, 'value')} but holds {got}; export it again"
            )
        if one["func_type"] in _KINDS:
            _take(path, found, one)
    if not found:
        raise InputError(
            f"{path.name} holds no measured function; export time responses or frequency responses (dataset 58)"
        )
    return found


def _take(path: Path, found: dict[str, np.ndarray], one: dict) -> None:
    kind, axis = _KINDS[one["func_type"]]
    count = one["num_pts"]
    x = np.asarray(one["x"], dtype=float)[:count]
    if axis not in found:
        found[axis] = x
    elif len(found[axis]) != count or np.abs(x - found[axis]).max() > _SAME * np.abs(x).max():
        raise InputError(
            f"{path.name} holds functions over different axes of {axis}; export those that belong together "
            "to a file of their own"
        )
    data = np.asarray(one["data"])[:count]
    if kind in ("coherence", "density", "auto spectrum"):  # real by nature, sometimes stored as complex
        data = data.real
    found[next(name for name in _names(kind, one) if name not in found)] = data


def _names(kind: str, one: dict) -> Iterator[str]:
    quantity = kind or _QUANTITIES.get(one["ordinate_spec_data_type"], "")
    place = _place(one, "rsp") or ("" if one["id1"].strip() == "NONE" else one["id1"].strip())
    if kind and (reference := _place(one, "ref")):
        place = f"{place}/{reference}"
    unit = _text(one.get("ordinate_axis_units_lab"))
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
