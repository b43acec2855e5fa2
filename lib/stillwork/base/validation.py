"""Validation of the toolbox: arguments and fields are checked against their annotations, results are finite.

An annotation may hold bounds, too (`stillwork.base.bounds`). A function keeps to its own what no annotation says: which
sizes fit together, what is stable.
"""

import inspect
import math
import re
import threading
import types
import typing
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache, partial, wraps
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from jaxtyping import AbstractArray
from numpy.typing import ArrayLike

from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
    require_callable,
    require_flag,
    require_kind,
    require_number,
    require_whole,
    short_repr,
)

# Checked where they are used, by `require_array`, with the requirements there.
# From Python 3.12 on numpy gives the union under a name of its own.
OPEN = {ArrayLike, *typing.get_args(getattr(ArrayLike, "__value__", ArrayLike))} - {
    *(bool, int, float, complex, str, bytes)
}


# The check of an annotation, and how an error describes what is required.
_PLAIN: dict[Any, tuple[Callable, str]] = {
    float: (require_number, "a number"),
    int: (require_whole, "a whole number"),
    bool: (require_flag, "True or False"),
    np.ndarray: (require_array, "an array"),
    Callable: (require_callable, "a function"),
}

FAR = 30  # decades from 1 of a number that is likely to be what a calculation cannot use
MOST_NAMED = 8  # arguments in a message

_NUMBERS = (complex, np.ndarray, np.inexact)  # that may be NaN

_Model = TypeVar("_Model")

_BY_PLACE = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


class _Inside(threading.local):
    """Whether this thread is within a checked function: nested calls are not validated."""

    now = False
    callback_error: Exception | None = None  # what a reader's own function raised on the way
    words: dict[str, Any] | None = None  # how numpy treats errors outside, kept for a user's function


_inside = _Inside()


def checked(function: Callable | None = None, *, infinite: bool = False, missing: bool = False) -> Callable:
    """Check the arguments of a public function by their annotations, and its result for NaN.

    Lists, other number types, read-only and strided arrays become what the annotation states; a value that cannot is an
    `InputError` that names it. So is a number that leaves the range of floating point on the way, of which numpy does
    not warn. A result may be `infinite`, or NaN where something is `missing`, such as the samples after a divergence.
    What a reader's own function raises, called on the way, comes through as it is.
    """
    if function is None:
        return partial(checked, infinite=infinite, missing=missing)
    names = [name for name, each in inspect.signature(function).parameters.items() if each.kind in _BY_PLACE]

    @wraps(function)
    def door(*values, **named):
        checks = bounds_of(function) if _inside.now else checks_of(function)
        if checks:

            def asked(name: str, value):
                return checks[name](name, value) if name in checks else value

            values = (*map(asked, names, values), *values[len(names) :])
            named = {name: asked(name, value) for name, value in named.items()}
        if _inside.now:
            return function(*values, **named)
        _inside.now, _inside.words = True, np.geterr()
        try:
            with np.errstate(all="ignore"):
                result = function(*values, **named)
        except (np.linalg.LinAlgError, OverflowError, ZeroDivisionError, MemoryError) as error:
            if error is _inside.callback_error:
                raise
            if isinstance(error, MemoryError):
                raise _too_large(function, error, names, values, named) from None
            raise _beyond(function, error, names, values, named) from None
        except InputError:
            raise
        except (ValueError, IndexError) as error:
            if error is _inside.callback_error:
                raise
            if re.search("array is too big|[Mm]aximum allowed (size|dimension)", str(error)):
                raise _too_large(function, error, names, values, named) from None
            if "infs or NaNs" in str(error):  # scipy's word for numbers that overflowed on the way
                raise _beyond(function, error, names, values, named) from None
            raise InputError(
                f"the arguments of {_named(function)} do not fit together ({error}); check their sizes: "
                f"{_sizes(names, values, named)}"
            ) from error
        finally:
            _inside.now, _inside.callback_error = False, None
        if not missing and _spoiled(result, infinite):
            raise _beyond(function, "it is not finite", names, values, named)
        return result

    return door


