"""Named arrays of numbers from CSV, LVM, TDMS, MAT, HDF5, NPZ and universal files; no code in them is executed."""

import os
import zipfile
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, one_line, short_repr
from stillwork.base.validation import checked
from stillwork.signals.structured_files import MOST_BYTES, read_structured
from stillwork.signals.tdms import read_tdms
from stillwork.signals.textfiles import read_csv, read_lvm
from stillwork.signals.universal import read_universal

MOST_TEXT = 2**30  # bytes of a file
MOST_MEMBERS = 10_000  # of an archive


@checked
def read_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Every array of numbers of a file by name, real or complex, in the shape in which it is stored.

    Of a CSV file each column is an array; of a universal file (UFF, UNV) each measured function, see
    `stillwork.signals.universal`.
    """
    path = Path(path)
    readers = {
        ".csv": read_csv,
        ".txt": read_csv,
        ".tsv": read_csv,
        ".lvm": read_lvm,
        ".mat": read_structured,
        ".h5": read_structured,
        ".hdf5": read_structured,
        ".tdms": read_tdms,
        ".npz": _npz,
        ".uff": read_universal,
        ".unv": read_universal,
    }
    if not os.path.isfile(path):  # False as well for a name that no system takes
        raise InputError(
            f"{short_repr(str(path))}: no such file; give the path of a CSV, LVM, TDMS, MAT, HDF5, NPZ or UFF file"
        )
    if path.suffix.lower() not in readers:
        raise InputError(
            f"{path.name}: files of type {path.suffix or '(none)'!r} are not read; "
            "export CSV, LVM, TDMS, MAT, HDF5, NPZ or UFF"
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
