"""A notebook as a page: its cells with figures, judged numbers and places that other pages link to."""

import base64
import io
import json
import re
import struct
from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cache
from html import unescape
from pathlib import Path

from markupsafe import Markup

from workbook import notebook_source, paths
from workbook.appendix import KIND as APPENDIX
from workbook.checks import InputError
from workbook.claims import HERE, VERDICTS, Claim
from workbook.conclusions import Sentence
from workbook.explorer import AT_START
from workbook.notebooks import Notebook
from workbook.tasks import Task

# What a cell that ends with `page.check` prints; its page shows it with the claim.
PRINTED = tuple(map(repr, HERE))
# Small pictures are for lists of figures: a gallery of them in full size would weigh twenty megabytes.
SMALL = 480  # pixels: two for each of a column's
PICTURE = re.compile(r"!\[([\w.-]+)\]\(\1\.png\)\n?")
FILE_NAMES = re.compile(r"^([\w.-]+)\.png, \1\.csv\n?", re.MULTILINE)
HEADING = re.compile(r'<h([1-6])\b[^>]*?\bid="([^"]*)"[^>]*>(.*?)</h\1>', re.DOTALL)
ANCHOR = re.compile(r'<a class="anchor-link".*?</a>', re.DOTALL)


@dataclass(frozen=True)
class Figure:
    """A picture on a page, with the numbers that were plotted where it has them.

    Attributes
    ----------
    notebook, name : str
        Together the path of its files below ``figures/``, without suffix.
    heading : str
        The section it stands in.
    png : bytes
        The picture.
    csv : bytes or None
        None for an explorer's static picture.
    """

    notebook: str
    name: str
    heading: str
    png: bytes
    csv: bytes | None

    @property
    def path(self) -> str:
        return f"figures/{self.notebook}/{self.name}"

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels, from the PNG's header."""
        return struct.unpack(">II", self.png[16:24])

    @property
    def small(self) -> tuple[bytes, int, int]:
        """The picture for lists, with its width and height."""
        return thumbnail(self.png)

    @property
    def thumbnail(self) -> str:
        """Path of the small picture."""
        return f"thumbnails/{self.notebook}/{self.name}.webp"


@dataclass(frozen=True)
class PageCell:
    """One cell; `claims` are those that it judges."""

    notebook: str
    id: str
    code: bool
    source: str
    outputs: tuple[str | Sentence, ...] = ()
    figures: tuple[Figure, ...] = ()
    claims: tuple[Claim, ...] = ()
    table: bool = False  # prints the table of all claims, which a page shows as one of its own
    apart: bool = False  # of the appendix

    @property
    def html(self) -> Markup:
        """For a site's page; who derives a README or a manifest from a page does not wait for it."""
        if self.code:
            return _highlighted(self.source)
        text = _prose(self.notebook, self.source)
        if self.apart:  # its headings may be those of the page
            text = re.sub(r'(<h[1-6]\b[^>]*?\bid="|href="#)', r"\1appendix-", text)
        return Markup(text)

    @property
    def shown(self) -> list[str]:
        """What it printed; a sentence as HTML."""
        return [
            Markup(_prose(self.notebook, each.text)) if isinstance(each, Sentence) else each
            for each in self.outputs
        ]


@dataclass(frozen=True)
class Section:
    """A part of a page: its heading, and the place and the words below it."""

    level: int
    id: str
    heading: str
    text: str


