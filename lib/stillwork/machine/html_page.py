"""Tables and pictures of a page that is one file."""

import base64
import html
import io
from collections.abc import Mapping
from pathlib import Path
from string import Template
from tempfile import TemporaryDirectory

from stillwork.base.checks import InputError


def page(template: str, source: str, kind: str = "", **parts: str) -> str:
    """A page about `source`, its title with the `kind`: a template of this folder with its parts filled in."""
    content = _filled(template, parts)
    return _filled("page.html", {"source": source, "kind": kind, "content": content})


def require_new(target: str | Path) -> Path:
    """The path of a file to be written: refused if it exists or cannot be written, before anything is computed."""
    target = Path(target)
    if target.exists():
        raise InputError(f"{target} exists; move it away, or give another --out")
    if not target.parent.is_dir():
        raise InputError(f"{target}: folder {target.parent} does not exist; make it, or give another --out")
    require_writable(target.parent)
    return target


def require_writable(folder: Path) -> None:
    """Refuse a folder that cannot be written to: it, or the nearest existing one above it."""
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    if not there.is_dir():
        raise InputError(f"{folder} cannot be created: {there} is a file; give another --out")
    try:
        with TemporaryDirectory(dir=there, prefix=".tried-"):
            pass
    except OSError as error:
        raise InputError(f"{there} cannot be written to ({error.strerror}); give another --out") from None


def _filled(template: str, parts: Mapping[str, str]) -> str:
    return Template((Path(__file__).parent / template).read_text(encoding="utf-8")).substitute(parts)


def picture(figure, words: str) -> str:
    """A figure embedded in the page, with `words` as its text alternative."""
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
