"""TOML files of people's own: what is missing or of another kind is an `InputError` that names it."""

import re
import tomllib
from collections.abc import Collection
from pathlib import Path

from stillwork.base.checks import InputError, nearest, require_array, require_number, short_repr

MOST_BYTES = 2**20
MOST_PARTS = 32  # of a dotted key: the time to read one grows with the square of its parts


class Table(dict):
    """A table of a TOML file; reading a missing entry raises an error that names it."""

    def __init__(self, entries: dict, where: str):
        super().__init__({name: _entry(value, f"{where}: {name}") for name, value in entries.items()})
        self.where = where

    def __missing__(self, name: str):
        raise InputError(f"{self.where}: {name!r} is missing{nearest(name, self)}; add it")

    def require_known(self, names: Collection[str]) -> None:
        """Refuse a name beside these: a misspelt one would count as not given."""
        for name in self:
            if name not in names:
                raise InputError(
                    f"{self.where}: unknown name {name!r}{nearest(name, names)}; known: {', '.join(names)}"
                )

    def table(self, name: str) -> "Table":
        """The entry `name`, which must be a table."""
        value = self[name]
        if not isinstance(value, Table):
            raise InputError(f"{self.where}: {name} is {short_repr(value)}; make it a table [{name}]")
        return value


def read_toml(file: str | Path) -> Table:
    """Read a TOML file; it can hold values only, so reading it executes nothing."""
    file = Path(file)
    try:
        if (size := file.stat().st_size) > MOST_BYTES:
            raise InputError(
                f"{file} has {size:.3g} bytes, more than {MOST_BYTES >> 20} MB; give a TOML file"
            )
        text = file.read_text(encoding="utf-8")
        parts = re.split(r"[,=\[\]{}\n]", re.sub(r"[ \t]+", "", text))
        if (most := max(each.count(".") for each in parts)) > MOST_PARTS:
            raise InputError(f"{file}: a key has {most + 1} parts; give tables of values")
        return Table(tomllib.loads(text), file.name)
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"no file {file}; give the path of a TOML file") from None
    except OSError as error:
        raise InputError(
            f"{short_repr(str(file))} cannot be read ({error.strerror}); give a TOML file"
        ) from None
    except UnicodeDecodeError:
        raise InputError(f"{file} is not text; give a TOML file in UTF-8") from None
    except RecursionError:
        raise InputError(f"{file}: nested too deeply; give tables of values") from None
    except ValueError as error:  # not TOML, a null in the path, or more digits than Python takes
        raise InputError(f"{short_repr(str(file))}: not valid TOML ({error}); correct that line") from None


def read_numbers(file: str | Path, *, lists: bool = True) -> Table:
    """Read a TOML file whose tables hold finite numbers, flags, and lists of numbers where there may be some."""
    table = read_toml(file)
    _require_numbers(table, lists)
    return table


def _entry(value, where: str):
    if isinstance(value, dict):
        return Table(value, where)
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise InputError(f"{where} is an integer of {value.bit_length()} bits; TOML's have 64")
    return [_entry(each, where) for each in value] if isinstance(value, list) else value


def _require_numbers(table: Table, lists: bool) -> None:
    for name, value in table.items():
        where = f"{table.where}: {name}"
        if isinstance(value, Table):
            _require_numbers(value, lists)
        elif isinstance(value, list) and lists:
            require_array(where, value)
        elif not isinstance(value, bool):
            require_number(where, value)