def check_fields(instance, *, infinite: Collection[str] = ()) -> None:
    """Validate the fields of a dataclass by their annotations, and convert them.

    It is called first in ``__post_init__``: an unsigned number that stays one counts below zero from the top. The
    fields in `infinite` may be an infinity, which stands for no limit. What computes with its fields is `checked`
    itself.
    """
    for name, check in checks_of(instance.__class__).items():
        value = getattr(instance, name)
        if name in infinite and isinstance(value, float | np.floating) and value == np.inf:
            fit = float(value)
        else:
            fit = check(name, value)
        if fit is not value:
            object.__setattr__(instance, name, fit)
    copy_arrays(instance)


def by_value(model: type[_Model]) -> type[_Model]:
    """Instances of a frozen dataclass are equal when their fields are, arrays among them; its hash stays."""
    names = [field.name for field in fields(model) if field.compare]  # type: ignore[arg-type]

    def equal(self, other):
        if type(other) is not type(self):
            return NotImplemented
        return all(_equal(getattr(self, name), getattr(other, name)) for name in names)

    model.__eq__ = equal  # type: ignore[method-assign,assignment]
    return model


def _equal(one, other) -> bool:
    """Whether two fields hold the same; NaN stands in an array for a lost value, and is equal to another."""
    if one is other:
        return True
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        if type(one) is not type(other) or one.dtype != other.dtype:
            return False
        return np.array_equal(one, other, equal_nan=one.dtype.kind in "fc")
    if isinstance(one, tuple | list) and type(one) is type(other):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    return bool(one == other)


def copy_arrays(instance) -> None:
    """Copy the arrays that a frozen model was given: who changes theirs later does not change the model."""
    for name in instance.__dataclass_fields__:
        value = getattr(instance, name)
        if isinstance(value, np.ndarray) and not isinstance(value, np.ma.MaskedArray):
            object.__setattr__(instance, name, np.array(value))


def made(model: type[_Model], **values) -> _Model:
    """A frozen model made here: its fields are valid and not shared, so none is validated or copied."""
    instance = object.__new__(model)
    for name in model.__dataclass_fields__:  # type: ignore[attr-defined]
        object.__setattr__(instance, name, values[name])
    return instance


def user_callback(function: Callable, check: Callable = lambda value: value) -> Callable:
    """A user's function, as the toolbox calls it: its calls of the toolbox are validated, its errors are its own."""

    def call(*values, **named):
        inside, _inside.now = _inside.now, False
        try:
            with np.errstate(**_inside.words if inside else {}):
                result = function(*values, **named)
        except Exception as error:
            if inside:
                _inside.callback_error = error
            raise
        finally:
            _inside.now = inside
        return check(result)

    return call


def _named(function: Callable) -> str:
    return re.sub(r".*<locals>\.|\.__(post_)?init__$", "", function.__qualname__)


def _beyond(function: Callable, why, names: list[str], values: tuple, named: dict) -> InputError:
    """A refusal that names the arguments farthest from 1, where some are far; else all, for any may be the cause."""
    found = _numbers_in(names, values, named)
    far = {name: size for name, array in found.items() if (size := _farthest(array)) is not None}
    extreme = sorted(far, key=lambda name: -abs(math.log10(far[name])))[:3]
    said = [f"{name} ({far[name]:.3g})" for name in extreme if abs(math.log10(far[name])) > FAR] or list(
        found
    )
    return InputError(
        f"{_named(function)} has no result for these numbers ({str(why).strip() or 'out of range'}); "
        f"they are too large, too small or too close to singular: check {_listed(said) or 'its arguments'}"
    )


def _too_large(
    function: Callable, error: Exception, names: list[str], values: tuple, named: dict
) -> InputError:
    """An error with the required size, if numpy gives it, and the arguments that may set it."""
    size = re.search(r"[\d.]+ .?i?B", str(error))
    said = [
        f"{name} {f'{array:g}' if array.ndim == 0 else ' x '.join(map(str, array.shape))}"
        for name, array in _numbers_in(names, values, named).items()
    ]
    return InputError(
        f"{_named(function)} needs {size.group() if size else 'an array'}, more than the memory holds; "
        f"give smaller numbers or arrays: {_listed(said) or 'its arguments'}"
    )


def _sizes(names: list[str], values: tuple, named: dict) -> str:
    found = _numbers_in(names, values, named)
    return _listed(
        [f"{name} {' x '.join(map(str, array.shape)) or 'a number'}" for name, array in found.items()]
    )