@dataclass(frozen=True)
class NotebookPage:
    """Everything that the page of a notebook shows."""

    notebook: Notebook
    title: str
    cells: tuple[PageCell, ...]
    claims: tuple[Claim, ...]
    parameters: tuple[tuple[str, str, str, str], ...]  # name, type, published value, comment
    functions: tuple[str, ...]
    provenance: dict = field(default_factory=dict)

    @property
    def name(self) -> str:
        return self.notebook.name

    @property
    def figures(self) -> list[Figure]:
        return [figure for cell in self.cells for figure in cell.figures]

    @property
    def topic(self) -> str:
        return self.notebook.topic

    @property
    def command(self) -> str:
        """Rebuilds every figure of the notebook."""
        return f'make figures ARGS="{self.name} --force"'

    @property
    def contents(self) -> list[Section]:
        """The parts that a reader may go to."""
        return [
            part for cell in self.cells if not cell.code for part in sections(cell.html) if part.level == 2
        ]

    @property
    def answered(self) -> int:
        """The first cell of text after the first picture: what stands above it is the answer."""
        first = next((number for number, cell in enumerate(self.cells) if cell.figures), 0)
        text = (number for number, cell in enumerate(self.cells) if not cell.code and not cell.apart)
        return next((number for number in text if number > first), min(1, len(self.cells) - 1))

    @property
    def summary(self) -> str:
        """The first paragraph, for who lists or shares the page."""
        paragraphs = (
            re.findall(r"<p>(.*?)</p>", cell.html, re.DOTALL) for cell in self.cells if not cell.code
        )
        return next((plain(each) for found in paragraphs for each in found), self.title)

    def verdicts_of(self, figure: Figure) -> dict[str, int]:
        """How many of the numbers that a figure is about have which verdict."""
        found = Counter(claim.verdict for claim in self.claims if self.figure_of(claim) == figure)
        return {verdict: found[verdict] for verdict in VERDICTS if found[verdict]}

    def figure_of(self, claim: Claim) -> Figure | None:
        """The figure that a claim is about: the one its id names, else the last one before its place."""
        named = [f for f in self.figures if f.csv and f.name == claim.entry.id.split(".")[1]]
        before = []
        for cell in self.cells:
            before += [figure for figure in cell.figures if figure.csv]
            if claim in cell.claims:
                break
        return next(iter([*named, *reversed(before)]), None)


def read_page(task: Task, claims: list[Claim], start: bytes = b"") -> NotebookPage:
    """The page of a notebook: its last build where that is fresh, else what is committed.

    Parameters
    ----------
    task : Task
        The notebook at its published settings.
    claims : list of Claim
        The whole ledger.
    start : bytes
        Picture (PNG) of its explorer at the start, which a committed notebook does not hold.
    """
    notebook = task.notebook
    fresh = not task.reasons()
    raw = json.loads(notebook.source)["cells"]
    if fresh:  # of the build its outputs only: texts may have changed since
        raw = with_outputs(raw, task.outputs())
    folder = paths.root() / "figures" / notebook.name
    mine = [claim for claim in claims if claim.notebook == notebook.name]
    cells = _cells(notebook.name, raw, folder, mine, start)
    comments = notebook_source.comments(notebook)
    record = folder / "provenance.json"
    return NotebookPage(
        notebook,
        _title(raw, notebook.name),
        _with_the_rest(cells, raw, mine),
        tuple(mine),
        tuple(
            (name, each.annotation, repr(each.value), comments[name])
            for name, each in notebook.parameters.items()
        ),
        tuple(notebook_source.used([_text(cell) for cell in raw if cell["cell_type"] == "code"])),
        json.loads(record.read_text(encoding="utf-8")) if record.is_file() else {},
    )


def with_outputs(cells: list[dict], gave: dict[str, list[dict]]) -> list[dict]:
    """The cells with what the code cells of the same id gave when they were executed."""
    return [
        {**cell, "outputs": gave.get(cell.get("id"), cell["outputs"])}
        if cell["cell_type"] == "code"
        else cell
        for cell in cells
    ]


