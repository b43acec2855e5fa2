"""Faces of packages: public names that are imported from their modules when they are first used."""

from collections.abc import Callable
from importlib import import_module

from stillwork.base.extras import missing


def lazy_exports(
    package: str, names: dict[str, tuple[str, ...]]
) -> tuple[list[str], Callable[[str], object], Callable[[], list[str]]]:
    """``__all__``, ``__getattr__`` and ``__dir__`` of `package`, whose modules define these names; none is a module's."""
    modules = {name: module for module, listed in names.items() for name in listed}

    def attribute(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        try:
            return getattr(import_module(f"{package}.{modules[name]}"), name)
        except ModuleNotFoundError as error:
            raise missing(error) from None

    return sorted(modules), attribute, lambda: sorted(modules)
