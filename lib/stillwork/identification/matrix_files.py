"""A measured response of several inputs and outputs from a file: a matrix over frequency."""

import re
from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import checked
from stillwork.identification.machine_files import (
    agreed_units,
    complex_responses,
    one_response,
    require_motion,
)
from stillwork.signals.datafiles import read_arrays
from stillwork.signals.densities import frequency_axis
from stillwork.signals.headings import column_unit, heading, in_hertz

LEAST_LINES = 32
PARTS = ("real", "imaginary", "magnitude", "phase", "coherence")
ARROW = r"\s*(?:[-=]+>|\u2192|[\s_]to[\s_])\s*"
WORDS = {
    "output": ("y", "x", "z", "q", "out", "output", "sensor", "acc", "acceleration", "position", "response"),
    "input": ("u", "f", "in", "input", "force", "actuator", "motor", "torque", "voltage", "current", "drive"),
}


class MatrixFile(NamedTuple):
    """Acceleration of every output over every input."""

    source: str  # file name
    hertz: Float64[np.ndarray, " lines"]
    accelerance: Complex128[np.ndarray, "lines outputs inputs"]
    coherence: Float64[np.ndarray, "lines outputs inputs"]  # NaN where the file has none
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    units: tuple[str, str]  # of the positions and of what drives them
    notes: tuple[str, ...]
    example: str  # how a name was read

    @property
    def order(self) -> str:
        """Which labels are outputs and which inputs, in the order of the matrix, in words."""
        return f"outputs in order: {', '.join(self.outputs)}; inputs in order: {', '.join(self.inputs)} ({self.example})"

    @checked(missing=True)
    def ordered(self, outputs: tuple[str, ...], inputs: tuple[str, ...]) -> "MatrixFile":
        """The same with outputs and inputs in this order."""
        rows, columns = (
            [held.index(each) for each in wanted] if sorted(wanted) == sorted(held) else None
            for wanted, held in ((outputs, self.outputs), (inputs, self.inputs))
        )
        if rows is None or columns is None:
            raise InputError(
                f"{self.source} holds outputs {', '.join(self.outputs)} and inputs {', '.join(self.inputs)}, wanted are "
                f"{', '.join(outputs)} and {', '.join(inputs)}; name them alike"
            )
        seen, sure = (each[:, rows][:, :, columns] for each in (self.accelerance, self.coherence))
        return self._replace(outputs=outputs, inputs=inputs, accelerance=seen, coherence=sure)


@checked
def natural(label: str) -> tuple[tuple[int, ...], str]:
    """What labels are sorted by: their numbers, then their letters."""
    return tuple(map(int, re.findall(r"\d+", label))), label


@checked
def places(names: Collection[str]) -> dict[str, tuple[str, str]]:
    """Output and input of each name that states both.

    ``h[2,1]``, ``H_{y[1], u[0]}``, ``real h21``, ``phase y2/u1 (deg)``, ``frf 2+Z/1+Z``: the output first. The other way
    round where an arrow or "to" stands between them, or the words say so: ``u1->y2``, ``from 1 to 2``, ``F1 X2``.

    Raises
    ------
    InputError
        When a name says both.
    """
    return {name: place for name in names if (place := _place(name))}


def _place(name: str) -> tuple[str, str] | None:
    text, more = re.sub(r"\s#\d+\b", "", name), 1
    while more:
        text, more = re.subn(r"\([^()]*\)", " ", text)  # units
    text = re.sub(ARROW, " -> ", text, flags=re.IGNORECASE)
    arrow = "->" in text
    ends = None if arrow else re.search(r"(\S*\d\S*?)\s*/\s*(\S*\d\S*)", text) or _over_input(text)
    numbered = re.findall(r"([^\W\d_]*)[\s_.\[{#-]*(\d+)", text)
    kinds = [_kind(word) for word, _ in numbered]
    words = [number for _, number in numbered]
    if len(numbered) == 2 and all(kinds):
        words = ["".join(each) for each in numbered]
    if ends:
        words = [each.strip("[]{}_,") for each in ends.groups()]
    if len(words) == 1 and len(words[0]) == 2:
        words = list(words[0])
    if len(words) != 2:
        return None
    turned = kinds == ["input", "output"]
    if (turned and ends) or (arrow and kinds == ["output", "input"]):
        raise InputError(
            f"{name}: it is not clear which is the output; write it as output over input, such as y2/u1"
        )
    first, second = words
    return (second, first) if turned or arrow else (first, second)


