"""Named arrays of numbers from CSV, MAT, NPZ and universal files; no code in them is executed."""

import csv
import os
import re
import warnings
import zipfile
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, one_line, pluralise, short_repr
from stillwork.base.extras import require_package
from stillwork.base.validation import checked
from stillwork.signals.matfiles import MOST_BYTES, read_mat
from stillwork.signals.universal import read_universal

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
    arrays = readers[path.suffix.lower()](path)
    return {name: array for name, array in arrays.items() if array.dtype.kind in "fiuc"}


@checked
def read_columns(path: str | Path) -> dict[str, np.ndarray]:
    """Every real array of a file by name, each one-dimensional; a matrix gives one per channel."""
    columns: dict[str, np.ndarray] = {}
    # A complex array is no measurement over time.
    arrays = {name: array for name, array in read_arrays(path).items() if array.dtype.kind != "c"}
    if (size := 8 * sum(array.size for array in arrays.values())) > MOST_BYTES:
        raise InputError(
            f"{Path(path).name} makes {size:.2g} bytes of numbers, more than {MOST_BYTES >> 30} GB; cut it"
        )
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

    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = (line.strip() for line in file)
        head = [line for line in lines if line and not line.startswith("#")]
    if not head:
        raise InputError(f"{path.name} is empty; give a line of names and rows of numbers")
    body = head[min(1, len(head) - 1)]
    separator = next((mark for mark in ("\t", ";", ",") if mark in body), r"\s+")
    decimal = "," if separator == ";" and "," in body and "." not in body else "."
    first = [field for field in head[0].split(separator if separator != r"\s+" else None) if field.strip()]
    named = not all(_is_number(field.replace(decimal, ".")) for field in first)
    if max(map(len, head)) > LONGEST_LINE:
        raise InputError(
            f"{path.name} has a line of {max(map(len, head))} characters; it is no table of numbers"
        )
    if named and len(head) == 1:
        raise InputError(f"{path.name} holds a line of names and no rows; give rows of numbers below it")
    if named:
        names = len(_fields(head[0], separator))
        widths = [len(_without_empty_end(_fields(line.split("#")[0], separator))) for line in head[1:]]
        if min(widths) > names:  # pandas would warn, and drop the columns without a name
            raise InputError(
                f"{path.name} names {pluralise(names, 'column')} and holds {max(widths)}; give every column a name, or none"
            )
        if max(widths) > names:
            row = next(number for number, width in enumerate(widths, 1) if width > names)
            raise InputError(
                f"{path.name} is not a table: row {row} holds {pluralise(widths[row - 1], 'value')} for {pluralise(names, 'column')}; correct it"
            )
    try:
        with warnings.catch_warnings():
            # It warns of columns without a name that it drops: they were seen to be empty.
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            table = pd.read_csv(
                path,
                sep=separator,
                decimal=decimal,
                comment="#",
                header=0 if named else None,
                index_col=False,
                skipinitialspace=True,
                encoding="utf-8-sig",
            )
    except UnicodeDecodeError:
        raise InputError(f"{path.name} is not text in UTF-8; save it as such") from None
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(f"{path.name} is not a table ({error}); give rows of equally many numbers") from None
    # A separator at the end of every row makes one more, empty column.
    table = table[
        [n for n in table if not (table[n].isna().all() and (not named or n.startswith("Unnamed")))]
    ]
    columns = {}
    for number, (name, column) in enumerate(table.items(), 1):
        try:
            numbers = pd.to_numeric(column, errors="coerce").to_numpy(dtype=float)
        except OverflowError:
            raise InputError(
                f"{path.name}, column {name}: a number is beyond the largest floating-point number; correct it"
            ) from None
        text = column[np.isnan(numbers) & column.notna().to_numpy()]
        if len(text) and (whole := _complex(column)) is not None:
            numbers = whole
        elif len(text):
            wrong = "not a number; correct it"
            if MOMENT.fullmatch(text.iloc[0]):
                wrong = "a date or a time of day; give seconds from any start, or leave the column out"
            raise InputError(
                f"{path.name}, column {name}: {text.iloc[0]!r} in row {text.index[0] + 1} is {wrong}"
            )
        columns[str(name).strip() if named else f"column {number}"] = numbers
    return columns


def _complex(column) -> np.ndarray | None:
    """A column of complex numbers in the usual forms, 1+2j, (1+2i) or 1 + 2i; None where one of them is none."""
    plain = column.fillna("nan").astype(str).str.replace(r"[\s()]", "", regex=True)
    try:
        return np.array([complex(each.replace("i", "j") if each[-1:] == "i" else each) for each in plain])
    except ValueError:
        return None


def _fields(line: str, separator: str) -> list[str]:
    return line.split() if separator == r"\s+" else next(csv.reader([line], delimiter=separator), [])


def _without_empty_end(fields: list[str]) -> list[str]:
    """A separator at the end of a row makes no column."""
    while fields and not fields[-1].strip():
        fields = fields[:-1]
    return fields


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
        raise _no_archive(path, f"it unpacks to {size:.2g} bytes, more than {MOST_BYTES >> 30} GB")
    for each in members:  # others unpack a thousand times the requested size at once
        if each.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise _no_archive(path, f"its member {short_repr(each.filename)} is compressed as numpy does not")


def _no_archive(path: Path, why: str) -> InputError:
    return InputError(f"{path.name} cannot be read ({why}); save plain numeric arrays with numpy.savez")