def _cells(name: str, raw: list[dict], folder: Path, claims: list[Claim], start: bytes) -> list[PageCell]:
    gave = [output.get("data", {}) for cell in raw for output in cell.get("outputs", [])]
    elsewhere = {each[1] for data in gave for each in PICTURE.finditer("".join(data.get(APPENDIX, "")))}
    pictures = sorted({file.stem for file in folder.glob("[!.]*.png")} - elsewhere)
    by_id = {claim.entry.id: claim for claim in claims}
    drawn: set[str] = set()
    judged: set[str] = set()
    heading, cells = _title(raw, name), []
    for number, cell in enumerate(raw):
        source, anchor = _text(cell), f"cell-{cell.get('id', number)}"
        if cell["cell_type"] == "markdown":
            heading = next(iter(re.findall(r"^#+ (.+)$", source, re.MULTILINE)), heading)
            cells.append(PageCell(name, anchor, False, source))
        elif cell["cell_type"] == "code":
            here = [each for each in notebook_source.figures_saved(source, pictures) if each not in drawn]
            ids = [each for each in notebook_source.claims_checked(source, list(by_id)) if each not in judged]
            drawn |= set(here)
            judged |= set(ids)
            figures = [_saved_figure(name, each, heading, folder) for each in here]
            outputs, apart = [], []
            table = source.strip() == "page.claims"
            for output in cell.get("outputs", []):
                text, png = _shown(output)
                if AT_START in text:
                    png = png or start
                data = output.get("data", {})
                if APPENDIX in data:
                    apart = _appendix(name, anchor, "".join(data[APPENDIX]), folder)
                elif said := "".join(data.get("text/markdown", "")):
                    outputs.append(Sentence(said))
                elif png and not FILE_NAMES.match(text):
                    figures.append(Figure(name, f"{cell['id']}-static", heading, png, None))
                elif (left := FILE_NAMES.sub("", text).strip("\n")) and left not in PRINTED and not table:
                    outputs.append(left)
            judgements = tuple(by_id[each] for each in ids)
            cells.append(
                PageCell(name, anchor, True, source, tuple(outputs), tuple(figures), judgements, table)
            )
            cells += apart
    return cells


def _appendix(name: str, anchor: str, markdown: str, folder: Path) -> list[PageCell]:
    """An appendix as cells of text, each with the picture that follows it."""
    cells = []
    for number, part in enumerate(re.split(r"(?<=\.png\))\n", markdown)):
        text, picture = PICTURE.sub("", part), PICTURE.search(part)
        heading = next(iter(re.findall(r"^#+ (.+)$", text, re.MULTILINE)), "Appendix")
        figures = [_saved_figure(name, picture[1], heading, folder)] if picture else []
        place = f"{anchor}-{number}"
        cells.append(PageCell(name, place, False, text, figures=tuple(figures), apart=True))
    return cells


@cache
def _highlighted(source: str) -> Markup:
    from nbconvert.filters.highlight import Highlight2HTML

    return Markup(Highlight2HTML(pygments_lexer="python")(source))


def _prose(name: str, source: str) -> str:
    from workbook.site.mathematics import markdown

    try:
        return markdown(source)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _with_the_rest(cells: list[PageCell], raw: list[dict], claims: list[Claim]) -> tuple[PageCell, ...]:
    """`cells`, with the claims that no cell names in the one that prints the table of all."""
    left = tuple(claim for claim in claims if not any(claim in cell.claims for cell in cells))
    tables = [number for number, cell in enumerate(raw) if _text(cell).strip() == "page.claims"]
    if left and cells:
        at = tables[-1] if tables else len(cells) - 1
        at = next(
            (k for k in reversed(range(len(cells))) if cells[k].apart), at
        )  # the appendix computes the rest
        cells[at] = replace(cells[at], claims=cells[at].claims + left)
    return tuple(cells)


def _saved_figure(notebook: str, name: str, heading: str, folder: Path) -> Figure:
    table = folder / f"{name}.csv"
    csv = table.read_bytes() if table.is_file() else None
    return Figure(notebook, name, heading, (folder / f"{name}.png").read_bytes(), csv)


def _shown(output: dict) -> tuple[str, bytes]:
    """Text and picture of an output."""
    if output["output_type"] == "stream":
        return "".join(output["text"]), b""
    data = output.get("data", {})
    return "".join(data.get("text/plain", "")), base64.b64decode(data.get("image/png", ""))


def _text(cell: dict) -> str:
    return "".join(cell["source"])


def _title(raw: list[dict], default: str) -> str:
    first = _text(raw[0]) if raw else ""
    return next(iter(re.findall(r"^# (.+)$", first, re.MULTILINE)), default)


@cache
def thumbnail(png: bytes) -> tuple[bytes, int, int]:
    """A picture of `SMALL` as WebP, with its width and height; a smaller one keeps its size.

    Parameters
    ----------
    png : bytes
        Of the whole picture.
    """
    from PIL import Image

    picture = Image.open(io.BytesIO(png)).convert("RGB")
    if picture.width > SMALL:
        height = round(picture.height * SMALL / picture.width)
        picture = picture.resize((SMALL, height), Image.Resampling.LANCZOS)
    small = io.BytesIO()
    picture.save(small, "WEBP", quality=75, method=4)
    return small.getvalue(), *picture.size


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
