"""Parameters of a notebook: lines ``name: type = literal``, checked before anything runs."""

import ast
import math
import re
import typing
import warnings
from dataclasses import dataclass
from types import UnionType

from workbook.checks import InputError

TYPES = {"int": int, "float": float, "str": str, "bool": bool, "list": list, "tuple": tuple}
FORM = "write 'name: type = literal  # comment', one parameter a line"


@dataclass(frozen=True)
class Parameter:
    """One line of a notebook's parameters cell; `value` is the notebook's own setting."""

    name: str
    annotation: str
    value: object

    def read(self, text: str) -> object:
        """Turn the text of ``-p NAME=VALUE`` into a value of the declared type; for a ``str`` it is the text itself.

        Raises
        ------
        InputError
            When the text is not of that type.
        """
        if self.annotation == "str":
            return text
        for candidate in _candidates(text):
            try:
                return _converted(candidate, _type(self.annotation))
            except TypeError:
                continue
        raise InputError(
            f"parameter {self.name} is {text!r}; give {_article(self.annotation)} (in the notebook: {self.value!r})"
        )


def read_parameters(file: str, source: str) -> dict[str, Parameter]:
    """Parameters that a cell declares; `file` is named in the `InputError` about a malformed line."""
    lines = source.splitlines()

    def wrong(line: int, why: str) -> InputError:
        return InputError(f"{file}: parameters cell, line {line}: {lines[line - 1].strip()!r} {why}; {FORM}")

    try:
        statements = ast.parse(source).body
    except SyntaxError as error:
        raise wrong(error.lineno or 1, "is not Python") from None
    found = {}
    for statement in statements:
        line = statement.lineno
        if not (
            isinstance(statement, ast.AnnAssign)
            and isinstance(statement.target, ast.Name)
            and statement.value is not None
        ):
            raise wrong(line, "declares no parameter")
        annotation = ast.unparse(statement.annotation)
        try:
            value = _converted(ast.literal_eval(statement.value), _type(annotation))
        except ValueError:
            raise wrong(line, "does not have a literal value or a plain type") from None
        except TypeError:
            raise wrong(line, f"is not {_article(annotation)}") from None
        found[statement.target.id] = Parameter(statement.target.id, annotation, value)
    return found


def _type(annotation: str):
    """The type that an annotation of plain types spells; ValueError for any other."""
    plain = re.sub(r"\bNone\b", "", annotation)
    if set(re.findall(r"[^\W\d]\w*", plain)) - set(TYPES):
        raise ValueError(annotation)
    try:
        return eval(annotation, {"__builtins__": {}}, TYPES)
    except (SyntaxError, TypeError):
        raise ValueError(annotation) from None


def _converted(value, kind):
    """`value` as a `kind` (a whole number serves as a float); TypeError when it is none."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin is UnionType:
        for part in sorted(parts, key=lambda part: part is not type(value)):
            try:
                return _converted(value, part)
            except TypeError:
                continue
    elif kind is None or kind is type(None):
        if value is None:
            return None
    elif origin in (list, tuple) and isinstance(value, list | tuple):
        if origin is list or parts[1:] == (...,):
            return origin(_converted(each, parts[0]) for each in value)
        if len(parts) == len(value):
            return tuple(_converted(each, part) for each, part in zip(value, parts, strict=True))
    elif kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        try:
            value = float(value)
        except OverflowError:
            raise TypeError(kind) from None
        if math.isfinite(value):
            return value
    elif type(value) is kind:
        return value
    raise TypeError(kind)


def _candidates(text: str):
    """What a shell's text may mean: a Python literal, a word for one, a list by commas (``a,`` is one of one), itself.

    The parts of a list, too, may be literals or just text.
    """
    words = {"none": None, "true": True, "false": False}
    if text.lower() in words:
        yield words[text.lower()]
    try:
        # Python's doubts about a text such as 1if are not the user's.
        with warnings.catch_warnings(action="ignore"):
            value = ast.literal_eval(text)
        yield value
    except (ValueError, SyntaxError, MemoryError, RecursionError, OverflowError, TypeError):
        pass
    if "," in text:
        parts = [part.strip() for part in text.strip("[]()").removesuffix(",").split(",")]
        yield [next(_candidates(part)) for part in parts]
        yield parts
    yield text


def _article(annotation: str) -> str:
    return f"{'an' if annotation[0] in 'aeiou' else 'a'} {annotation}"
