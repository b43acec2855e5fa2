"""The one place for compile flags of per-sample kernels and callbacks."""

import contextlib
import inspect
import os
import sys
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from types import FunctionType

import numba
import numpy as np
from numba.core.ccallback import CFunc
from numba.core.sigutils import normalize_signature

from stillwork.base.checks import InputError
from stillwork.base.kernel_cache import CodeCache, KernelCache

# No fast-math: reordered sums break the symmetry that recursive least squares rests on.
ARITHMETIC = {"error_model": "numpy"}
FLAGS = {"nogil": True, **ARITHMETIC}


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
    """Numba's dispatcher, with a cache of the package's own."""
    function = inspect.unwrap(function)
    compiled = numba.njit(**FLAGS, **options)(function)
    if not numba.config.DISABLE_JIT:
        KernelCache(function).serve(compiled)
        _take_constants_as_numbers(compiled)
    return compiled


def _take_constants_as_numbers(compiled):
    """A constant in a call has a type of its own for numba: the kernel would be compiled once more for each."""
    template_of = compiled.get_call_template

    def get_call_template(arguments, options):
        plain = tuple(numba.types.unliteral(each) for each in arguments)
        return template_of(plain, {name: numba.types.unliteral(each) for name, each in options.items()})

    compiled.get_call_template = get_call_template


SHORT = 1e6  # elementary operations, for which Python takes about as long as a kernel takes to compile
CALL = 100  # of them that a sample takes beside its own
_done: defaultdict = defaultdict(float)  # by Python, of each kernel


def kernel_for(dispatcher, samples: int, operations: float):
    """The kernel; or its Python, until that has taken as long as to compile the kernel, where it is not compiled yet."""
    if not hasattr(dispatcher, "py_func") or dispatcher.overloads:
        return dispatcher
    _done[dispatcher] += samples * (CALL + operations)
    if _done[dispatcher] > SHORT:
        return dispatcher
    index = getattr(getattr(dispatcher._cache, "_cache_file", None), "_index_path", "")
    return dispatcher if os.path.exists(index) else uncompiled(dispatcher)


@cache
def uncompiled(dispatcher) -> Callable:
    # the same code, in which kernels are Python functions as well
    function = dispatcher.py_func
    names = {
        name: uncompiled(value)
        for name, value in function.__globals__.items()
        if name in function.__code__.co_names and hasattr(value, "py_func")
    }
    python = FunctionType(function.__code__, function.__globals__ | names, closure=function.__closure__)
    return np.errstate(all="ignore")(python)


@cache
def callback(function: Callable, signature: str):
    """Compile a function of a reader's own to a C callback, cached beside the file that defines it.

    All callbacks of one signature have one type, so a kernel that calls them is compiled once for every function.
    A function typed at a prompt, or of a module that ``sys.modules`` does not hold, is
    compiled anew in every process.
    """
    function = inspect.unwrap(function)
    compiled = CFunc(function, normalize_signature(signature), locals={}, options=ARITHMETIC)
    if function.__module__ in sys.modules:  # else no other process could read the cache
        with contextlib.suppress(RuntimeError):  # typed at a prompt: no file to cache beside
            CodeCache(function).serve(compiled)
    try:
        compiled.compile()
        return compiled
    except numba.core.errors.NumbaError as error:
        raise InputError(
            f"{function.__name__} cannot be compiled; use only numbers, loops, math and numpy in it, "
            f"and take everything else from parameters ({str(error).strip().splitlines()[-1]})"
        ) from None
