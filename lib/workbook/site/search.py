"""What the site's search looks through: sections of pages, numbers of the ledger and names of the reference."""

import json
import re

from workbook.claims import Claim
from workbook.site.pages import NotebookPage, plain, sections
from workbook.site.reference import Module

HEAD = re.compile(r'<h1\b[^>]*>.*?</h1>|<p class="(?:lead|legend)">.*?</p>', re.DOTALL)


def index(
    pages: list[NotebookPage],
    guides: dict[str, str],
    modules: list[Module],
    claims: list[Claim],
    others: dict[str, bytes],
) -> list[list[str]]:
    """What can be found: title, kind, address from the site's front, and the words.

    Parameters
    ----------
    pages : list of NotebookPage
    guides : dict of str to str
        HTML by name.
    modules : list of Module
    claims : list of Claim
    others : dict of str to bytes
        Other pages of the site by file; their titles and what stands below these are found.
    """
    found = []
    for name, html in others.items():
        title, *words = [plain(each) for each in HEAD.findall(html.decode())]
        found.append([title, "page", f"{name}#content", " ".join(words)])
    for page in pages:
        html = "".join(cell.html for cell in page.cells if not cell.code)
        found += _parts(html, f"notebooks/{page.name}.html", page.title, page.topic)
    for name, html in guides.items():
        found += _parts(html, f"guide/{name}.html", "", "course" if name.startswith("course/") else "guide")
    for module in modules:
        for item in module.items:
            address = f"reference/{module.name}.html#{item.name}"
            kind = "reference" if module.name.startswith("stillwork.") else "code"
            found.append([f"{module.name}.{item.name}", kind, address, item.doc.partition("\n\n")[0]])
    for claim in claims:
        entry = claim.entry
        words = f"{entry.topic} {entry.place} {entry.id} {claim.verdict}"
        found.append([entry.quantity, "ledger", f"ledger.html#row-{entry.id}", words])
    return found


def _parts(html: str, page: str, title: str, kind: str) -> list[list[str]]:
    return [
        [
            f"{title}: {each.heading}" if title and each.level > 1 else each.heading,
            kind,
            f"{page}#{each.id}",
            each.text,
        ]
        for each in sections(html)
    ]


def script(found: list[list[str]]) -> bytes:
    """The index as a script, since a page from the disk may fetch no other file."""
    return f"globalThis.searchIndex = {json.dumps(found, ensure_ascii=False)};\n".encode()
