"""What machine code is made from: a function, all that it calls, and the constants that it names.

Numba's own key is the function's file: after a change of a function in another one, or in another cell of a notebook,
it would go on with the old code.
"""

import hashlib
import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import numpy as np

FIXED = {"llvmlite", "numba", "numpy", "scipy", *sys.stdlib_module_names} - {
    "__main__"
}  # numba's version counts as it is


def sources_digest(function: FunctionType) -> str:
    """Digest of the code that `function` reaches by name; paths, lines and comments are no part of it."""
    digest = hashlib.sha256()
    for part in _followed("", function, set()):
        digest.update(part + b"\0")
    return digest.hexdigest()


def _followed(name: str, value, seen: set) -> Iterator[bytes]:
    """What a name stands for, and all that is reached from there."""
    compiled, value = value, inspect.unwrap(getattr(value, "py_func", value))
    if isinstance(value, FunctionType) and _of_reader(value):
        options = sorted(getattr(compiled, "targetoptions", {}).items())
        yield f"{name} {value.__qualname__} {value.__defaults__} {options}".encode()
        if value not in seen:
            seen.add(value)
            yield from _inside(value, value.__code__, seen)
    elif isinstance(value, np.ndarray):
        yield f"{name} {value.dtype} {value.shape}".encode() + value.tobytes()
    elif isinstance(value, int | float | complex | str | bytes | np.generic | None):
        yield f"{name} {value!r}".encode()
    elif isinstance(value, tuple):
        for each in value:
            yield from _followed(name, each, seen)
    elif isinstance(value, ModuleType) or not _of_reader(value):
        yield f"{name} {getattr(value, '__module__', '')} {getattr(value, '__name__', '')}".encode()
    else:  # a type or an intrinsic: what it does stands in its file
        yield name.encode() + _file(value)


def _inside(function: FunctionType, code: CodeType, seen: set) -> Iterator[bytes]:
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    known = function.__globals__ | {name: cell.cell_contents for name, cell in cells}
    names = (*code.co_names, *code.co_freevars)
    yield code.co_code + repr((code.co_varnames, names)).encode()
    for name in names:
        value = known.get(name)
        yield from _followed(name, value, seen)
        for part in names if isinstance(value, ModuleType) else ():
            yield from _followed(part, getattr(value, part, None), seen)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _inside(function, constant, seen)
        elif constant != function.__doc__:
            yield repr(constant).encode()


def _of_reader(value) -> bool:
    return _module(value).partition(".")[0] not in FIXED


def _file(value) -> bytes:
    file = getattr(sys.modules.get(_module(value)), "__file__", None)
    return Path(file).read_bytes() if file else repr(value).encode()


def _module(value) -> str:
    return getattr(value, "__module__", None) or type(value).__module__
