"""What pages and manifests say of the workbook, from pyproject.toml, and of each topic's paper, from ``data/<topic>/paper.toml``."""

import tomllib
from urllib.parse import quote

from workbook import paths
from workbook.checks import read_toml, require_fields, require_kind

FOLDERS = (
    "`notebooks/` holds the results and what each computes, `data/` the published numbers, `figures/` the accepted "
    "pictures and their numbers (a build writes to `build/figures/`), `tests/` the tests."
)
NOTHING = {"license": "", "authors": []}
# What a topic that does not say it goes without; CONTRIBUTING.md says what each is.
PAPER = {
    "title": "",
    "paper": "",
    "source": "",
    "by": "",
    "claimed": "",
    "hero": "",
    "limits": [],
    "equal": {},
    "untried": {},
    "on": "",
    "moving": "",
    "found": [],
    "builder": "",
    "rests": {},
    "headline": [],
    "machine": {},
    "printed": {},
}


def project() -> dict:
    """What pyproject.toml says of the project, with nothing in the place of what it leaves out."""
    return NOTHING | tomllib.loads((paths.root() / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def about() -> dict[str, str]:
    """What pages and index say of the workbook: of pyproject.toml, with the texts of its ``[tool.workbook]``."""
    said = project()
    own = {"title": said["name"], "subject": said["description"], "folders": FOLDERS}
    return {name: said[name] for name in ("name", "version", "license")} | own | paths.own_settings()


def address() -> str:
    """Where the source lies in public, as pyproject.toml has it under ``[project.urls]``; empty while it has none."""
    return project().get("urls", {}).get("Repository", "").rstrip("/")


def binder(path: str) -> str:
    """Where mybinder.org opens a file of this release in a browser; empty while the source has no public address."""
    if not address():
        return ""
    place = f"{quote(address(), safe='')}/v{project()['version']}"
    return f"https://mybinder.org/v2/git/{place}?labpath={quote(path, safe='')}"


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
    require_fields(f"{file}", given, PAPER)
    for name, value in given.items():
        require_kind(f"{file}: {name}", value, type(PAPER[name]))
    for name in ("found", "headline"):
        for each in given.get(name, []):
            require_fields(f"{file}: {name}", each, ("says", "entry", "otherwise"), ("says", "entry"))
    title = given.get("title") or topic.capitalize()
    return {**PAPER, "paper": title, **given, "title": title}
