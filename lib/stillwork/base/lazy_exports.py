"""Faces of packages: public names that are imported from their modules when they are first used."""

import sys
from collections.abc import Callable
from importlib import import_module
from types import ModuleType

from stillwork.base.extras import missing


class _Package(ModuleType):
    """A package in which the import system covers no public name by a module of the same name."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (isinstance(value, ModuleType) and name in self.__dict__.get("__all__", ())):
            super().__setattr__(name, value)


def lazy_exports(
    package: str, names: dict[str, tuple[str, ...]]
) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """``__all__``, ``__getattr__`` and ``__dir__`` of `package`, whose modules define these names.

    A name may be that of a module of the package: the package's is the public one, and ``from package.name import``
    still finds the module.
    """
    modules = {name: module for module, listed in names.items() for name in listed}
    sys.modules[package].__class__ = _Package

    def attribute(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            return getattr(import_module(f"{package}.{modules[name]}"), name)
        except ModuleNotFoundError as error:
            raise missing(error) from None

    return sorted(modules), attribute, lambda: sorted(modules)
