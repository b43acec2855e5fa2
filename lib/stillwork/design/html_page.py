"""Tables and pictures as a page of one file holds them."""

import base64
import html
import io
from collections.abc import Mapping
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory

from stillwork.base.checks import InputError


def page(template: str, source: str, kind: str = "", **parts: str) -> str:
    """A page about `source`, which its title says to be of a `kind`: a template of this folder with its parts in place."""
    content = _filled(template, parts)
    return _filled("page.html", {"source": source, "kind": kind, "content": content})


def require_new(target: str | Path) -> Path:
    """The path of a file to be written: refused where one stands, or where none can be, before anything is computed."""
    target = Path(target)
    if target.exists():
        raise InputError(f"{target} exists; move it away, or give another --out")
    if not target.parent.is_dir():
        raise InputError(f"{target}: there is no folder {target.parent}; make it, or give another --out")
    require_writable(target.parent)
    return target


def require_writable(folder: Path) -> None:
    """Refuse a folder in which nothing can be written: it, or the nearest above it that is there."""
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not there.is_dir():
        raise InputError(f"{folder} cannot be made: {there} is a file; give another --out")
    try:
        with TemporaryDirectory(dir=there, prefix=".tried-"):
            pass
    except OSError as error:
        raise InputError(
            f"nothing can be written into {there} ({error.strerror}); give another --out"
        ) from None


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
