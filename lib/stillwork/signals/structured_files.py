"""Arrays of MAT and HDF5 files, read by a separate process: on a damaged file a parser may crash, or allocate any amount of memory."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError, one_line
from stillwork.base.extras import MissingPackage, require_package
from stillwork.base.validation import checked

# Of numbers: ten channels for ten minutes at 10 kHz take 480 MB, and what is computed of them several times that.
MOST_BYTES = 2**29
MOST_MEMORY = 4 * 2**30  # of the process
MOST_SECONDS = 60
MOST_LISTED = 20  # of what a file holds beside numbers
_REFUSED = 2  # exit code of the process that reports the reason on stderr


@checked
def read_structured(path: Path) -> dict[str, np.ndarray]:
    """Every array of numbers of a MAT or HDF5 file by name; members of a structure or a group as ``name.member``.

    Those of a structure array or of a cell array are numbered, ``name_1.member``. The file is read in a separate process,
    with limits on time and, where the system supports them, on memory: a damaged file cannot crash the caller.
    """
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "arrays.npz"
        command = [sys.executable, "-P", "-W", "ignore", "-m", __name__, str(path.absolute()), str(result)]
        # The process finds the packages where the caller did; the threads of a BLAS would reserve memory of their own.
        own = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONUTF8": "1"}
        own |= {"OPENBLAS_NUM_THREADS": "1"}
        try:
            done = subprocess.run(
                command,
                env=os.environ | own,
                capture_output=True,
                timeout=MOST_SECONDS,
            )
        except subprocess.TimeoutExpired:
            raise _refusal(path, f"it takes more than {MOST_SECONDS} s") from None
        message = done.stderr.decode(errors="replace").strip()
        if done.returncode == _REFUSED:
            raise InputError(message)
        if done.returncode < 0:
            raise _refusal(path, f"its reader ended by {signal.Signals(-done.returncode).name}")
        if done.returncode:
            raise _refusal(
                path, message.rpartition("\n")[2] or f"its reader ended with code {done.returncode}"
            )
        if (size := result.stat().st_size) > MOST_BYTES:
            raise InputError(
                f"{path.name} holds {size:.2g} bytes of numbers, more than {MOST_BYTES / 2**30:g} GB; cut it"
            )
        with np.load(result, allow_pickle=False) as file:
            names = json.loads(file["names"].tobytes())
            return {name: file[f"arr_{number}"] for number, name in enumerate(names)}


def _refusal(path: Path, why: str) -> InputError:
    cure = "save it with -v7" if path.suffix.lower() == ".mat" else "save arrays of numbers"
    return InputError(f"{path.name} cannot be read ({why}); {cure}, or export CSV or NPZ")


def _main(path: Path, result: Path) -> int:
    """What the process does: the arrays of a file into an NPZ file, or the reason why not."""
    _limit()
    try:
        arrays = _arrays(path)
    except InputError as error:
        print(error, file=sys.stderr)
        return _REFUSED
    names = np.frombuffer(json.dumps(list(arrays)).encode(), dtype=np.uint8)
    np.savez(result, *arrays.values(), names=names)
    return 0


def _limit() -> None:
    try:
        import resource
    except ImportError:  # Windows has none
        return
    for limit, most in (
        (resource.RLIMIT_AS, MOST_MEMORY),
        (resource.RLIMIT_CPU, MOST_SECONDS),
        (resource.RLIMIT_CORE, 0),  # a crash leaves no file behind
    ):
        soft, hard = resource.getrlimit(limit)
        if soft == resource.RLIM_INFINITY or soft > most:
            with contextlib.suppress(ValueError, OSError):  # macOS refuses a limit on memory
                resource.setrlimit(limit, (most, hard))


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        tree = _hdf5(path) if path.suffix.lower() != ".mat" else _mat(path)
    except MissingPackage as error:
        raise InputError(f"{path.name}: {error}") from None
    except MemoryError:
        raise _refusal(path, f"it takes more than {MOST_MEMORY >> 30} GB of memory") from None
    except Exception as error:  # on a damaged file a parser raises whatever it stumbles over
        raise _refusal(path, one_line(str(error))) from None
    found: dict[str, np.ndarray] = {}
    others: list[str] = []

    def walk(name: str, value: object, unit: object = "") -> None:
        if isinstance(value, dict):
            for member, each in value.items():
                if not member.startswith("__"):
                    # As frd has FrequencyUnit.
                    unit = value.get(f"{member}Unit", value.get(f"{member}Units"))
                    if isinstance(unit, str) and value.get("TimeUnit") == "seconds":
                        unit = unit.replace("TimeUnit", "s")
                    walk(f"{name}.{member}" if name else member, each, unit)
        elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype.kind == "O"):
            for number, each in enumerate(np.ravel(value) if isinstance(value, np.ndarray) else value, 1):
                walk(f"{name}_{number}", each)
        elif (array := np.asarray(value)).dtype.kind in "fiuc":
            found[f"{name} ({unit})" if isinstance(unit, str) and unit else name] = array
        else:
            others.append(f"{name} ({_kind(array)})")

    walk("", tree)
    if not found:
        raise _refusal(path, f"it holds no numbers, but {', '.join(others[:MOST_LISTED]) or 'nothing'}")
    return found


def _mat(path: Path) -> dict:
    from scipy.io import loadmat

    try:
        return loadmat(path, simplify_cells=True)
    except NotImplementedError:  # version 7.3, which is HDF5
        require_package("h5py")
        return _sorted(require_package("pymatreader").read_mat(path))


def _sorted(tree: dict) -> dict:
    """Members in the order of their names: pymatreader takes them out of a set."""
    return {name: _sorted(each) if isinstance(each, dict) else each for name, each in sorted(tree.items())}


def _hdf5(path: Path) -> dict:
    h5py = require_package("h5py")
    tree: dict[str, object] = {}

    def take(name: str, each: object) -> None:
        if not isinstance(each, h5py.Dataset):
            return
        values, name = each[()], _dotted(name)
        if each.dtype.names:  # a table, or complex numbers by their parts
            tree.update({f"{name}.{field}": values[field] for field in each.dtype.names})
            return
        tree[name] = values
        for key, stated in each.attrs.items():
            if key.lower() in ("unit", "units") and np.size(stated) == 1:
                unit = np.ravel(stated)[0]
                tree[f"{name}Unit"] = unit.decode(errors="replace") if isinstance(unit, bytes) else str(unit)

    with h5py.File(path) as file:
        file.visititems(take)
    return tree


def _dotted(path: str) -> str:
    """A path of groups with dots between them; a slash within brackets, which HDF5 takes for a group, is that of a unit."""
    name = ""
    for letter in path:
        name += "." if letter == "/" and name.count("(") == name.count(")") else letter
    return name


def _kind(array: np.ndarray) -> str:
    """What stands in a file besides numbers."""
    return "text" if array.dtype.kind in "UST" else "an object"


if __name__ == "__main__":
    sys.exit(_main(*map(Path, sys.argv[1:])))
