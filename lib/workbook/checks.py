"""The engine's checks of what people write: a message names the argument, what is wrong with it, and the way out."""

import difflib
import math
import tomllib
from collections.abc import Iterable
from pathlib import Path

import numpy as np

WORDS = {
    str: "text",
    bool: "true or false",
    dict: "a table",
    list: "a list, [...]",
}  # for kinds of TOML's values


class InputError(ValueError):
    """An argument or file that cannot be used; the message names it and states what to do.

    Control characters of what it quotes are escaped, for they steer a terminal.
    """

    def __init__(self, message: str):
        super().__init__(one_line(message))


def is_refusal(error: BaseException) -> bool:
    """Whether an error's message is for the reader: an `InputError`, of the engine or of the code that it runs."""
    return any(each.__name__ == "InputError" for each in type(error).__mro__)


def one_line(text: str) -> str:
    """`text` with escapes for what is not printed: line breaks, control codes, halves of characters."""
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in text
    )


def short_repr(value) -> str:
    """`value` as a message quotes it: no longer than a line, whatever it is."""
    try:
        text = repr(value)
    except Exception:  # a notebook's own object may raise anything
        return f"a {type(value).__name__} that cannot be shown"
    # both ends: of a path the last part tells most
    return one_line(text if len(text) <= 80 else f"{text[:37]}...{text[-40:]}")


def nearest(word, candidates: Iterable) -> str:
    """Suggestion ``; did you mean 'x'?`` for a misspelt word, or an empty string."""
    names = [each for each in candidates if isinstance(each, str)]
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.5) if isinstance(word, str) else []
    return f"; did you mean {close[0]!r}?" if close else ""


def require_choice(name: str, value, choices: Iterable[str]) -> str:
    """Return `value` when it is one of `choices`, else raise `InputError` with the nearest one."""
    choices = list(choices)
    if not isinstance(value, str) or value not in choices:
        said = ", ".join(map(repr, choices))
        raise InputError(f"{name} is {short_repr(value)}; use one of {said}{nearest(value, choices)}")
    return value


def require_kind(name: str, value, kind: type):
    """Return `value` when it is of this class, else raise `InputError`."""
    if not isinstance(value, kind):
        wanted = WORDS.get(kind, kind.__name__)
        raise InputError(f"{name} is {short_repr(value)}; give {wanted}")
    return value


def require_fields(name: str, given, known: Iterable[str], needed: Iterable[str] = ()) -> None:
    """Raise `InputError` unless `given` is a table with fields of these names alone, all `needed` ones among them."""
    known = list(known)
    for key in require_kind(name, given, dict):
        if key not in known:
            raise InputError(f"{name}: unknown field {key!r}{nearest(key, known)}")
    for key in needed:
        if key not in given:
            raise InputError(f"{name}: {key} is missing; give it")


def require_number(
    name: str,
    value,
    *,
    above: float = -math.inf,
    below: float = math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
) -> float:
    """Return `value` as a finite float within the given bounds, else raise `InputError`."""
    number = _plain(value)
    if math.isfinite(number) and above < number < below and at_least <= number <= at_most:
        return number
    bounds = {"above": above, "at least": at_least, "below": below, "at most": at_most}
    wanted = " and ".join(f"{word} {bound:g}" for word, bound in bounds.items() if math.isfinite(bound))
    raise InputError(f"{name} is {short_repr(value)}; give a finite number{wanted and ' ' + wanted}")


def _plain(value) -> float:
    """`value` as a float where it is one real number, else NaN."""
    try:
        given = np.asarray(value)
    except Exception:  # numpy asks the object, which may raise anything
        return math.nan
    is_one = given.ndim == 0 and given.dtype.kind in "iuf" and not np.ma.is_masked(value)
    return float(given) if is_one else math.nan


def require_count(name: str, value, *, at_least: int = 1) -> int:
    """Return `value` as an int of at least `at_least`, else raise `InputError`."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not at_least <= value < 2**63:
        raise InputError(f"{name} is {short_repr(value)}; give a whole number, at least {at_least}")
    return int(value)


def require_array(
    name: str, value, *, ndim: int | None = None, shape: tuple[int, ...] | None = None
) -> np.ndarray:
    """Return `value` as a finite array of floats, else raise `InputError`."""
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "biuf" or np.ma.is_masked(value):
            raise TypeError
    except Exception:  # as above
        raise InputError(f"{name} is not an array of numbers; give a rectangular array") from None
    array = given.astype(float)
    if ndim not in (None, array.ndim):
        raise InputError(f"{name} has shape {array.shape}; give an array with {ndim} axes")
    if shape not in (None, array.shape):
        raise InputError(f"{name} has shape {array.shape}; give {' x '.join(map(str, shape))}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds NaN or infinite values; remove or repair them first")
    return array


class Table(dict):
    """A table of a TOML file; reading a missing entry raises an error that names it."""

    def __init__(self, entries: dict, where: str):
        super().__init__({name: _entry(value, f"{where}: {name}") for name, value in entries.items()})
        self.where = where

    def __missing__(self, name: str):
        raise InputError(f"{self.where}: {name!r} is missing{nearest(name, self)}; add it")


def _entry(value, where: str):
    if isinstance(value, dict):
        return Table(value, where)
    return [_entry(each, where) for each in value] if isinstance(value, list) else value


def read_toml(file: str | Path) -> Table:
    """Read a TOML file; it can hold values only, so reading it executes nothing."""
    file = Path(file)
    try:
        return Table(tomllib.loads(file.read_text(encoding="utf-8")), file.name)
    except FileNotFoundError:
        raise InputError(f"no file {file}; give the path of a TOML file") from None
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror}); give a TOML file") from None
    except UnicodeDecodeError:
        raise InputError(f"{file} is not text; give a TOML file in UTF-8") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{file}: not valid TOML ({error}); correct that line") from None
