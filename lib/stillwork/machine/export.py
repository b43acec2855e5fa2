"""C99 of a controller or an adaptation from a file: the command ``export``, and how its folder is written."""

from dataclasses import MISSING, fields
from pathlib import Path
from tempfile import TemporaryDirectory

from stillwork import estimation
from stillwork.base.checks import InputError, require_choice
from stillwork.base.toml_files import Table, read_toml
from stillwork.control.digital import load_controller
from stillwork.machine.c_code import adaptation_code, controller_code, least_squares_code
from stillwork.machine.html_page import require_writable

# by the name of a table: what sizes it takes beside settings, and what writes its C
ESTIMATORS = {
    "FeRls": (("actuators", "regressors"), adaptation_code),
    "FeLms": (("actuators", "regressors"), adaptation_code),
    "RecursiveLeastSquares": (("features", "outputs"), least_squares_code),
}


def export_file(file: str, folder: str, name: str, precision: str) -> list[str]:
    """Write the content of `file` as C99 into a new or empty folder; returns a line that lists what was written.

    The file is ``controller.json`` of the command ``design`` or of the desk; or TOML with a table [controller], see
    `stillwork.control.load_controller`, or [FeRls] or [FeLms] with their settings, ``actuators`` and ``regressors``, or
    [RecursiveLeastSquares] with its settings, ``features`` and ``outputs``.
    """
    table = read_toml(file) if file.lower().endswith(".toml") else Table({"controller": None}, file)
    if "controller" in table:
        files = controller_code(load_controller(file), name, precision)
    else:
        kind = require_choice(f"{table.where}: table", next(iter(table), None), ["controller", *ESTIMATORS])
        given, (wanted, write) = table.table(kind), ESTIMATORS[kind]
        made = getattr(estimation, kind)
        known = {field.name: field for field in fields(made)}
        sizes = {size: given[size] for size in wanted}
        needed = {name: given[name] for name, each in known.items() if each.default is MISSING}
        for each in given:
            require_choice(f"{table.where}: setting of {kind}", each, [*sizes, *known])
        settings = made(**needed | {each: given[each] for each in given if each in known})
        files = write(settings, **sizes, name=name, precision=precision)
    write_folder(folder, files)
    return [f"{folder}: {', '.join(files)}"]


def write_folder(folder: str | Path, files: dict[str, str]) -> None:
    """Write texts as files into a new or empty folder: all of them, put in place by one step, or none."""
    require_free(folder)
    folder = Path(folder).resolve()
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as beside:
        new = Path(beside) / folder.name
        new.mkdir()
        for name, text in files.items():
            (new / name).write_bytes(text.encode())
        if folder.exists():
            folder.rmdir()  # fails if it was filled meanwhile
        new.rename(folder)


def require_free(folder: str | Path) -> None:
    """Refuse a folder that is not empty, since nothing is overwritten, and one that cannot be written to."""
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(
            f"{folder} is not empty; nothing is overwritten: give a new folder, or move this one away"
        )
    require_writable(folder.absolute().parent)
