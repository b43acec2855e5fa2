"""Tables and pictures as a page of one file holds them."""

import base64
import html
import io
from pathlib import Path
from string import Template


def page(template: str, **parts: str) -> str:
    """A page of this folder with its parts, in HTML, in place."""
    text = (Path(__file__).parent / template).read_text(encoding="utf-8")
    return Template(text).substitute(parts)


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