def _listed(words: list[str]) -> str:
    return ", ".join(words[:MOST_NAMED]) + ", ..." * (len(words) > MOST_NAMED)


def _numbers_in(names: list[str], values: tuple, named: dict) -> dict[str, np.ndarray]:
    """All numbers among arguments, by name; those of a model by its fields."""
    found: dict[str, np.ndarray] = {}

    def look(name: str, value, depth: int) -> None:
        if is_dataclass(value) and not isinstance(value, type) and depth < 3:
            for each in fields(value):
                look(
                    f"{name}.{each.name}" if name != "self" else each.name,
                    getattr(value, each.name),
                    depth + 1,
                )
        elif isinstance(value, (list, tuple)) and any(map(is_dataclass, value)):
            for place, each in enumerate(value):
                look(f"{name}[{place}]", each, depth + 1)
        elif not isinstance(value, (bool, str)) and value is not None:
            with suppress(TypeError, ValueError):
                array = np.asarray(value)
                if array.dtype.kind in "iufc":
                    found[name] = array

    for name, value in (*zip(names, values, strict=False), *named.items()):
        look(name, value, 0)
    return found


def _farthest(array: np.ndarray) -> float | None:
    """The size in an array that is farthest from 1, by decades; None without one."""
    sizes = np.abs(array[(array != 0) & np.isfinite(array)])
    return (
        float(max(sizes.max(), sizes.min(), key=lambda size: abs(math.log10(size)))) if sizes.size else None
    )


@cache
def checks_of(owner) -> dict[str, Callable]:
    """A check for every parameter or field whose annotation states what is allowed."""
    hints = _hints(owner)
    names = hints if inspect.isfunction(owner) else [field.name for field in fields(owner)]
    # A model keeps a reader's function as it is: kernels compile it.
    how = _argument if inspect.isfunction(owner) else _check
    found = {name: how(hints[name]) for name in names if name != "return"}
    return {name: check for name, check in found.items() if check is not None}


@cache
def bounds_of(function: Callable) -> dict[str, Callable]:
    """The checks of those parameters whose annotation states more than a type: nested calls make them, too."""
    hints = _hints(function)
    return {name: check for name, check in checks_of(function).items() if _is_bounded(hints.get(name))}


def _hints(owner) -> dict[str, Any]:
    plain = inspect.unwrap(owner) if inspect.isfunction(owner) else owner
    return typing.get_type_hints(plain, include_extras=True)


def _is_bounded(hint) -> bool:
    return typing.get_origin(hint) is Annotated or any(map(_is_bounded, typing.get_args(hint)))


def _argument(hint) -> Callable | None:
    """Check of an argument; for a function whose `hint` states what it returns, of its results, too."""
    if hint is not Callable and typing.get_origin(hint) is not Callable:
        return _check(hint)
    result = _check(typing.get_args(hint)[1]) if typing.get_args(hint) else None

    def check(name: str, value):
        require_callable(name, value)
        return (
            user_callback(value, partial(result, f"what {name} returns")) if result else user_callback(value)
        )

    return check


def _check(hint) -> Callable | None:
    """``check(name, value)`` that returns the value as `hint` has it; None for what is not checked here."""
    if hint in _PLAIN:
        return _PLAIN[hint][0]
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        return hint.__metadata__[0]
    if origin is Callable:
        return require_callable
    if origin in (types.UnionType, typing.Union):
        return _union(parts)
    if origin in (dict, Mapping):
        return _mapping(origin, parts)
    if origin in (list, tuple, Sequence, Collection, Iterable):
        return _sequence(origin, parts)
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        return _array(hint)
    if hasattr(hint, "converted"):  # takes what other libraries have for it
        return hint.converted
    if _is_kind(hint):
        return lambda name, value: require_kind(name, value, hint)
    return None


def _is_kind(hint) -> bool:
    """Whether it is a class of which a value is taken as it is."""
    # From Python 3.11 on `Any` is a class.
    if hint in _PLAIN or hint is Any or not inspect.isclass(hint) or typing.get_origin(hint) is not None:
        return False
    return not issubclass(hint, AbstractArray)


