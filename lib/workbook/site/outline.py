"""The parts of a page: its headings, their places, and the words below each."""

import re
from dataclasses import dataclass
from html import unescape

HEADING = re.compile(r'<h([1-6])\b[^>]*?\bid="([^"]*)"[^>]*>(.*?)</h\1>', re.DOTALL)
ANCHOR = re.compile(r'<a class="anchor-link".*?</a>', re.DOTALL)


@dataclass(frozen=True)
class Section:
    """A part of a page: its heading, and the place and the words below it."""

    level: int
    id: str
    heading: str
    text: str


def sections(html: str) -> list[Section]:
    """The parts of a text that begin with a heading; what stands before the first has none."""
    found = [
        (int(each[1]), each[2], plain(each[3]), each.end(), each.start()) for each in HEADING.finditer(html)
    ]
    ends = [*(each[4] for each in found), len(html)][1:]
    return [
        Section(level, place, heading, plain(html[begin:end]))
        for (level, place, heading, begin, _), end in zip(found, ends, strict=True)
    ]


def plain(html: str) -> str:
    """The words of some HTML."""
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", ANCHOR.sub("", html))).split())
