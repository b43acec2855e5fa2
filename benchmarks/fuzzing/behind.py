"""Calls of what the catalogue does not call, made from the annotations; they need not work, only end as documented."""

import dataclasses
import inspect
import types
import typing
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from jaxtyping import AbstractArray

from stillwork.base import validation
from stillwork.base.checks import InputError

PLAIN = {
    float: 1.0,
    int: 2,
    bool: False,
    str: "x",
    Path: Path("missing.csv"),
    Callable: np.sin,
    np.ndarray: np.eye(2),
    None: np.eye(2),  # of no annotation
    typing.Any: np.eye(2),
    slice: slice(0, 2),
    np.random.Generator: np.random.default_rng(1),
}


class NotMade(Exception):
    """There is no value for such an annotation."""


def public(folder: SimpleNamespace) -> Iterator[tuple[str, Callable]]:
    """Name and function of all that a stranger can import from a folder and call: functions and methods."""
    for name, thing in list(vars(folder).items()):
        if name.startswith("_"):
            continue
        if inspect.isfunction(thing):
            yield name, thing
        elif inspect.isclass(thing) and not getattr(thing, "_is_protocol", False):
            for method, value in list(vars(thing).items()):
                function = getattr(value, "__func__", value)
                if not method.startswith("_") and inspect.isfunction(function):
                    yield f"{name}.{method}", getattr(thing, method)


class Values:
    """Good values by the name of their parameter and by their class, out of the calls that are written out."""

    def __init__(self, catalogue: dict):
        self.by_name: dict[str, list] = {}
        self.by_kind: dict[type, object] = dict(PLAIN)
        for function, good in catalogue.values():
            self._keep(getattr(function, "__self__", None))
            for name, value in good.items():
                self.by_name.setdefault(name, []).append(value)
                self._keep(value)

    def _keep(self, value) -> None:
        """A model, and those that it is made of."""
        if isinstance(value, list | tuple) and len(value) < 10:
            for each in value:
                self._keep(each)
        elif dataclasses.is_dataclass(value) and not isinstance(value, type):
            for field in dataclasses.fields(value):
                self._keep(getattr(value, field.name))
        self.by_kind.setdefault(type(value), value)

    def call(self, function: Callable, owner: type | None) -> tuple[Callable, dict]:
        """The function, bound to a model where it is a method, and its arguments by name."""
        plain = inspect.unwrap(function)
        hints, checks = typing.get_type_hints(plain), validation.checks_of(plain)
        good = {}
        for name, parameter in inspect.signature(plain).parameters.items():
            if name != "self" and parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY):
                good[name] = self._argument(name, hints.get(name), checks.get(name))
        if "self" in inspect.signature(plain).parameters:
            function = function.__get__(self.made(owner))
        return function, good

    def _argument(self, name: str, hint, check: Callable | None):
        for value in self.by_name.get(name, ()):
            with suppress(InputError):
                if check is not None:
                    check(name, value)
                return value
        return self.made(hint)

    def made(self, hint):
        """A value of this annotation."""
        origin, parts = typing.get_origin(hint), typing.get_args(hint)
        if hint in self.by_kind:
            return self.by_kind[hint]
        if inspect.isclass(hint) and (
            fit := [each for each in self.by_kind.values() if isinstance(each, hint)]
        ):
            return fit[0]
        if inspect.isclass(hint) and issubclass(hint, AbstractArray):
            sizes = [int(axis) if axis.isdigit() else 2 for axis in hint.dim_str.split()]
            return np.ones(sizes, hint.dtypes[0])
        if hint in validation.OPEN:
            return np.ones(2)
        if origin in (types.UnionType, typing.Union):
            return np.ones(2) if validation.OPEN & set(parts) else self._first(parts)
        if origin is Callable:
            return np.sin
        if origin in (dict, Mapping):
            return {"x": self.made(parts[1])}
        if origin is tuple and parts[-1] is not ...:
            return tuple(self.made(part) for part in parts)
        if origin in (list, tuple, Sequence, Collection, Iterable):
            return [self.made(parts[0])] * 2
        if dataclasses.is_dataclass(hint) or hasattr(hint, "_fields"):
            hints = typing.get_type_hints(hint)
            checks = validation.checks_of(hint) if dataclasses.is_dataclass(hint) else {}
            names = (
                [field.name for field in dataclasses.fields(hint)]
                if dataclasses.is_dataclass(hint)
                else hint._fields
            )
            return hint(**{name: self._argument(name, hints[name], checks.get(name)) for name in names})
        raise NotMade(f"no value of {hint}")

    def _first(self, parts):
        for part in parts:
            with suppress(NotMade):
                return self.made(part)
        raise NotMade(f"no value of {parts}")


def calls(catalogue: dict, folders: dict[str, SimpleNamespace], called: Callable) -> tuple[dict, list[str]]:
    """Calls of the public functions of which not yet `called`, by folder and name, and those that cannot be made."""
    values, made, failed = Values(catalogue), {}, []
    for folder, whole in folders.items():
        for name, function in public(whole):
            if called(folder, name):
                continue
            owner = getattr(whole, name.partition(".")[0])
            try:
                made[f"{folder}.{name}"] = values.call(function, owner if inspect.isclass(owner) else None)
            except (NotMade, InputError, TypeError):
                failed.append(f"{folder}.{name}")
    return made, failed
