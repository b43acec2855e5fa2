"""Committed files that follow from others: README blocks, the index notebook, the manifest."""

import json
from collections import Counter
from collections.abc import Callable
from html import escape

from workbook import paths
from workbook.claims import Claim, ledger
from workbook.notebooks import METADATA, notebook_text
from workbook.publish import replace_file
from workbook.report import (
    column,
    columns,
    our_quantity,
    published_quantity,
    readme_with_summary,
    tally,
)
from workbook.site.metadata import about, papers, project
from workbook.site.pages import NotebookPage, read_page
from workbook.tasks import tasks

GALLERY_BEGIN, GALLERY_END = "<!-- gallery:begin -->", "<!-- gallery:end -->"
IN_A_ROW = 4  # pictures of the README
CODECHECK = "https://codecheck.org.uk/spec/config/2.0/"


def refresh() -> list[str]:
    """Write the derived files that are not current; returns their names."""
    stale = {name: text for name, text in derived_files().items() if _present(name) != text}
    for name, text in stale.items():
        replace_file(paths.root() / name, text.encode())
    return list(stale)


def derived_files() -> dict[str, str]:
    """What the derived files must hold, by path."""
    claims = ledger()
    pages = [read_page(task, claims) for task in tasks()]
    makers: dict[str, Callable[[list[NotebookPage], list[Claim]], str]] = {
        "README.md": _readme,
        "notebooks/index.ipynb": _index,
        "codecheck.yml": _codecheck,
    }
    if _present("README.md") is None:  # a workbook may do without
        del makers["README.md"]
    return {name: make(pages, claims) for name, make in makers.items()}


def _present(name: str) -> str | None:
    file = paths.root() / name
    return file.read_text(encoding="utf-8") if file.is_file() else None


def _readme(pages: list[NotebookPage], _claims: list[Claim]) -> str:
    text = readme_with_summary(_present("README.md"))
    before, begin, rest = text.partition(GALLERY_BEGIN)
    _, end, after = rest.partition(GALLERY_END)
    return f"{before}{begin}\n{_gallery(pages)}\n{end}{after}" if begin and end else text


def _gallery(pages: list[NotebookPage]) -> str:
    """One row: the picture that stands for each of the first topics, leading to its notebook."""
    shown = {(page.name, figure.name): (page, figure) for page in pages for figure in page.figures}
    cells = []
    for paper in papers().values():
        notebook, _, name = paper.get("hero", "").rpartition("/")
        if (notebook, name) in shown:
            page, figure = shown[notebook, name]
            title = escape(f"{paper['title']}: {page.title}")
            cells.append(
                f'<a href="notebooks/{page.name}.ipynb"><img src="{figure.path}.png" width="200" '
                f'alt="{title}" title="{title}"></a>'
            )
    return "\n".join(cells[:IN_A_ROW])


def _index(pages: list[NotebookPage], claims: list[Claim]) -> str:
    shown = columns(claims)
    parts = [
        "# The notebooks\n\nA topic for each paper, a notebook for each result. Run a notebook with "
        "*Run > Run All Cells*, change its cell of parameters, or move the sliders of its explorer.",
        "## What agrees with the papers\n\n"
        + "\n".join(
            [
                "| topic | paper | " + " | ".join(shown) + " |",
                "|---|---|" + "---:|" * len(shown),
                *(_row(topic, paper, claims, shown) for topic, paper in papers().items()),
            ]
        ),
    ]
    for topic, paper in papers().items():
        mine = [page for page in pages if page.topic == topic]
        if mine:
            listing = "\n".join(
                f"- [{page.title}]({page.name}.ipynb){_verdicts(page.claims)}" for page in mine
            )
            first = _headline(paper, claims)
            said = f"{paper['claimed']}\n\n" if paper["claimed"] else ""
            parts.append(f"## {paper['title']} (`{topic}`)\n\n{said}{first}{listing}")
    parts.append(f"## Folders\n\n{about()['folders']}")
    cells = [
        # In lines, as Jupyter writes them.
        {"cell_type": "markdown", "id": f"part-{number}", "metadata": {}, "source": text.splitlines(True)}
        for number, text in enumerate(parts, 1)
    ]
    return notebook_text({"cells": cells, "metadata": METADATA, "nbformat": 4, "nbformat_minor": 5})


def _headline(paper: dict, claims: list[Claim]) -> str:
    """What the paper claims first, as a table that ends with a blank line; empty where the ledger has none of it."""
    by_id = {claim.entry.id: claim for claim in claims}
    rows = [
        f"| {each['says']} | {published_quantity(claim)} | {our_quantity(claim)} | {claim.judgement} |"
        for each in paper["headline"]
        if (claim := by_id.get(each["entry"]))
    ]
    if not rows:
        return ""
    return (
        "\n".join(["| the paper claims | published | ours | verdict |", "|---|---|---|---|", *rows]) + "\n\n"
    )


def _row(topic: str, paper: dict, claims: list[Claim], shown: list[str]) -> str:
    counts = Counter(column(claim) for claim in claims if claim.entry.topic == topic)
    numbers = " | ".join(str(counts[name]) for name in shown)
    return f"| `{topic}` | {paper['paper']} | {numbers} |"


def _verdicts(claims: tuple[Claim, ...]) -> str:
    return f": {tally(claims)}" if claims else ""


def _codecheck(pages: list[NotebookPage], _claims: list[Claim]) -> str:
    """The manifest of https://codecheck.org.uk: every output, and what of which work it replicates."""
    lines = ["---", f"version: {CODECHECK}", "paper:"]
    lines += [f"  title: {_quoted(project()['description'])}", "  authors:"]
    lines += [f"    - name: {_quoted(author['name'])}" for author in project()["authors"]]
    lines.append("manifest:")
    sources = {topic: paper["paper"] for topic, paper in papers().items()}
    for page in pages:
        for figure in page.figures:
            if figure.csv:
                about = [claim for claim in page.claims if page.figure_of(claim) == figure]
                places = ", ".join(dict.fromkeys(claim.entry.place.partition(",")[0] for claim in about))
                comment = f"{page.title}. {sources[page.topic]}" + (f"; {places}" if places else "")
                lines += _output(f"{figure.path}.png", comment)
                lines += _output(f"{figure.path}.csv", f"the numbers plotted in {figure.name}.png")
        if page.claims:
            lines += _output(
                f"figures/{page.name}/claims.json",
                f"{page.title}: {len(page.claims)} entries of the ledger as found here{_verdicts(page.claims)}",
            )
    return "\n".join([*lines, ""])


def _output(file: str, comment: str) -> list[str]:
    return [f"  - file: {file}", f"    comment: {_quoted(comment)}"]


def _quoted(text: str) -> str:
    """A string of JSON is one of YAML."""
    return json.dumps(text, ensure_ascii=False)
