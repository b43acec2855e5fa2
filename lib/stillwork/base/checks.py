"""Input validation: every message names the argument, what is wrong with it, and the way out."""

import difflib
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

# A field that a dataclass turns from array_like into an array when it is built: types know one of the two.
if TYPE_CHECKING:
    Converted = Any
else:
    Converted = ArrayLike

MOST_COUNT = 2**63 - 1  # numpy's own whole numbers hold no more
MOST_BYTES = 4e9  # of one array whose size an argument sets
MOST_SAMPLES = 1e8  # for a duration and a sample time; a wrong unit leads to more


class InputError(ValueError):
    """An argument or file that cannot be used; the message names it and states what to do.

    Messages quote arguments and what stands in files: control characters are escaped, for they steer a terminal.
    """

    def __init__(self, message: str):
        super().__init__(one_line(message))


def nearest(word, candidates: Iterable, prefix: str = "", cutoff: float = 0.5) -> str:
    """Suggestion ``; did you mean 'x'?`` for a misspelt word, or an empty string.

    A `prefix` that all candidates have does not count as likeness.
    """
    if not isinstance(word, str):
        return ""
    names = [
        each.removeprefix(prefix) for each in candidates if isinstance(each, str) and each.startswith(prefix)
    ]
    close = difflib.get_close_matches(word.removeprefix(prefix), names, n=1, cutoff=cutoff)
    return f"; did you mean {prefix + close[0]!r}?" if close else ""


def pluralise(number: int, noun: str) -> str:
    """``1 row``, ``2 rows``, ``3 entries``."""
    several = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{number} {noun if number == 1 else several}"


def one_line(text: str) -> str:
    """`text` with escapes for what is not printed: line breaks, control codes, halves of characters.

    Names out of a file then neither begin a line of their own nor steer a terminal.
    """
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in text
    )


def require_choice(name: str, value, choices: Iterable[str]) -> str:
    """Return `value` when it is one of `choices`, else raise `InputError` with the nearest one."""
    choices = list(choices)
    if not isinstance(value, str) or value not in choices:
        said = ", ".join(map(repr, choices))
        raise InputError(f"{name} is {short_repr(value)}; use one of {said}{nearest(value, choices)}")
    return value


def require_number(
    name: str,
    value,
    *,
    above: float | int | None = None,
    below: float | int | None = None,
    at_least: float | int | None = None,
    at_most: float | int | None = None,
) -> float:
    """Return `value` as a finite float within the given bounds, else raise `InputError`."""
    try:
        number = _float(value)
    except OverflowError:
        found = "beyond the largest floating-point number"
    except Exception:  # a reader's own object may raise anything when it is asked
        found = f"{short_repr(value)}, not a number"
    else:
        if (
            math.isfinite(number)
            and (above is None or number > above)
            and (at_least is None or number >= at_least)
            and (below is None or number < below)
            and (at_most is None or number <= at_most)
        ):
            return number
        found = f"{number:g}"
    bounds = {"above": above, "at least": at_least, "below": below, "at most": at_most}
    wanted = " and ".join(f"{word} {bound:g}" for word, bound in bounds.items() if bound is not None)
    raise InputError(f"{name} is {found}; give a finite number{wanted and ' ' + wanted}")


def _float(value) -> float:
    """`value` as a float where it is one number: no text, no flag, no complex number, no missing one."""
    if isinstance(value, float) or type(value) is int:
        return float(value)
    if np.ndim(value) or np.ma.is_masked(value):
        raise TypeError
    if (
        np.asarray(value).dtype.kind not in "iuf" and type(value) is not int
    ):  # a decimal is kept where a float is wanted
        raise TypeError
    return float(value)


def require_count(name: str, value, *, at_least: int = 1) -> int:
    """Return `value` as an int of at least `at_least`, else raise `InputError`."""
    if (
        isinstance(value, bool)
        or not isinstance(value, int | np.integer)
        or not at_least <= value <= MOST_COUNT
    ):
        wanted = f", at least {at_least}" if at_least > -MOST_COUNT else ""
        raise InputError(f"{name} is {short_repr(value)}; give a whole number{wanted}")
    return int(value)


def require_kind(name: str, value, kind: type | tuple[type, ...]):
    """Return `value` when it is one of these classes, else raise `InputError`."""
    kinds = kind if isinstance(kind, tuple) else (kind,)
    if isinstance(value, kinds):
        return value
    raise InputError(f"{name} is {short_repr(value)}; give {' or '.join(each.__name__ for each in kinds)}")


def require_samples(name: str, count: float) -> int:
    """Return the number of samples that `name` needs as an int, else raise `InputError`."""
    if not count <= MOST_SAMPLES:
        raise InputError(f"{name} needs {count:.3g} samples; give at most {MOST_SAMPLES:g}, times in s")
    return round(count)


