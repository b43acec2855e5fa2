"""Named arrays of numbers from CSV, MAT, NPZ and universal files; no code in them is executed."""

import csv
import itertools
import os
import re
import warnings
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, one_line, pluralise, short_repr
from stillwork.base.extras import require_package
from stillwork.base.validation import by_value, checked
from stillwork.signals.matfiles import MOST_BYTES, read_mat
from stillwork.signals.units import meaning
from stillwork.signals.universal import read_universal

MOST_TEXT = 2**30  # bytes of a file
LONGEST_LINE = 2**17  # characters; the csv module takes no longer field
MOST_MEMBERS = 10_000  # of an archive
MOMENT = re.compile(  # a date, a time of day
    r"\s*(\d{1,4}[-/]\d{1,2}[-/]\d{1,4}|\d{1,2}\.\d{1,2}\.\d{4}|\d{1,2}:\d{2}).*"
)


@checked
def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Every array of numbers of a file by name, real or complex, in the shape in which it is stored.

    Of a CSV file each column is an array; of a universal file (UFF, UNV) each measured function, see
    `stillwork.signals.universal`.
    """
    path = Path(path)
    readers = {
        ".csv": _csv,
        ".txt": _csv,
        ".tsv": _csv,
        ".mat": read_mat,
        ".npz": _npz,
        ".uff": read_universal,
        ".unv": read_universal,
    }
    if not os.path.isfile(path):  # False as well for a name that no system takes
        raise InputError(
            f"{short_repr(str(path))}: no such file; give the path of a CSV, MAT, NPZ or UFF file"
        )
    if path.suffix.lower() not in readers:
        raise InputError(
            f"{path.name}: files of type {path.suffix or '(none)'!r} are not read; "
            "export CSV, MAT (version 7), NPZ or UFF"
        )
    if (size := path.stat().st_size) > MOST_TEXT:
        raise InputError(f"{path.name} has {size:.2g} bytes, more than {MOST_TEXT >> 30} GB; cut it")
    arrays = {
        name: array
        for name, array in readers[path.suffix.lower()](path).items()
        if array.dtype.kind in "fiuc"
    }
    if (size := 8 * sum(array.size for array in arrays.values())) > MOST_BYTES:
        raise InputError(
            f"{path.name} makes {size:.2g} bytes of numbers, more than {MOST_BYTES / 2**30:g} GB; cut it, or leave channels out"
        )
    return arrays


@checked
def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """Every real array of a file by name, each one-dimensional; a matrix gives one per channel."""
    columns: dict[str, np.ndarray] = {}
    # A complex array is no measurement over time.
    arrays = {name: array for name, array in read_arrays(path).items() if array.dtype.kind != "c"}
    for name, array in arrays.items():
        rows = np.atleast_1d(np.squeeze(array)).astype(float)
        if rows.ndim > 2:
            raise InputError(f"array {name!r} has shape {array.shape}; give channels by samples")
        if rows.ndim == 1:
            columns[name] = rows
            continue
        if rows.shape[0] > rows.shape[1]:  # samples outnumber channels
            rows = rows.T
        columns.update({f"{name} {number}": row for number, row in enumerate(rows, 1)})
    return columns


def _csv(path: Path) -> dict[str, np.ndarray]:
    pd = require_package("pandas")

    text = _look_through(path)
    try:
        with warnings.catch_warnings():
            # It warns of columns without a name that it drops: they were seen to be empty.
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            table = pd.read_csv(
                path,
                sep=text.separator,
                decimal=text.decimal,
                header=None,
                names=text.names,
                skiprows=text.skipped,
                index_col=False,
                skipinitialspace=True,
                encoding="utf-8-sig",
            )
    except UnicodeDecodeError:
        raise InputError(f"{path.name} is not text in UTF-8; save it as such") from None
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(f"{path.name} is not a table ({error}); give rows of equally many numbers") from None
    columns = {}
    for name, column in table.items():
        try:
            numbers = pd.to_numeric(column, errors="coerce").to_numpy(dtype=float)
        except OverflowError:
            raise InputError(
                f"{path.name}, column {name}: a number is beyond the largest floating-point number; correct it"
            ) from None
        words = column[np.isnan(numbers) & column.notna().to_numpy()]
        if len(words) and (whole := _complex(column)) is not None:
            numbers = whole
        elif len(words):
            wrong = "not a number; correct it"
            if MOMENT.fullmatch(words.iloc[0]):
                wrong = "a date or a time of day; give seconds from any start, or leave the column out"
            raise InputError(
                f"{path.name}, column {name}: {words.iloc[0]!r} in row {words.index[0] + 1} is {wrong}"
            )
        columns[str(name)] = numbers
    return columns


@by_value
@dataclass(frozen=True)
class _Text:
    """How the numbers of a text stand in it."""

    separator: str
    decimal: str
    names: list[str]
    skipped: list[int]  # lines that hold no numbers, from 0


def _look_through(path: Path) -> _Text:
    """Look through a text once: its separator, the decimal mark of all its rows, its names, and the lines to skip."""
    skipped: list[int] = []
    lines = _lines(path, skipped)
    number, first = next(lines, (0, ""))
    separator = ""
    if found := re.fullmatch(r'"?sep=(.)"?', first):  # of Excel
        separator = found[1]
        skipped.append(number)
        number, first = next(lines, (0, ""))
    if not first:
        raise InputError(f"{path.name} is empty; give a line of names and rows of numbers")
    below, second = next(lines, (0, ""))
    body = second or first
    separator = separator or next((mark for mark in ("\t", ";", ",") if mark in body), r"\s+")
    names = _fields(first, separator, _width(body, separator))
    named = not all(_is_number(each.replace(",", ".")) for each in names if each)
    rows = [] if named else [first]
    if named:
        skipped.append(number)
        units = [each.strip("()[] ") for each in _fields(second, separator, len(names))]
        if units and all(not each or (meaning(each) and not _is_number(each)) for each in units):
            pairs = itertools.zip_longest(names, units[: len(names)], fillvalue="")
            names = [f"{name} ({unit})" if unit else name for name, unit in pairs]
            skipped.append(below)
            below, second = next(lines, (0, ""))
    rows += [second] if second else []
    if not rows:
        raise InputError(f"{path.name} holds a line of names and no rows; give rows of numbers below it")
    points = commas = False
    widest, at = 0, 0
    for row, line in enumerate(itertools.chain(rows, (line for _, line in lines)), 1):
        points, commas = points or "." in line, commas or "," in line
        if (width := _width(line, separator)) > widest:
            widest, at = width, row
    if named and widest > len(names):
        raise InputError(
            f"{path.name} is not a table: row {at} holds {pluralise(widest, 'value')} for {pluralise(len(names), 'name')}; give every "
            "column a name, or none, and every row as many values"
        )
    if not named:
        names = [""] * widest
    names = [name or f"column {number}" for number, name in enumerate(names, 1)]
    if again := next((name for name in names if names.count(name) > 1), ""):
        raise InputError(f"{path.name} names two columns {again!r}; give each a name of its own")
    decimal = "," if commas and not points and separator not in (",", r"\s+") else "."
    return _Text(separator, decimal, names, skipped)


def _lines(path: Path, skipped: list[int]) -> Iterator[tuple[int, str]]:
    """The lines of a text with their numbers from 0; those that hold nothing or begin with # are `skipped`."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, line in enumerate(iter(lambda: file.readline(LONGEST_LINE + 1), "")):
            if len(line) > LONGEST_LINE:
                raise InputError(
                    f"{path.name} has a line of more than {LONGEST_LINE} characters; it is no table of numbers"
                )
            line = line.strip(" \r\n")
            if not line.strip() or (line.startswith("#") and not line.startswith("#N/A")):
                skipped.append(number)
            else:
                yield number, line


