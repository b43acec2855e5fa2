"""Arrays of MAT files, read by a separate process: scipy may crash on a damaged file, or allocate any amount of memory."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from stillwork.base.checks import InputError
from stillwork.base.validation import checked

# Of numbers: ten channels for ten minutes at 10 kHz take 480 MB, and what is computed of them several times that.
MOST_BYTES = 2**29
MOST_MEMORY = 4 * 2**30  # of the process
MOST_SECONDS = 60
MOST_LISTED = 20  # of what a file holds beside numbers
_REFUSED = 2  # exit code of the process that reports the reason on stderr


@checked
def read_mat(path: Path) -> dict[str, np.ndarray]:
    """Every array of numbers of a MAT file up to version 7 by name; members of a structure as ``name.member``.

    The file is read in a separate process, with limits on time and, where the system supports them, on memory:
    a damaged file cannot crash the caller. The caller opens it, so that
    a build sees what its kernel reads.
    """
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        try:
            opened = stack.enter_context(open(path, "rb"))
        except OSError as error:
            raise _refusal(path, str(error)) from None
        result = Path(folder) / "arrays.npz"
        command = [sys.executable, "-P", "-W", "ignore", "-m", __name__, path.name, str(result)]
        # The process finds the packages where the caller did; the threads of a BLAS would reserve memory of their own.
        own = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PYTHONUTF8": "1"}
        own |= {"OPENBLAS_NUM_THREADS": "1"}
        try:
            done = subprocess.run(
                command,
                env=os.environ | own,
                stdin=opened,
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
    return InputError(f"{path.name} cannot be read ({why}); save it with -v7, or export CSV or NPZ")


def _main(path: Path, result: Path) -> int:
    """What the process does: the arrays of its standard input into an NPZ file, or the reason why not."""
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
    from scipy.io import loadmat

    try:
        tree = loadmat(sys.stdin.buffer, simplify_cells=True)
    except MemoryError:
        raise _refusal(path, f"it takes more than {MOST_MEMORY >> 30} GB of memory") from None
    except Exception as error:  # on a damaged file scipy raises whatever its parser stumbles over
        raise _refusal(path, str(error)) from None
    found: dict[str, np.ndarray] = {}
    others: list[str] = []

    def walk(prefix: str, branch: dict) -> None:
        for name, value in branch.items():
            if isinstance(value, dict):
                walk(f"{prefix}{name}.", value)
            elif name.startswith("__"):
                continue
            elif (array := np.asarray(value)).dtype.kind in "fiuc":
                unit = branch.get(f"{name}Unit", branch.get(f"{name}Units"))  # as frd has FrequencyUnit
                found[f"{prefix}{name} ({unit})" if isinstance(unit, str) and unit else prefix + name] = array
            else:
                kind = {"U": "text", "O": "cells"}.get(array.dtype.kind, "an object")
                others.append(f"{prefix}{name} ({kind})")

    walk("", tree)
    if not found:
        raise _refusal(path, f"it holds no numbers, but {', '.join(others[:MOST_LISTED]) or 'nothing'}")
    return found


if __name__ == "__main__":
    sys.exit(_main(*map(Path, sys.argv[1:])))
