"""What a file of one's own holds, and which notebooks can use it."""

import re
import shlex
import tomllib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np

from stillwork.checks import InputError
from stillwork.datafiles import read_columns
from stillwork.records import UNITS, load_record, unit_factor
from stillwork.site.reading import comments
from stillwork.workbook.notebooks import Notebook, select

# What reads a machine of one's own from TOML, by room.
MODELS = {
    "isolation": ("stillwork.isolation.twin", "load_twin"),
    "fixedpoint": ("stillwork.fixedpoint.plant", "load_oscillator"),
}


def inspect_file(name: str) -> str:
    """Report of what the file `name` holds, what is wrong with it, and the commands that use it.

    Raises
    ------
    InputError
        When there is no such file or it cannot be read as what its name says.
    """
    path = Path(name)
    if not path.is_file():
        raise InputError(f"{name}: no such file; give a CSV, MAT, NPZ or TOML file")
    lines = _model(path) if path.suffix.lower() == ".toml" else _record(path)
    return "\n".join(lines)


def _record(path: Path) -> Iterator[str]:
    columns = read_columns(path)
    yield f"{path.name}: {len(columns)} columns or arrays"
    width = max(map(len, columns), default=0)
    for name, values in columns.items():
        yield f"  {name:{width}}  {_described(values)}"
    try:
        record = load_record(path, "m/s^2")
    except InputError as error:
        yield f"not a record as it stands: {error}"
        return
    unit = next(filter(None, map(_unit, record.names)), "UNIT")
    channels = "1 channel" if len(record.names) == 1 else f"{len(record.names)} channels"
    yield f"a record of {channels}: {record.sample_rate:.6g} Hz, {record.duration:.4g} s"
    if unit == "UNIT":
        yield f"it does not say its unit; put one of these for UNIT: {', '.join(UNITS)}"
    yield from _commands(path, ("CSV", "MAT", "NPZ"), unit=unit, channels=record.names)


def _unit(name: str) -> str:
    """The unit in the brackets of a column's name; empty when there is none that is known."""
    found = re.search(r"[(\[](.+?)[)\]]", name)
    try:
        unit_factor(found[1])
    except (TypeError, InputError):
        return ""
    return found[1]


def _described(values: np.ndarray) -> str:
    good = values[np.isfinite(values)]
    missing = f", {values.size - good.size} missing or infinite" if good.size < values.size else ""
    if not good.size:
        return f"{values.size} values{missing}"
    if values.size == 1:
        return f"{values.item():.6g}"
    spread = f"mean {good.mean():.4g}, standard deviation {good.std():.4g}"
    return f"{values.size} values from {good.min():.4g} to {good.max():.4g}, {spread}{missing}"


def _model(path: Path) -> Iterator[str]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path.name}: not valid TOML ({error}); mend that line") from None
    yield f"{path.name}: {len(table)} entries"
    for name, value in table.items():
        shown = f"table of {', '.join(value)}" if isinstance(value, dict) else repr(value)
        yield f"  {name}: {shown}"
    for room, (module, function) in MODELS.items():
        try:
            getattr(import_module(module), function)(path)
        except InputError as error:
            yield f"not a machine of the room {room}: {error}"
        else:
            yield f"a machine of the room {room}: {module}.{function}({str(path)!r})"
            yield from _commands(path, ("TOML",), room)


def _commands(
    path: Path,
    formats: tuple[str, ...],
    room: str | None = None,
    unit: str = "",
    channels: tuple[str, ...] = (),
) -> Iterator[str]:
    """The command for each notebook with a parameter whose comment asks for a path of these formats."""
    for notebook in select(room):
        for name in _takers(notebook, formats):
            stem = name.rpartition("_")[0]
            settings = {name: path.resolve()}
            if f"{stem}_unit" in notebook.parameters:
                settings[f"{stem}_unit"] = unit
            if f"{stem}_channels" in notebook.parameters and len(channels) > 1:
                settings[f"{stem}_channels"] = f"{channels[0]},"  # a list of one
            words = " ".join(f"-p {shlex.quote(f'{key}={value}')}" for key, value in settings.items())
            yield f'for {notebook.name}: make figures ARGS="{notebook.name} {words}"'


def _takers(notebook: Notebook, formats: tuple[str, ...]) -> list[str]:
    wanted = re.compile(rf"\bpath\b.*\b({'|'.join(formats)})\b")
    return [name for name, comment in comments(notebook).items() if wanted.search(comment)]
