"""Input validation: every message names the argument, what is wrong with it, and the way out."""

import difflib
from collections.abc import Iterable

import numpy as np


class InputError(ValueError):
    """A value from outside that cannot be used; the message names it and says what to do."""


def nearest(word: str, candidates: Iterable[str]) -> str:
    """Suggestion ``; did you mean 'x'?`` for a misspelt word, or an empty string."""
    close = difflib.get_close_matches(word, list(candidates), n=1, cutoff=0.5)
    return f"; did you mean {close[0]!r}?" if close else ""


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
    if value not in choices:
        raise InputError(
            f"{name} is {value!r}; use one of {', '.join(map(repr, choices))}{nearest(str(value), choices)}"
        )
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
    wanted = " and ".join(
        f"{word} {bound:g}"
        for word, bound in (
            ("above", above),
            ("at least", at_least),
            ("below", below),
            ("at most", at_most),
        )
        if bound is not None
    )
    hint = f"give a finite number{' ' + wanted if wanted else ''}"
    try:
        # float() takes a flag for a number, and numpy's complex numbers without their imaginary part.
        if isinstance(value, bool | np.bool_ | np.complexfloating):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}, not a number; {hint}") from None
    if (
        not np.isfinite(number)
        or (above is not None and not number > above)
        or (at_least is not None and not number >= at_least)
        or (below is not None and not number < below)
        or (at_most is not None and not number <= at_most)
    ):
        raise InputError(f"{name} is {number:g}; {hint}")
    return number


def require_count(name: str, value, *, at_least: int = 1) -> int:
    """Return `value` as an int of at least `at_least`, else raise `InputError`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < at_least:
        raise InputError(f"{name} is {value!r}; give a whole number, at least {at_least}")
    return int(value)


def require_array(
    name: str,
    value,
    *,
    ndim: int | None = None,
    shape: tuple[int | None, ...] | None = None,
    dtype=np.float64,
) -> np.ndarray:
    """Return `value` as a finite, C-contiguous array, else raise `InputError`.

    Parameters
    ----------
    name : str
        How the caller knows the argument.
    value : array_like
        Anything numpy turns into numbers.
    ndim : int, optional
        Number of axes that is wanted.
    shape : tuple, optional
        Shape that is wanted; None leaves an axis free.
    dtype : dtype
        Type of the returned array.
    """
    try:
        given = np.asarray(value)
        if given.dtype.kind == "c" and np.dtype(dtype).kind != "c":
            raise InputError(f"{name} is complex; give real numbers, such as the real part or the magnitude")
        array = np.ascontiguousarray(given, dtype=dtype)
    except InputError:
        raise
    except (TypeError, ValueError):
        raise InputError(f"{name} is not an array of numbers; give a rectangular array") from None
    if np.ndim(value) == 0:
        array = array.reshape(())
    if ndim is not None and array.ndim != ndim:
        raise InputError(f"{name} has shape {array.shape}; give an array with {ndim} axes")
    if shape is not None and (
        array.ndim != len(shape)
        or any(want is not None and have != want for have, want in zip(array.shape, shape, strict=True))
    ):
        wanted = " x ".join("any" if want is None else str(want) for want in shape)
        raise InputError(f"{name} has shape {array.shape}; give {wanted}")
    bad = ~np.isfinite(array)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"{name} holds {int(bad.sum())} NaN or infinite values, the first at index {first}; "
            "remove or repair them first"
        )
    return array
