"""Tables and pictures as a page of one file holds them."""

import base64
import html
import io
from collections.abc import Mapping
from pathlib import Path
from string import Template


def page(template: str, source: str, kind: str = "", **parts: str) -> str:
    """A page about `source`, which its title says to be of a `kind`: a template of this folder with its parts in place."""
    content = _filled(template, parts)
    return _filled("page.html", {"source": source, "kind": kind, "content": content})


def _filled(template: str, parts: Mapping[str, str]) -> str:
    return Template((Path(__file__).parent / template).read_text(encoding="utf-8")).substitute(parts)


def picture(figure, words: str) -> str:
    """A figure as the page holds it, and what it is in words."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<p><img src="data:image/png;base64,{data}" alt="{words}"></p>'


def table(head: list[str], rows: list[list[str]]) -> str:
    """Rows of text below a head, which may be empty."""
    lines = [("th", head)] if head else []
    lines += [("td", row) for row in rows]
    cells = ("".join(f"<{tag}>{html.escape(each)}</{tag}>" for each in row) for tag, row in lines)
    return "<table>" + "".join(f"<tr>{row}</tr>\n" for row in cells) + "</table>"
