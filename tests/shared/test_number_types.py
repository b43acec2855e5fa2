"""Every model keeps Python's numbers and arrays of its annotations, whatever types of number it was given."""

import inspect
import json
import subprocess
import sys
import typing
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

TESTS = Path(__file__).parents[1]
NUMBERS = (np.int8, np.int16, np.int64, np.uint8, np.uint16, np.uint64, np.float32, np.float64, np.longdouble)
KINDS = (int, float)


def instances() -> dict[str, object]:
    """One of each class whose values a caller gives, out of the good calls."""
    sys.path.append(str(TESTS))
    from calls import catalogue

    found: dict[str, object] = {}

    def add(value) -> None:
        if isinstance(value, tuple | list):
            for each in value:
                add(each)
        elif is_dataclass(value) and not inspect.isclass(value) and hasattr(value, "__post_init__"):
            found.setdefault(f"{type(value).__module__}.{type(value).__name__}", value)
            for field in fields(value):
                add(getattr(value, field.name))

    for function, good in catalogue().values():
        add(getattr(function, "__self__", None))
        add(list(good.values()))
        if inspect.isclass(function) and is_dataclass(function):
            add(function(**good))
    return {name: each for name, each in found.items() if name.startswith("stillwork.")}


def kept_otherwise(model) -> list[str]:
    """Fields that hold another type than the annotation says, and what they were given."""
    found = []
    hints = typing.get_type_hints(type(model))
    for field in fields(model):
        value, hint = getattr(model, field.name), hints[field.name]
        kinds = [kind for kind in (hint, *typing.get_args(hint)) if kind in KINDS]
        if kinds and type(value) in KINDS:
            for number in NUMBERS:
                with np.errstate(all="ignore"):
                    given = np.array(value).astype(number)[()]
                if float(given) != value or (kinds == [int] and given.dtype.kind == "f"):
                    continue
                kept = getattr(replace(model, **{field.name: given}), field.name)
                if type(kept) not in kinds or kept != value:
                    found.append(f"{field.name} = {number.__name__}: {type(kept).__name__}")
        elif isinstance(value, np.ndarray) and value.dtype == float and field.init:
            single = value.astype(np.float32)
            for given in (single, value.tolist(), np.asfortranarray(value)):
                if np.array_equal(given, value):
                    kept = getattr(replace(model, **{field.name: given}), field.name)
                    good = isinstance(kept, np.ndarray) and kept.dtype == float and kept.flags.carray
                    if not good or not np.array_equal(kept, value):
                        found.append(f"{field.name}: {type(kept).__name__}")
    return found


@pytest.mark.slow
def test_every_model_keeps_what_its_annotations_say():
    """In a process of its own: here the tests' type checker would answer first."""
    done = subprocess.run([sys.executable, __file__], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    models, kept = json.loads(done.stdout)
    assert models > 30
    assert kept == {}


if __name__ == "__main__":
    models = instances()
    kept = {name: found for name, model in models.items() if (found := kept_otherwise(model))}
    print(json.dumps([len(models), kept]))
