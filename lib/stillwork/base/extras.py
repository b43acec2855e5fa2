"""Packages that only some of the toolbox needs: which extra of the distribution brings them."""

import shlex
from importlib import import_module
from pathlib import Path
from types import ModuleType

BY_PACKAGE = {
    "pandas": "data",
    "pyuff": "data",
    "nptdms": "data",
    "h5py": "data",
    "pymatreader": "data",
    "control": "control",
    "distributed": "cluster",
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
    return MissingPackage(f"{name} is not installed; {install_command(BY_PACKAGE.get(name, 'workbook'))}")


def install_command(extra: str) -> str:
    """The command that brings an extra, from the clone or the wheel that this package came from: no index has it."""
    folder = Path(__file__).resolve().parents[3]
    source = str(folder) if (folder / "pyproject.toml").is_file() else _wheel()
    return f"python -m pip install {shlex.quote(f'{source}[{extra}]')}"


def _wheel() -> str:
    """The file that this package was installed from; its name alone where that was not noted or the file is gone."""
    import json
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    try:
        installed = distribution("stillwork")
    except PackageNotFoundError:
        return "stillwork-VERSION-py3-none-any.whl"
    noted = json.loads(installed.read_text("direct_url.json") or "{}").get("url", "")
    file = Path(url2pathname(urlsplit(noted).path))
    return str(file) if noted and file.exists() else f"stillwork-{installed.version}-py3-none-any.whl"
