"""What the site's search looks through: sections of pages, numbers of the ledger and names of the reference."""

import json

from workbook.claims import Claim
from workbook.site.pages import NotebookPage, sections
from workbook.site.reference import Module


def index(
    pages: list[NotebookPage], guides: dict[str, str], modules: list[Module], claims: list[Claim]
) -> list[list[str]]:
    """What can be found: title, kind, address from the site's front, and the words.

    Parameters
    ----------
    pages : list of NotebookPage
    guides : dict of str to str
        HTML by name.
    modules : list of Module
    claims : list of Claim
    """
    found = []
    for page in pages:
        html = "".join(cell.html for cell in page.cells if not cell.code)
        found += _parts(html, f"notebooks/{page.name}.html", page.title, page.topic)
    for name, html in guides.items():
        found += _parts(html, f"guide/{name}.html", "", "course" if name.startswith("course/") else "guide")
    for module in modules:
        for item in module.items:
            address = f"reference/{module.name}.html#{item.name}"
            found.append([f"{module.name}.{item.name}", "reference", address, item.doc.partition("\n\n")[0]])
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