def require_memory(name: str, *shape: int) -> None:
    """Raise `InputError` if the array of floats that `name` needs is larger than `MOST_BYTES`."""
    size = 8 * math.prod(shape)
    if size > MOST_BYTES:
        wanted = " x ".join(map(str, shape))
        raise InputError(
            f"{name} needs {wanted} numbers, {size / 1e9:.3g} GB; give fewer, {MOST_BYTES / 1e9:g} GB at most"
        )


def require_whole(name: str, value) -> int:
    """Return `value` as an int of any sign, else raise `InputError`."""
    return require_count(name, value, at_least=-MOST_COUNT)


def require_flag(name: str, value) -> bool:
    """Return `value` as a bool when it is one, numpy's or Python's, else raise `InputError`."""
    return bool(require_kind(name, value.item() if isinstance(value, np.bool_) else value, bool))


def require_callable(name: str, value):
    """Return `value` when it can be called, else raise `InputError`."""
    if not callable(value):
        raise InputError(f"{name} is {short_repr(value)}; give a function")
    return value


def short_repr(value) -> str:
    """`value` as a message quotes it: no longer than a line, whatever it is."""
    try:
        text = repr(value)
    except Exception:  # a reader's own object, or an int of more digits than Python writes
        return f"a {type(value).__name__} that cannot be shown"
    # both ends: of a path the last part tells most
    return one_line(text if len(text) <= 80 else f"{text[:37]}...{text[-40:]}")


def require_array(
    name: str,
    value,
    *,
    ndim: int | None = None,
    shape: tuple[int | None, ...] | None = None,
    dtype=np.float64,
    advice: str = "remove or repair them first",
    missing: bool = False,
    infinite: bool = False,
) -> np.ndarray:
    """Return `value` as a finite, C-contiguous array that may be written to, else raise `InputError`.

    It is the one validation of arrays: lists, other number types, transposed, strided, read-only and
    memory-mapped arrays come out alike, so that a kernel is compiled for one type alone. It is `value` itself
    where nothing has to be changed; a function that writes to it copies it first. None in `shape` leaves an axis
    free, `advice` says what to do about values that are not finite, `missing` lets NaN stand for lost ones, and
    `infinite` lets an infinity stand for no limit.
    """
    # Nearly all arrays of a calculation come as they are wanted: for them the rest would cost more than the check.
    ready = type(value) is np.ndarray and value.dtype == dtype and value.flags.carray
    array = value if ready else _numbers(name, value, np.dtype(dtype))
    if ndim is not None and array.ndim != ndim:
        raise InputError(f"{name} has shape {array.shape}; give an array with {ndim} axes")
    if shape is not None and not _fits(array.shape, shape):
        wanted = " x ".join("any" if want is None else str(want) for want in shape)
        raise InputError(f"{name} has shape {array.shape}; give {wanted}")
    finite = np.isfinite(array)
    if missing:
        finite |= np.isnan(array)
    if infinite:
        finite |= np.isinf(array)
    if not finite.all():
        first = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise InputError(
            f"{name} holds {int((~finite).sum())} NaN or infinite values, the first at index {first}; {advice}"
        )
    return array


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    if len(shape) != len(wanted):
        return False
    for have, want in zip(shape, wanted, strict=True):
        if want is not None and have != want:
            return False
    return True


def require_finite_run(name: str, values: np.ndarray, advice: str, *, axis: int = 0) -> None:
    """Raise `InputError` with the sample at which a run overflowed, if it did."""
    finite = np.isfinite(values)
    if not finite.all():
        others = tuple(i for i in range(finite.ndim) if i != axis % finite.ndim)
        sample = int(np.argmin(finite.all(axis=others)))
        raise InputError(f"{name} overflows at sample {sample}; {advice}")


def _numbers(name: str, value, dtype: np.dtype) -> np.ndarray:
    """`value` as a writable array of `dtype`; `InputError` where a conversion would lose or invent something."""
    try:
        given = np.asarray(value)
        if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
            raise InputError(f"{name} has masked values; fill or remove them first")
        if given.dtype.kind == "c" and dtype.kind != "c":
            raise InputError(f"{name} is complex; give real numbers, such as the real part or the magnitude")
        if given.dtype.kind not in "biufcO":  # text and times
            raise TypeError
        if given.dtype.kind == "O" and any(isinstance(each, str | bytes) for each in given.flat):
            raise TypeError
        with np.errstate(over="ignore"):  # a long double beyond float64 is infinite, which is said below
            return np.require(given, dtype, ["C", "A", "W", "E"])
    except InputError:
        raise
    except OverflowError:
        raise InputError(f"{name} holds a number beyond the largest floating-point number") from None
    except Exception:  # numpy asks the object, which may raise anything
        raise InputError(f"{name} is not an array of numbers; give a rectangular array") from None


def require_one_each(values: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """What a response returned for frequencies, else `InputError`."""
    if values.size != omega.size:
        raise InputError(
            f"what response returns has shape {values.shape} for {pluralise(omega.size, 'frequency')}; give one value at each"
        )
    return values
