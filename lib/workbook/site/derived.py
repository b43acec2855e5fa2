"""Committed files that follow from others: README blocks, the index notebook, the manifest, what the papers conclude."""

from collections import Counter
from collections.abc import Callable
from html import escape

from workbook import paths
from workbook.choices.command import judged_ledger
from workbook.claims import Claim
from workbook.notebooks import METADATA, notebook_text
from workbook.publish import replace_file
from workbook.report import REPLICATIONS, column, summary
from workbook.site.metadata import about, papers, project
from workbook.site.pages import NotebookPage, read_page
from workbook.site.specification import said_of, sentence
from workbook.site.stated import PAGE, page_of
from workbook.tasks import tasks

WIDTH = 720  # of the README's picture, pixels
CODECHECK = "https://codecheck.org.uk/spec/config/2.0/"


def refresh() -> list[str]:
    """Write the derived files that are not current; returns their names."""
    stale = {name: text for name, text in derived_files().items() if _present(name) != text}
    for name, text in stale.items():
        replace_file(paths.root() / name, text.encode())
    return list(stale)


def derived_files() -> dict[str, str]:
    """What the derived files must hold, by path."""
    claims = judged_ledger()
    pages = [read_page(task, claims) for task in tasks()]
    makers: dict[str, Callable[[list[NotebookPage], list[Claim]], str]] = {
        "README.md": _readme,
        "notebooks/index.ipynb": _index,
        "codecheck.yml": _codecheck,
    }
    if any(paths.data(topic, "conclusions.toml").exists() for topic in papers()):
        makers[PAGE] = _conclusions
    if _present("README.md") is None:  # a workbook may do without
        del makers["README.md"]
    return {name: make(pages, claims) for name, make in makers.items()}


def _present(name: str) -> str | None:
    file = paths.root() / name
    return file.read_text(encoding="utf-8") if file.is_file() else None


def _readme(pages: list[NotebookPage], claims: list[Claim]) -> str:
    text = _present("README.md")
    for name, block in (("ledger", summary(claims)), ("found", _found(claims)), ("picture", _picture(pages))):
        before, begin, rest = text.partition(f"<!-- {name}:begin -->")
        _, end, after = rest.partition(f"<!-- {name}:end -->")
        text = f"{before}{begin}\n{block}\n{end}{after}" if begin and end else text
    return text


def _found(claims: list[Claim]) -> str:
    """What was found, in a sentence for all published numbers and one for each paper."""
    counts = Counter(map(column, claims))
    *words, differs, open_ = REPLICATIONS
    whole, mostly, rarely, *seen = (counts[word] for word in words)
    lines = [
        f"- Of {sum(counts[name] for name in REPLICATIONS)} numbers that the papers print, {whole} are replicated by a "
        f"prediction, {mostly} mostly and {rarely} rarely; {sum(seen)} are so only after a fit or a choice that used a printed "
        f"number, {counts[differs]} are not replicated, and {counts[open_]} cannot be judged."
    ]
    for paper in papers().values():
        for said, claim in said_of(paper["found"][:1], claims) if paper["source"] else ():
            words, over = sentence(said, claim).rstrip("."), claim.over
            if over is not None and over.share is not None:
                words += f" ({claim.verdict}: {over.agree} of {over.tried} combinations of open choices)"
            else:
                words += f" ({claim.verdict})"
            lines.append(f"- **{paper['title']}**{f' ({by})' if (by := paper['by']) else ''}: {words}.")
    return "\n".join(lines)


def _picture(pages: list[NotebookPage]) -> str:
    """The picture that ``[tool.workbook] picture`` names, or the first that stands for a paper, leading to its notebook."""
    named = [paths.own_settings().get("picture", ""), *(paper["hero"] for paper in papers().values())]
    shown = {figure.path: page for page in pages for figure in page.figures}
    for path in (f"figures/{name}" for name in named):
        if page := shown.get(path):
            image = f'<img src="{path}.png" width="{WIDTH}" alt="{escape(page.title)}">'
            return f'<a href="notebooks/{page.name}.ipynb">{image}</a>'
    return ""


def _index(pages: list[NotebookPage], _claims: list[Claim]) -> str:
    """The notebooks by topic; what agrees with the papers stands in one list, the ledger."""
    parts = [
        "# The notebooks\n\nA topic for each paper, a notebook for each result. Run a notebook with "
        "*Run > Run All Cells*, change its cell of parameters, or move the sliders of its explorer. "
        "`python -m workbook claims` lists every published number with ours and the verdict.",
    ]
    for topic, paper in papers().items():
        if mine := [page for page in pages if page.topic == topic]:
            listing = "\n".join(f"- [{page.title}]({page.name}.ipynb)" for page in mine)
            lead = "**The paper claims:** " if paper["by"] else ""
            claimed = f"{lead}{paper['claimed']}\n\n" if paper["claimed"] else ""
            parts.append(f"## {paper['title']} (`{topic}`)\n\n{claimed}{listing}")
    parts.append(f"## Folders\n\n{about()['folders']}")
    cells = [
        # In lines, as Jupyter writes them.
        {"cell_type": "markdown", "id": f"part-{number}", "metadata": {}, "source": text.splitlines(True)}
        for number, text in enumerate(parts, 1)
    ]
    return notebook_text({"cells": cells, "metadata": METADATA, "nbformat": 4, "nbformat_minor": 5})


def _codecheck(pages: list[NotebookPage], _claims: list[Claim]) -> str:
    """The manifest of https://codecheck.org.uk: of each notebook the numbers that it holds against its paper."""
    import yaml

    sources = {topic: paper["paper"] for topic, paper in papers().items()}
    manifest = {
        "version": CODECHECK,
        "paper": {"title": project()["description"], "authors": project()["authors"]},
        "manifest": [
            {"file": f"figures/{page.name}/claims.json", "comment": f"{page.title}. {sources[page.topic]}"}
            for page in pages
            if page.claims
        ],
    }
    return yaml.safe_dump(manifest, explicit_start=True, sort_keys=False, allow_unicode=True, width=1000)


def _conclusions(_pages: list[NotebookPage], claims: list[Claim]) -> str:
    return page_of([(topic, f"{paper['title']}: {paper['by']}") for topic, paper in papers().items()], claims)
