"""What stands of each room's paper on the front page and in the citations: ``data/<room>/paper.toml``."""

from stillwork.base.checks import InputError, nearest
from stillwork.base.toml_files import read_toml
from workbook import paths

# What a room that does not say it goes without; CONTRIBUTING.md says what each is.
NOTHING = {
    "title": "",
    "paper": "",
    "source": "",
    "by": "",
    "claimed": "",
    "hero": "",
    "found": [],
    "builder": "",
    "rests": {},
    "headline": [],
    "machine": {},
}


def papers() -> dict[str, dict]:
    """Of each room, in their order, all fields of its ``paper.toml``.

    Raises
    ------
    InputError
        When a field is unknown or of another kind, or a statement lacks its words or its entry; the message names it.
    """
    return {room: _paper(room) for room in paths.rooms()}


def cited() -> dict[str, dict]:
    """Those that say where they were published."""
    return {room: paper for room, paper in papers().items() if paper["source"]}


def _paper(room: str) -> dict:
    file = paths.data(room, "paper.toml")
    given = dict(read_toml(file)) if file.is_file() else {}
    given.pop("order", None)  # which `paths.rooms` reads
    for name, value in given.items():
        if name not in NOTHING:
            raise InputError(f"{file}: unknown field {name!r}{nearest(name, NOTHING)}")
        if not isinstance(value, kind := type(NOTHING[name])):
            raise InputError(f"{file}: {name} is no {kind.__name__}")
    for name in ("found", "headline"):
        for each in given.get(name, []):
            if not isinstance(each, dict) or set(each) != {"says", "entry"}:
                raise InputError(f"{file}: {name} holds {each!r}; give {{ says = '...', entry = '...' }}")
    title = given.get("title") or room.capitalize()
    return {**NOTHING, "paper": title, **given, "title": title}
