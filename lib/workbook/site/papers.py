"""What stands of each topic's paper on the front page and in the citations: ``data/<topic>/paper.toml``."""

from stillwork.base.checks import InputError, nearest
from stillwork.base.toml_files import read_toml
from workbook import paths

# What a topic that does not say it goes without; CONTRIBUTING.md says what each is.
NOTHING = {
    "title": "",
    "paper": "",
    "source": "",
    "by": "",
    "claimed": "",
    "hero": "",
    "on": "",
    "moving": "",
    "found": [],
    "builder": "",
    "rests": {},
    "headline": [],
    "machine": {},
}


def papers() -> dict[str, dict]:
    """Of each topic, in their order, all fields of its ``paper.toml``.

    Raises
    ------
    InputError
        When a field is unknown or of another kind, or a statement lacks its words or its entry; the message names it.
    """
    return {topic: _paper(topic) for topic in paths.topics()}


def _paper(topic: str) -> dict:
    file = paths.data(topic, "paper.toml")
    given = dict(read_toml(file)) if file.is_file() else {}
    given.pop("order", None)  # which `paths.topics` reads
    for name, value in given.items():
        if name not in NOTHING:
            raise InputError(f"{file}: unknown field {name!r}{nearest(name, NOTHING)}")
        if not isinstance(value, kind := type(NOTHING[name])):
            raise InputError(f"{file}: {name} is no {kind.__name__}")
    for name in ("found", "headline"):
        for each in given.get(name, []):
            if not isinstance(each, dict) or not {"says", "entry"} <= set(each) <= {
                "says",
                "entry",
                "otherwise",
            }:
                raise InputError(
                    f"{file}: {name} holds {each!r}; give {{ says = '...', entry = '...' }}, perhaps otherwise = '...'"
                )
    title = given.get("title") or topic.capitalize()
    return {**NOTHING, "paper": title, **given, "title": title}
