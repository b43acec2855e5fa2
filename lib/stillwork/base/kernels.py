"""The one place for compile flags of per-sample kernels and callbacks, and for where their machine code is kept.

Numba keeps machine code by the file of a function, and goes on with the old one after a change of what the function
calls in another file. In a checkout its folder is therefore named by a digest of all files that hold kernels: a change of
any of them compiles all anew.
"""

import contextlib
import hashlib
import inspect
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Literal

import numba

from stillwork.base.checks import InputError

# No fast-math: reordered sums break the symmetry that recursive least squares rests on.
ERRORS: Literal["numpy"] = "numpy"  # a division by zero gives infinity
FLAGS = {"nogil": True, "error_model": ERRORS}
ROOT = Path(__file__).parents[3]  # of a checkout
FOLDERS = ("lib", "notebooks", "contest")  # of it, that hold kernels


def kernels_digest(root: Path) -> str:
    """Digest of all files of the checkout `root` that hold kernels, and of where they stand."""
    digest = hashlib.sha256()
    for file in sorted(each for folder in FOLDERS for each in (root / folder).rglob("*.py")):
        source = file.read_bytes()
        if b"_kernel" in source or b"base.kernels" in source or b"numba" in source:
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + source)
    return digest.hexdigest()[:16]


if (ROOT / "data").is_dir():
    _folder = numba.config.CACHE_DIR or ROOT / "build" / "kernels"  # type: ignore[attr-defined]
    numba.config.CACHE_DIR = str(Path(_folder, kernels_digest(ROOT)))  # type: ignore[attr-defined]


def kernel(function):
    """Compile a plain-array function with numba: cached on disk, free of the GIL, IEEE arithmetic.

    The function is unwrapped first, because the tests' type checker wraps every function of the package.
    """
    return _compiled(function)


def inlined_kernel(function):
    """As `kernel`, but copied into its callers: for what runs every sample and is as short as a call is long."""
    return _compiled(function, inline="always")


def borrowing_kernel(function):
    """As `kernel`, for what makes no array: the references of those it is given, and of their parts, stay uncounted.

    Each count is an atomic operation, which costs more than the arithmetic of a few numbers.
    """
    return _compiled(function, _nrt=False)


def pasted_kernel(function):
    """As `borrowing_kernel`, but its machine code is copied into its callers: for what other kernels contain.

    Numba analyses it once, an `inlined_kernel` again in everything that calls it.
    """
    return _compiled(function, _nrt=False, forceinline=True)


def _compiled(function, **options):
    """Numba's dispatcher. Kept on disk is what lies in the files that the folder is named by, or in an installed package."""
    function = inspect.unwrap(function)
    if _is_kept(Path(function.__code__.co_filename)):
        with contextlib.suppress(RuntimeError):  # nowhere to write to
            return numba.njit(**FLAGS, **options, cache=True)(function)
    return numba.njit(**FLAGS, **options)(function)


def _is_kept(file: Path) -> bool:
    return any(
        file.is_relative_to(folder)
        for folder in (Path(__file__).parents[1], *(ROOT / each for each in FOLDERS))
    )


@cache
def callback(function: Callable, signature: str):
    """Compile a function of a reader's own to a C callback, once in every process.

    All callbacks of one signature have one type, so a kernel that calls them is compiled once for every function.
    """
    function = inspect.unwrap(function)
    try:
        return numba.cfunc(signature, error_model=ERRORS)(function)
    except numba.core.errors.NumbaError as error:
        raise InputError(
            f"{function.__name__} cannot be compiled; use only numbers, loops, math and numpy in it, "
            f"and take everything else from parameters ({str(error).strip().splitlines()[-1]})"
        ) from None
