"""A plain check of a site's files: every link, picture, style and script leads to a file and a place in it."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from html import unescape
from pathlib import Path
from urllib.parse import unquote, urlsplit

TAG = re.compile(r"<(\w+)\b([^<>]*)>")
ATTRIBUTE = re.compile(r'(?<![\w-])(href|src|id|name)="([^"]*)"')


@dataclass(frozen=True)
class _Page:
    """Links, each with its tag and attribute, and places of a page whose attributes stand in double quotes."""

    links: list[tuple[str, str]]
    places: set[str]


def _read(html: str) -> _Page:
    found = [
        (tag, name, unescape(value))
        for tag, rest in TAG.findall(html)
        for name, value in ATTRIBUTE.findall(rest)
    ]
    links = [(f"{tag} {name}", value) for tag, name, value in found if name in ("href", "src")]
    return _Page(links, {value for _, name, value in found if name in ("id", "name")})


def broken_links(site: Path) -> list[str]:
    """One line for each link that leads nowhere, and for each picture, style or script from outside the site."""
    pages = {file: _read(file.read_text(encoding="utf-8")) for file in sorted(site.rglob("*.html"))}
    inside = site.resolve()

    @cache  # of the thousands that the pages' navigation repeats
    def file_at(folder: Path, path: str) -> Path | None:
        target = (folder / unquote(path)).resolve()
        return target if target.is_relative_to(inside) and target.is_file() else None

    wrong = []
    for file, page in pages.items():
        for where, address in page.links:
            if reason := _fault(file, where, address, pages, file_at):
                wrong.append(f"{file.relative_to(site)}: {where} {address!r}: {reason}")
    return wrong


def _fault(file: Path, where: str, address: str, pages: dict[Path, _Page], file_at: Callable) -> str:
    parts = urlsplit(address)
    if parts.scheme or parts.netloc:
        plain = where == "a href" and parts.scheme in ("http", "https", "mailto")
        return "" if plain else "leaves the site"
    target = file_at(file.parent, parts.path) if parts.path else file
    if target is None:
        return "no such file"
    if not parts.fragment or target.suffix != ".html":
        return ""
    # As a browser does: the fragment as it stands, then decoded.
    found = {parts.fragment, unquote(parts.fragment)} & pages[target].places
    return "" if found else "no such place"