def _union(parts: tuple) -> Callable | None:
    if OPEN & set(parts):
        return None
    rest = [part for part in parts if part is not types.NoneType]
    found: list[Any] = [_check(part) for part in rest]
    if not rest or None in found:
        return None
    optional = len(rest) < len(parts)
    kinds = tuple(part for part in rest if _is_kind(part))

    def check(name: str, value):
        if value is None and optional:
            return None
        if isinstance(value, kinds):  # before any of the others words its refusal
            return value
        if len(rest) == 1:
            return found[0](name, value)
        for each in found:
            try:
                return each(name, value)
            except InputError:
                continue
        for part in rest:
            if (isinstance(value, tuple) or hasattr(value, "dt")) and hasattr(part, "converted"):
                # a model: say what is wrong with it
                return part.converted(name, value)
        raise InputError(f"{name} is {short_repr(value)}; give {' or '.join(map(_words, rest))}")

    return check


def _words(hint) -> str:
    """How an error describes what is required."""
    hint = hint.__origin__ if typing.get_origin(hint) is Annotated else hint
    kind = typing.get_origin(hint) or hint
    if kind in (list, tuple, Sequence, Collection, Iterable):
        return "a list of whole numbers" if int in typing.get_args(hint) else "a list of values"
    if issubclass(kind, AbstractArray):
        kind = np.ndarray
    return _PLAIN[kind][1] if kind in _PLAIN else kind.__name__


def _sequence(origin, parts: tuple) -> Callable | None:
    fixed = origin is tuple and parts[-1] is not ...
    # A dict can be indexed by its keys, but it is no sequence.
    refused = (str, bytes, Path) if origin is Iterable else (str, bytes, Path, dict)
    found: list[Any] = [
        (lambda _, value: value) if OPEN & {part, *typing.get_args(part)} else _check(part)
        for part in parts
        if part is not ...
    ]
    if not found or None in found:
        return None

    def check(name: str, value):
        if origin is tuple and not fixed and type(value) is tuple and not value:
            return value
        plain = isinstance(value, refused) or getattr(value, "ndim", 1) == 0
        if plain or not isinstance(value, Iterable):
            raise InputError(f"{name} is {short_repr(value)}; give a list of values")
        values = list(value)
        if fixed and len(values) != len(found):
            raise InputError(f"{name} has {pluralise(len(values), 'value')}; give {len(found)}")
        each = found if fixed else found * len(values)
        fit = [
            one(f"{name}[{place}]", item) for place, (one, item) in enumerate(zip(each, values, strict=True))
        ]
        return fit if origin is not tuple else tuple(fit)

    return check


def _mapping(origin, parts: tuple) -> Callable:
    keys, values = (
        _measured if part is np.ndarray else _check(part) or (lambda _, value: value) for part in parts
    )

    def check(name: str, value):
        require_kind(name, value, origin)
        return {
            keys(f"a name in {name}", key): values(f"{name}[{short_repr(key)}]", item)
            for key, item in value.items()
        }

    return check


def _measured(name: str, value) -> np.ndarray:
    """What a file holds under a name: an array of any shape, real or complex, with what is missing."""
    try:
        dtype = complex if np.asarray(value).dtype.kind == "c" else float
    except ValueError:  # rows of different lengths, which is reported below
        dtype = float
    return require_array(name, value, dtype=dtype, missing=True, infinite=True)


def _array(hint) -> Callable:
    axes = hint.dim_str.split()
    shape = None if "..." in axes else tuple(int(axis) if axis.isdigit() else None for axis in axes)
    dtype = np.dtype(hint.dtypes[0])
    return lambda name, value: require_array(name, value, shape=shape, dtype=dtype)


def _spoiled(value, infinite: bool) -> bool:
    """Whether a number of a result is NaN, or infinite where it may not be."""
    if isinstance(value, float):
        return math.isnan(value) or (not infinite and math.isinf(value))
    if isinstance(value, _NUMBERS):
        if isinstance(value, np.ndarray) and value.dtype.kind not in "fc":
            return False
        return not (~np.isnan(value) if infinite else np.isfinite(value)).all()
    if is_dataclass(value) and not isinstance(value, type):
        return any(_spoiled(getattr(value, field.name), infinite) for field in fields(value))
    return isinstance(value, (tuple, list)) and any(_spoiled(each, infinite) for each in value)
