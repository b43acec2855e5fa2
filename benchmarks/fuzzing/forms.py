"""The same numbers as lists, in single precision, read-only, strided or on disk: the same result, nothing changed."""

import copy
import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

from fuzzing.calls import REFUSED, catalogue
from fuzzing.hostile import same_value


def main() -> int:
    """Every good call with each of its arrays in every form; prints what differs and returns how much that is."""
    calls = found = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, (function, good) in catalogue().items():
            for key, value in good.items():
                array = np.asarray(value) if type(value) in (np.ndarray, list) else np.zeros(0)
                if name in REFUSED or array.dtype.kind not in "fc" or not array.size:
                    continue
                for form, other, plain in _forms(array, Path(folder, "array.npy")):
                    calls += 1
                    if what := _difference(function, good, key, other, plain):
                        found += 1
                        print(f"{name}, {key} {form}: {what}", flush=True)
    print(f"{calls} calls in another form, {found} wrong")
    return found


def _forms(array: np.ndarray, file: Path) -> Iterator[tuple[str, object, np.ndarray]]:
    """Name, the array in that form, and the same numbers as a plain array."""
    plain = np.array(array)
    frozen = plain.copy()
    frozen.flags.writeable = False
    np.save(file, plain)
    single = plain.astype(np.complex64 if plain.dtype.kind == "c" else np.float32)
    yield "as a list", plain.tolist(), plain
    yield "read-only", frozen, plain
    yield "by columns", np.asfortranarray(plain), plain
    yield "strided", np.repeat(plain, 2, axis=-1)[..., ::2], plain
    yield "backwards in memory", np.ascontiguousarray(plain[..., ::-1])[..., ::-1], plain
    yield "on disk", np.load(file, mmap_mode="r"), plain
    yield "in single precision", single, single.astype(plain.dtype)
    yield "big-endian", plain.astype(plain.dtype.newbyteorder(">")), plain
    if plain.dtype.kind == "f":
        whole = np.rint(plain).astype(np.int64)
        yield "of integers", whole, whole.astype(float)


def _difference(function, good: dict, key: str, other, plain: np.ndarray) -> str:
    arguments = copy.deepcopy(good) | {key: other}
    before = copy.deepcopy(arguments)
    result = _result(function, arguments)
    if not same_value(arguments, before):
        return "the call changes its arguments"
    expected = _result(function, copy.deepcopy(good) | {key: plain})
    if is_dataclass(expected) and isinstance(function, type) and _shares(expected, plain):
        return "the model keeps the caller's array, and changes with it"
    return "" if same_value(result, expected) else f"another result than of a plain array: {result!r:.200}"


def _shares(value, array: np.ndarray) -> bool:
    """Whether a model, or one of its parts, holds memory of an array."""
    if isinstance(value, tuple | list):
        return any(_shares(each, array) for each in value)
    if is_dataclass(value):
        return any(_shares(getattr(value, field.name), array) for field in fields(value))
    return isinstance(value, np.ndarray) and np.shares_memory(value, array)


def _result(function, arguments: dict):
    try:
        return function(**arguments)
    except ValueError as error:  # rounded to single precision they may be no good
        return type(error).__name__, str(error)