def _over_input(text: str) -> re.Match | None:
    """A name without a number over an input, as ``z/F1``."""
    found = re.search(r"([^\W\d_]+)\s*/\s*([^\W\d_]+\d*)\s*$", text)
    return found if found and _kind(re.sub(r"\d", "", found[2])) == "input" else None


def _kind(word: str) -> str:
    return next((kind for kind, words in WORDS.items() if word.lower() in words), "")


@checked(missing=True)
def load_matrix(file: str | Path, response_unit: str = "", force_unit: str = "") -> MatrixFile | None:
    """The matrix response in a file, each entry read as `load_machine` reads one; None where there are no two of them.

    Raises
    ------
    InputError
        When its responses are no whole matrix, or its lines cannot be used.
    """
    file = Path(file)
    arrays = read_arrays(file)
    axis = frequency_axis(arrays)
    if not axis:
        return None
    unit, _ = column_unit(axis, "frequency")
    hertz = in_hertz(unit) * require_array(axis, np.ravel(arrays[axis]), ndim=1)
    columns = {
        name: np.ravel(each) for name, each in arrays.items() if each.size == hertz.size and name != axis
    }
    columns |= complex_responses(arrays)
    try:
        entries = _entries(columns)
        if len(entries) < 2:
            return None
        outputs, inputs = (
            tuple(dict.fromkeys(ends)) for ends in zip(*entries, strict=True)
        )  # as in the file
        if len(entries) != len(outputs) * len(inputs):
            raise InputError(
                f"it holds {len(entries)} responses of outputs {', '.join(outputs)} to inputs {', '.join(inputs)}, "
                f"{len(outputs) * len(inputs) - len(entries)} of the matrix are missing; give all, or choose one with response"
            )
        held = {
            name if name in arrays else name.rpartition("[")[0] for each in entries.values() for name in each
        }
        agreed = agreed_units(
            {name: arrays[name] for name in arrays if name in held}, response_unit, force_unit
        )
        seen, coherent = _filled(entries, hertz.size, outputs, inputs)
        if np.any(np.diff(hertz) <= 0):
            raise InputError("the frequency does not rise from line to line; sort the rows")
        kept = (hertz > 0) & np.any(np.abs(seen) > 0, axis=(1, 2))
        if kept.sum() < LEAST_LINES:
            raise InputError(
                f"{int(kept.sum())} usable lines are too few for a fit; give at least {LEAST_LINES}"
            )
    except InputError as error:
        raise InputError(f"{file.name}: {error}") from None
    hertz = hertz[kept]
    place, names = next(
        (each for each in entries.items() if each[0][0] != each[0][1]), [*entries.items()][-1]
    )
    example = f"{next(iter(names))}: output {place[0]} over input {place[1]}"
    accelerance = agreed.accelerance(2 * np.pi * hertz, seen[kept])
    return MatrixFile(
        *(file.name, hertz, accelerance, coherent[kept], outputs, inputs, agreed.units, agreed.note),
        example,
    )


def _entries(columns: dict[str, np.ndarray]) -> dict[tuple[str, str], dict[str, np.ndarray]]:
    """By output and input the columns that belong to one response."""
    entries: dict[tuple[str, str], dict[str, np.ndarray]] = {}
    for name, place in places(columns).items():
        if columns[name].dtype.kind == "c" or heading(name).quantity in PARTS:
            entries.setdefault(place, {})[name] = columns[name]
    return entries


def _filled(
    entries: dict[tuple[str, str], dict[str, np.ndarray]], lines: int, outputs: tuple, inputs: tuple
) -> tuple[np.ndarray, np.ndarray]:
    """The responses of a matrix, (lines, outputs, inputs), and their coherences; NaN where there is none."""
    shape = (lines, len(outputs), len(inputs))
    seen, coherent = np.empty(shape, complex), np.full(shape, np.nan)
    for (output, into), columns in entries.items():
        place = outputs.index(output), inputs.index(into)
        parts = {name: each for name, each in columns.items() if heading(name).quantity != "coherence"}
        values, taken = one_response(parts, parts, "", {})
        require_motion(taken)
        seen[:, *place] = require_array(f"response {output}/{into}", values, dtype=complex)
        for name in columns.keys() - parts.keys():
            coherent[:, *place] = column_unit(name, "coherence")[0].factor * columns[name].real
    return seen, coherent
