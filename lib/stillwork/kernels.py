"""The one place for compile flags of the per-sample kernels."""

import inspect

import numba

# No fast-math: reordered sums break the symmetry that recursive least squares rests on.
FLAGS = {"cache": True, "nogil": True, "error_model": "numpy"}


def kernel(function):
    """Compile a plain-array function with numba: cached on disk, free of the GIL, IEEE arithmetic.

    The function is unwrapped first, because the tests' type checker wraps every function of the package.
    """
    return numba.njit(**FLAGS)(inspect.unwrap(function))


def inlined_kernel(function):
    """As `kernel`, but copied into its callers: for what runs every sample and is as short as a call is long."""
    return numba.njit(inline="always", **FLAGS)(inspect.unwrap(function))
