"""Packages that only some of the toolbox needs: which extra of the distribution brings them."""

from importlib import import_module
from types import ModuleType

BY_PACKAGE = {
    "pandas": "data",
    "pyuff": "data",
    "control": "control",
    "cvxpy": "control",
    "clarabel": "control",
    "sklearn": "regression",
    "matplotlib": "design",
}

OF_A_CHECKOUT = ("experiments", "contest", "notebooks")


class MissingPackage(ImportError):
    """A package that was not installed; the message names the extra that brings it."""


def require_package(name: str) -> ModuleType:
    """Import `name`, or raise `MissingPackage`."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise missing(error) from None


def missing(error: ModuleNotFoundError) -> ImportError:
    """The error to raise in place of `error`: itself for a module that no extra brings."""
    name = (error.name or "").partition(".")[0]
    if name in OF_A_CHECKOUT:
        return MissingPackage(
            f"this needs the folder {name}, which stands in a checkout of stillwork; run it there"
        )
    if not name or name in ("stillwork", "workbook"):
        return error
    extra = BY_PACKAGE.get(name, "workbook")
    return MissingPackage(f"{name} is not installed; pip install 'stillwork[{extra}]'")
