"""The one place for compile flags of the per-sample kernels."""

import inspect

import numba


def kernel(function):
    """Compile a plain-array function with numba: cached on disk, free of the GIL, IEEE arithmetic.

    No fast-math: reordered sums break the symmetry that recursive least squares rests on. The function is
    unwrapped first, because the tests' type checker wraps every function of the package.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy")(inspect.unwrap(function))
