"""Tables of a TOML file as frozen dataclasses: a missing or unknown name is refused with the nearest one."""

from dataclasses import MISSING, fields

from stillwork.base.checks import (
    InputError,
    nearest,
    require_array,
    require_count,
    require_number,
    short_repr,
)


def require_table(where: str, given) -> dict:
    """Return `given` when it is a table, else raise `InputError`."""
    if not isinstance(given, dict):
        raise InputError(f"{where} is {short_repr(given)}; give a table [{where}]")
    return given


def require_names(where: str, given, required, optional=()) -> None:
    """Raise `InputError` when a name of `required` is missing or one is in neither list."""
    known = [*required, *optional]
    for name in require_table(where, given):
        if name not in known:
            raise InputError(
                f"{where}: unknown name {name!r}{nearest(name, known)}; known: {', '.join(known)}"
            )
    for name in required:
        if name not in given:
            raise InputError(f"{where}: {name!r} is missing; add it")


def build(record: type, table, where: str):
    """Make the dataclass `record` from a TOML table; its own checks speak with `where` in front."""
    required = [f.name for f in fields(record) if f.default is MISSING and f.default_factory is MISSING]
    optional = [f.name for f in fields(record) if f.name not in required]
    require_names(where, table, required, optional)
    try:
        typed = {f.name: _typed(f.name, table[f.name], f.type) for f in fields(record) if f.name in table}
        return record(**typed)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _typed(name: str, value, wanted):
    """TOML tells 5 from 5.0; a model's author should not have to."""
    if wanted is float:
        return require_number(name, value)
    if wanted is int:
        return require_count(name, value, at_least=0)
    if wanted == list[float]:
        return require_array(name, value, ndim=1).tolist()
    if wanted is str and not isinstance(value, str):
        raise InputError(f"{name} is {value!r}; give text in quotes")
    return value
