"""Tables and pictures as a page of one file holds them."""

import base64
import html
import io


def picture(figure) -> str:
    """A figure as the page holds it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return base64.b64encode(buffer.getvalue()).decode()


def table(head: list[str], rows: list[list[str]]) -> str:
    """Rows of text below a head, which may be empty."""
    lines = [("th", head)] if head else []
    lines += [("td", row) for row in rows]
    cells = ("".join(f"<{tag}>{html.escape(each)}</{tag}>" for each in row) for tag, row in lines)
    return "<table>" + "".join(f"<tr>{row}</tr>\n" for row in cells) + "</table>"
