"""What pages and manifests say of the workbook, from pyproject.toml."""

import tomllib
from urllib.parse import quote

from workbook import paths

SHELVES = (
    "`notebooks/` holds the results and what each computes, `data/` the published numbers, `figures/` the accepted "
    "pictures and their numbers (a build writes to `build/figures/`), `tests/` the tests."
)
NOTHING = {"license": "", "authors": []}


def project() -> dict:
    """What pyproject.toml says of the project, with nothing in the place of what it leaves out."""
    return NOTHING | tomllib.loads((paths.root() / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def about() -> dict[str, str]:
    """What pages and index say of the workbook: of pyproject.toml, with the texts of its ``[tool.workbook]``."""
    said = project()
    own = {"title": said["name"], "subject": said["description"], "shelves": SHELVES}
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