def _complex(column) -> np.ndarray | None:
    """A column of complex numbers in the usual forms, 1+2j, (1+2i) or 1 + 2i; None where one of them is none."""
    plain = column.fillna("nan").astype(str).str.replace(r"[\s()]", "", regex=True)
    try:
        return np.array([complex(each.replace("i", "j") if each[-1:] == "i" else each) for each in plain])
    except ValueError:
        return None


def _fields(line: str, separator: str, width: int) -> list[str]:
    """The fields of a line but empty ones at its end; names that blanks separate may hold brackets."""
    if separator == r"\s+":
        bracketed = re.findall(r"[^\s(\[{]+(?:\s*[(\[{][^)\]}]*[)\]}]+)?", line)
        return bracketed if len(bracketed) == width else line.split()
    fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    while fields and not fields[-1].strip():
        fields.pop()
    return [each.strip() for each in fields]


def _width(line: str, separator: str) -> int:
    """How many values a row holds, without empty ones at its end."""
    if separator == r"\s+" or '"' in line:
        return len(_fields(line, separator, 0))
    return line.rstrip(f"{separator} ").count(separator) + 1


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _npz(path: Path) -> dict[str, np.ndarray]:
    with path.open("rb") as file:  # numpy, unlike zipfile, takes no archive behind something else
        begins = file.read(2) == b"PK"
    if not begins or not zipfile.is_zipfile(path):
        raise _no_archive(path, "it is no archive")
    try:
        # Opened here: of a damaged archive numpy leaves its own open.
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            _require_size(path, file.zip.infolist())
            members = {name: file[name] for name in file.files}
    except InputError:
        raise
    except Exception as error:  # a damaged archive raises from zipfile, zlib or numpy
        raise _no_archive(path, one_line(str(error))) from None
    for name, member in members.items():
        if not isinstance(member, np.ndarray):
            raise _no_archive(path, f"its member {short_repr(name)} is no array")
    return members


def _require_size(path: Path, members: list[zipfile.ZipInfo]) -> None:
    """Refuse what would fill the memory; a member never unpacks to more than its archive states."""
    if len(members) > MOST_MEMBERS:
        raise _no_archive(path, f"it holds {len(members)} members, more than {MOST_MEMBERS}")
    if (size := sum(member.file_size for member in members)) > MOST_BYTES:
        raise _no_archive(path, f"it unpacks to {size:.2g} bytes, more than {MOST_BYTES / 2**30:g} GB")
    for each in members:  # others unpack a thousand times the requested size at once
        if each.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise _no_archive(path, f"its member {short_repr(each.filename)} is compressed as numpy does not")


def _no_archive(path: Path, why: str) -> InputError:
    return InputError(f"{path.name} cannot be read ({why}); save plain numeric arrays with numpy.savez")
