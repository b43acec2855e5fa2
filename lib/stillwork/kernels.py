"""The one place for compile flags of per-sample kernels and callbacks, and for where their machine code is kept."""

import hashlib
import inspect
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numba

from stillwork import paths
from stillwork.checks import InputError

# No fast-math: reordered sums break the symmetry that recursive least squares rests on.
ARITHMETIC = {"error_model": "numpy"}
FLAGS = {"cache": True, "nogil": True, **ARITHMETIC}


def kernel(function):
    """Compile a plain-array function with numba: cached on disk, free of the GIL, IEEE arithmetic.

    The function is unwrapped first, because the tests' type checker wraps every function of the package.
    """
    return _compiled(function)


def inlined_kernel(function):
    """As `kernel`, but copied into its callers: for what runs every sample and is as short as a call is long."""
    return _compiled(function, inline="always")


def _compiled(function, **options):
    """Numba's dispatcher, with its cache in `cache_folder` unless NUMBA_CACHE_DIR names another."""
    given = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = given or cache_folder()
    try:
        return numba.njit(**FLAGS, **options)(inspect.unwrap(function))
    finally:
        numba.config.CACHE_DIR = given


@cache
def callback(function: Callable, signature: str):
    """Compile a function of a reader's own to a C callback, cached beside the file that defines it.

    All callbacks of one signature have one type, so a kernel that calls them is compiled once for every function.
    The cache notices a change of that file, not of another one from which the function calls: keep what belongs
    to a model in one file. A function typed at a prompt, or of a module that ``sys.modules`` does not hold, is
    compiled anew in every process.

    Raises
    ------
    InputError
        When numba cannot compile it.
    """
    function = inspect.unwrap(function)
    lasting = function.__module__ in sys.modules  # else numba's cache could not be read by another process
    try:
        try:
            return numba.cfunc(signature, cache=lasting, **ARITHMETIC)(function)
        except RuntimeError:  # typed at a prompt: no file to cache beside
            return numba.cfunc(signature, **ARITHMETIC)(function)
    except numba.core.errors.NumbaError as error:
        raise InputError(
            f"{function.__name__} cannot be compiled; use only numbers, loops, math and numpy in it, "
            f"and take everything else from parameters ({str(error).strip().splitlines()[-1]})"
        ) from None


@cache
def cache_folder() -> str:
    """Folder for the machine code of the kernels as they are written now.

    Numba's own rule looks at the file of a kernel, not at those of the kernels it calls: after a change of one
    of these it would go on with the old code. So the folder's name is a digest of every file that has kernels.
    Empty, which is numba's rule, where there is no workbook to write to.
    """
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        text = file.read_bytes()
        if b"kernel" in text:
            digest.update(text)
    try:
        folder = paths.root() / "build" / "kernels" / digest.hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return ""
    return str(folder)
