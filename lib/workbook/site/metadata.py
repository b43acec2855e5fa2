"""What archives read of the workbook: CodeMeta, Zenodo's record and an RO-Crate, from pyproject.toml and CITATION.cff."""

import json
import re
import tomllib
from urllib.parse import quote

from stillwork.base.checks import InputError
from workbook import paths
from workbook.site.pages import NotebookPage

LICENSES = "https://spdx.org/licenses/"
SHELVES = (
    "`notebooks/` holds the results and what each computes, `data/` the published numbers, `figures/` the accepted "
    "pictures and their numbers (a build writes to `build/figures/`), `tests/` the tests."
)
CRATE = "https://w3id.org/ro/crate/1.1"
NOTHING = {
    "license": "",
    "authors": [],
    "keywords": [],
    "requires-python": ">=3.11",
    "dependencies": [],
    "optional-dependencies": {},
}
MEDIA = {"png": "image/png", "csv": "text/csv", "ipynb": "application/x-ipynb+json"}


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


def release_date() -> str:
    """The day of the release, as CITATION.cff has it: ``2026-01-31``."""
    text = (paths.root() / "CITATION.cff").read_text(encoding="utf-8")
    if found := re.search(r"^date-released: (\d{4}-\d{2}-\d{2})$", text, re.MULTILINE):
        return found[1]
    raise InputError(
        "CITATION.cff has no line 'date-released: YEAR-MONTH-DAY'; give it the day of the release"
    )


def codemeta(papers: dict[str, dict]) -> str:
    """``codemeta.json``; `papers` are the published works by topic."""
    about = project()
    record = {
        "@context": "https://w3id.org/codemeta/3.0",
        "@type": "SoftwareSourceCode",
        "name": about["name"],
        "description": about["description"],
        "version": about["version"],
        **({"license": LICENSES + about["license"]} if about["license"] else {}),
        "author": [{"@type": "Organization", "name": author["name"]} for author in about["authors"]],
        "keywords": about["keywords"],
        **({"codeRepository": address()} if address() else {}),
        "programmingLanguage": {"@type": "ComputerLanguage", "name": "Python"},
        "runtimePlatform": f"Python {about['requires-python']}",
        "softwareRequirements": _requirements(about),
        "referencePublication": [
            {"@type": "ScholarlyArticle", "name": paper["paper"], "description": paper["source"]}
            for paper in papers.values()
        ],
    }
    return _text(record)


def zenodo(papers: dict[str, dict]) -> str:
    """``.zenodo.json``: the fields of a deposit of software."""
    about = project()
    sources = "; ".join(f"{paper['paper']} ({paper['source']})" for paper in papers.values())
    record = {
        "title": f"{about['name']}: {about['description'][0].lower()}{about['description'][1:]}",
        "upload_type": "software",
        "description": f"{about['description']}. It regenerates the results of: {sources}.",
        "creators": [{"name": author["name"]} for author in about["authors"]],
        "version": about["version"],
        "publication_date": release_date(),
        "access_right": "open",
        "license": about["license"].lower(),
        "keywords": about["keywords"],
        "language": "eng",
    }
    if address():
        record["related_identifiers"] = [
            {"identifier": address(), "relation": "isSupplementTo", "resource_type": "software"}
        ]
    return _text(record)


def crate(papers: dict[str, dict], pages: list[NotebookPage]) -> str:
    """``ro-crate-metadata.json``: each notebook as the software that made its pictures and tables."""
    about = project()
    entities, actions = [], []
    for page in pages:
        notebook = f"notebooks/{page.name}.ipynb"
        entities.append(_file(notebook, page.title) | {"@type": ["File", "SoftwareSourceCode"]})
        made = [
            _file(f"{figure.path}.{kind}", f"{page.title}: {figure.name}, {what}")
            for figure in page.figures
            if figure.csv is not None
            for kind, what in (("png", "picture"), ("csv", "plotted numbers"))
        ]
        entities += made
        actions.append(
            {
                "@id": f"#make-{page.name}",
                "@type": "CreateAction",
                "name": page.command,
                "instrument": {"@id": notebook},
                "result": [{"@id": each["@id"]} for each in made],
            }
        )
    people = [
        {"@id": f"#author-{number}", "@type": "Organization", "name": author["name"]}
        for number, author in enumerate(about["authors"], 1)
    ]
    makers = [{"@id": each["@id"]} for each in people]
    makers = makers[0] if len(makers) == 1 else makers  # the crate's recommendation for a single value
    articles = [
        {
            "@id": f"#{topic}",
            "@type": "ScholarlyArticle",
            "name": paper["paper"],
            "description": paper["source"],
        }
        for topic, paper in papers.items()
    ]
    descriptor = {
        "@id": "ro-crate-metadata.json",
        "@type": "CreativeWork",
        "conformsTo": {"@id": CRATE},
        "about": {"@id": "./"},
    }
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": about["name"],
        "description": about["description"],
        "version": about["version"],
        **({"url": address()} if address() else {}),
        "datePublished": release_date(),
        "license": {"@id": LICENSES + about["license"]},
        "keywords": ", ".join(about["keywords"]),
        "author": makers,
        "publisher": makers,
        "citation": [{"@id": each["@id"]} for each in articles],
        "hasPart": [{"@id": each["@id"]} for each in entities],
        "mentions": [{"@id": each["@id"]} for each in actions],
    }
    terms = {"@id": LICENSES + about["license"], "@type": "CreativeWork", "name": about["license"]}
    graph = [descriptor, root, terms, *people, *articles, *entities, *actions]
    return _text({"@context": f"{CRATE}/context", "@graph": graph})


def _file(path: str, name: str) -> dict:
    return {"@id": path, "@type": "File", "name": name, "encodingFormat": MEDIA[path.rpartition(".")[2]]}


def _requirements(about: dict) -> list[str]:
    """What the workbook needs: the toolbox's own and those of its extras, without what only tests need."""
    extras = about["optional-dependencies"]
    every = about["dependencies"] + [
        each for name, listed in extras.items() if name != "all" for each in listed
    ]
    return sorted(each for each in every if not each.startswith("stillwork["))


def _text(record: dict) -> str:
    return json.dumps(record, indent=1, ensure_ascii=False) + "\n"
