"""The same numbers as lists, in single precision, read-only, strided or on disk: the same result, nothing changed.

Likewise a model of numbers of any type: it keeps Python's.

In a process of their own, as a stranger calls: here the tests' type checker would answer first.
"""

import copy
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

TESTS = Path(__file__).parents[1]
NUMBERS = (np.int8, np.int64, np.uint8, np.uint64, np.float32, np.float64, np.longdouble)


@pytest.mark.slow
def test_an_array_s_form_changes_neither_the_result_nor_the_array():
    done = subprocess.run([sys.executable, "-W", "ignore", __file__], capture_output=True, text=True)
    assert done.returncode == 0 and int(done.stdout.split()[-2]) > 1000, done.stdout + done.stderr


def compare_forms() -> tuple[int, list[str]]:
    """Every good call with each of its arrays in every form: how many calls, and what differs."""
    from calls import CATALOGUE, REFUSED

    count, found = 0, []
    with tempfile.TemporaryDirectory() as folder:
        for name, (function, good) in CATALOGUE.items():
            for key, value in good.items():
                for number in NUMBERS if isinstance(function, type) and type(value) in (int, float) else ():
                    with np.errstate(all="ignore"):
                        given = np.array(value).astype(number)[()]
                    if float(given) == value and (type(value) is float or given.dtype.kind != "f"):
                        count += 1
                        if what := difference(function, good, key, given, value):
                            found.append(f"{name}, {key} = {number.__name__}: {what}")
                array = np.asarray(value) if type(value) in (np.ndarray, list) else np.zeros(0)
                if name in REFUSED or array.dtype.kind not in "fc" or not array.size:
                    continue
                for form, other, plain in forms(array, Path(folder, "array.npy")):
                    count += 1
                    if what := difference(function, good, key, other, plain):
                        found.append(f"{name}, {key} {form}: {what}")
    return count, found


def forms(array: np.ndarray, file: Path) -> Iterator[tuple[str, object, np.ndarray]]:
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


def difference(function, good: dict, key: str, other, plain) -> str:
    arguments = copy.deepcopy(good) | {key: other}
    before = copy.deepcopy(arguments)
    result = result_of(function, arguments)
    if not same_value(arguments, before):
        return "the call changes its arguments"
    expected = result_of(function, copy.deepcopy(good) | {key: plain})
    if is_dataclass(expected) and isinstance(function, type) and np.ndim(plain) and shares(expected, plain):
        return "the model keeps the caller's array, and changes with it"
    return "" if same_value(result, expected) else f"another result than of a plain array: {result!r:.200}"


def shares(value, array: np.ndarray) -> bool:
    """Whether a model, or one of its parts, holds memory of an array."""
    if isinstance(value, tuple | list):
        return any(shares(each, array) for each in value)
    if is_dataclass(value):
        return any(shares(getattr(value, field.name), array) for field in fields(value))
    return isinstance(value, np.ndarray) and np.shares_memory(value, array)


def result_of(function, arguments: dict):
    try:
        return function(**arguments)
    except ValueError as error:  # rounded to single precision they may be no good
        return type(error).__name__, str(error)


def same_value(one, other) -> bool:
    """Whether two results hold the same numbers, bit by bit; a random generator, a function and a bare object are not looked at."""
    if isinstance(one, np.ndarray):
        if not isinstance(other, np.ndarray) or one.dtype != other.dtype:
            return False
        return np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
    if type(one) is not type(other):
        return False
    if (
        type(one) is object
        or isinstance(one, np.random.Generator)
        or (callable(one) and not is_dataclass(one))
    ):
        return True
    if is_dataclass(one):
        return all(same_value(getattr(one, field.name), getattr(other, field.name)) for field in fields(one))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same_value(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same_value, one, other))
    if type(one).__module__.startswith("stillwork"):
        return same_value(vars(one), vars(other))
    return one == other or one != one


if __name__ == "__main__":
    sys.path.append(str(TESTS))
    count, found = compare_forms()
    print(*found, f"{count} calls", sep="\n")
    sys.exit(bool(found))
