"""House style of the figures, and saving: every picture goes with the numbers that were plotted."""

import csv
import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workbook.checks import InputError

# Pictures know their colours as `figures.BLUE`.
from workbook.palette import (  # noqa: F401
    BLACK,
    BLUE,
    COLOURS,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RED,
    SKY,
    STYLE,
    YELLOW,
)

HEADER = ("panel", "series", "x", "y", "z")  # of a table of plotted numbers
WIDTH = 7.2  # inches, every figure: they stand below one another on a page
MOST_PIXELS = 1000  # of a saved picture's width


@contextmanager
def house_style() -> Iterator[None]:
    """matplotlib's settings of the workbook's figures, for a ``with`` or as a decorator of what draws one.

    In a notebook `workbook.page.Page` sets them for the whole kernel.
    """
    from matplotlib import style

    with style.context(_style()):
        yield


def use_house_style() -> None:
    """Set matplotlib's settings of the workbook's figures from here on."""
    from matplotlib import style

    style.use(_style())


def _style() -> dict:
    from matplotlib import cycler

    return {**STYLE, "axes.prop_cycle": cycler(color=COLOURS)}


def literal(text: str) -> str:
    """A text of a file's in a figure: a $ in it begins no formula."""
    return text.replace("$", r"\$")


def new(rows: int = 1, columns: int = 1, height: float | None = None, **options):
    """New figure in the width of a page: ``figure, axes = new(2, 3)``.

    Parameters
    ----------
    rows, columns : int
        Grid of axes.
    height : float, optional
        Inches; by default 2.4 per row plus space for the labels.
    **options
        Passed to `matplotlib.figure.Figure.subplots` (``sharex``, ``squeeze``, ``gridspec_kw``, ...).
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH, height or 2.4 * rows + 0.5), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def mark_published(axes, x, y, label: str = "published", **options):
    """Draw published values with the one marker that means so in every figure: an open black diamond."""
    style = {
        "marker": "D",
        "markersize": 5,
        "linestyle": "none",
        "color": BLACK,
        "markerfacecolor": "none",
    }
    return axes.plot(np.atleast_1d(x), np.atleast_1d(y), label=label, zorder=5, **{**style, **options})


def label(axes, x: str = "", y: str = "") -> None:
    """Name what panels share: `x` below the lowest ones, `y` beside the first of each row."""
    for each in np.ravel(axes):
        place = each.get_subplotspec()
        if x and place.is_last_row():
            each.set_xlabel(x)
        if y and place.is_first_col():
            each.set_ylabel(y)


def legend_below(axes, columns: int, **options) -> None:
    """What one panel's lines mean, below the whole figure."""
    handles = axes.get_legend_handles_labels()
    axes.figure.legend(*handles, loc="outside lower center", ncols=columns, **options)


@dataclass(frozen=True)
class SavedFigure:
    """A saved figure; Jupyter shows the picture, text shows the names of the files."""

    path: Path  # without suffix
    png: bytes

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"{self.path.name}.png, {self.path.name}.csv"


def save(figure, path: Path) -> SavedFigure:
    """Write a figure as ``path.png`` and its plotted numbers as ``path.csv``.

    The picture has at most 256 colours and 1,000 pixels across. Two calls with the same data write the same bytes.
    `read_table` reads the numbers.

    Raises
    ------
    InputError
        When an axis that shows data has no label: a reader would have to guess the unit; or when a formula in the
        figure cannot be set.
    """
    table = _table(plotted(figure))
    picture = _png(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.with_name(path.name + ".png").write_bytes(picture)
    path.with_name(path.name + ".csv").write_text(table, encoding="utf-8")
    return SavedFigure(path, picture)


def _png(figure) -> bytes:
    """A figure as PNG with a palette, the same bytes each time: no date and no program's name in it."""
    from PIL import Image

    width, _ = figure.get_size_inches()
    dpi = min(STYLE["savefig.dpi"], MOST_PIXELS / width)
    drawn, written = io.BytesIO(), io.BytesIO()
    try:
        figure.savefig(drawn, format="png", dpi=dpi)
    except ValueError as error:
        raise InputError(
            f"figure cannot be drawn ({' '.join(str(error).split())}); correct its formula, or write \\$ for a dollar"
        ) from None
    # Of Pillow's ways this keeps areas to one level of 255; edges of lines over a map may be off by some 40.
    colours = Image.open(drawn).convert("RGB")
    colours = colours.quantize(256, Image.Quantize.MEDIANCUT, kmeans=1, dither=Image.Dither.NONE)
    colours.save(written, format="png", dpi=(dpi, dpi))
    return written.getvalue()


def _table(rows: list[tuple]) -> str:
    """The rows as CSV, a panel's and a series' name in the first row of its block alone."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(HEADER)
    above = (None, None)
    for panel, series, *numbers in rows:
        if not panel or not series:
            raise InputError(
                f"panel {panel!r} or series {series!r} has no name and reads as the one above; label it"
            )
        writer.writerow(
            (panel if panel != above[0] else "", series if (panel, series) != above else "", *numbers)
        )
        above = panel, series
    return text.getvalue()


def read_table(path: Path) -> dict[tuple[str, str], np.ndarray]:
    """The plotted numbers that `save` wrote, by panel and series in the order of the file.

    Parameters
    ----------
    path : Path
        A CSV file.

    Returns
    -------
    dict
        Of arrays of shape (points, 3): x, y and z, which is NaN but in maps.

    Raises
    ------
    InputError
        When the file is not such a table.
    """
    with Path(path).open(newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file))
    if not lines or tuple(lines[0]) != HEADER:
        raise InputError(
            f"path is {str(path)!r}, whose first line is not {','.join(HEADER)!r}; give a figure's table"
        )
    blocks = {}
    panel = series = ""
    for number, line in enumerate(lines[1:], 2):
        try:
            panel, series = line[0] or panel, line[1] or series
            x, y, z = (float(value or "nan") for value in line[2:])
        except (IndexError, ValueError):
            raise InputError(
                f"path is {str(path)!r}, whose line {number} is no row of panel, series, x, y, z; give a figure's table"
            ) from None
        blocks.setdefault((panel, series), []).append([x, y, z])
    return {name: np.array(block) for name, block in blocks.items()}


def plotted(figure) -> list[tuple[str, str, str, str, str]]:
    """Numbers that a figure shows: rows of panel, series, x, y and (maps only) z, to 7 digits."""
    rows = []
    for number, axes in enumerate(figure.axes, 1):
        if axes.get_label() == "<colorbar>":
            continue
        if axes.axison and axes.has_data() and not (axes.get_xlabel() or axes.get_ylabel()):
            shared = axes.get_shared_x_axes().get_siblings(axes) + axes.get_shared_y_axes().get_siblings(axes)
            if not any(other.get_xlabel() or other.get_ylabel() for other in shared):
                raise InputError(f"panel {number} has no axis labels; name the quantities with their units")
        panel = axes.get_title(loc="left") or axes.get_title() or f"panel {number}"
        rows += [(panel, *row) for row in _lines(axes) + _collections(axes) + _images(axes)]
        rows += [(panel, *row) for row in _bars(axes)]
    return rows


def _lines(axes) -> list[tuple]:
    rows = []
    for number, line in enumerate(axes.lines, 1):
        if line.get_transform() == axes.transData:  # not axhline and the like
            x, y = line.get_xdata(orig=False), line.get_ydata(orig=False)
            rows += _numbers(_name(axes, line, f"line {number}"), x, y)
    return rows


def _collections(axes) -> list[tuple]:
    rows = []
    for number, collection in enumerate(axes.collections, 1):
        kind = type(collection).__name__
        name = _name(axes, collection, f"{kind} {number}")
        if kind == "QuadMesh":
            corners = np.asarray(collection.get_coordinates())
            middle = (corners[:-1, :-1] + corners[1:, 1:]) / 2
            rows += _numbers(name, middle[..., 0], middle[..., 1], collection.get_array())
        elif kind == "QuadContourSet":
            for path, level in zip(collection.get_paths(), collection.levels, strict=False):
                x, y = path.vertices.T
                rows += _numbers(name, x, y, np.full(len(x), level))
        elif kind == "PathCollection":
            rows += _numbers(name, *np.ma.filled(collection.get_offsets(), np.nan).T)
        elif kind in ("PolyCollection", "FillBetweenPolyCollection", "LineCollection"):
            for path in collection.get_paths():
                rows += _numbers(name, *path.vertices.T)
    return rows


def _images(axes) -> list[tuple]:
    rows = []
    for number, image in enumerate(axes.images, 1):
        values = np.ma.filled(np.ma.asarray(image.get_array(), dtype=float), np.nan)
        if values.ndim == 2:
            left, right, bottom, top = image.get_extent()
            x = left + (np.arange(values.shape[1]) + 0.5) * (right - left) / values.shape[1]
            y = top + (np.arange(values.shape[0]) + 0.5) * (bottom - top) / values.shape[0]
            if image.origin == "lower":
                y = y[::-1]
            rows += _numbers(_name(axes, image, f"image {number}"), *np.meshgrid(x, y), values)
    return rows


def _bars(axes) -> list[tuple]:
    rows = []
    for number, bars in enumerate(axes.containers, 1):
        patches = getattr(bars, "patches", ())
        middle = [(p.get_x() + p.get_width() / 2, p.get_y() + p.get_height() / 2) for p in patches]
        end = [(p.get_x() + p.get_width(), p.get_y() + p.get_height()) for p in patches]
        if patches:
            name = _name(axes, bars, f"bars {number}")
            x, y = (end, middle) if bars.orientation == "horizontal" else (middle, end)
            rows += _numbers(name, [x for x, _ in x], [y for _, y in y])
    return rows


def _name(axes, artist, default: str) -> str:
    """The artist's label, or that of the group (error bars, stems) that it is part of."""
    groups = [group for group in axes.containers if artist in group.get_children()]
    labels = [str(one.get_label() or "") for one in (artist, *groups)]
    return next((label for label in labels if label and not label.startswith("_")), default)


def _numbers(name: str, x, y, z=None) -> list[tuple]:
    columns = [np.ravel(np.ma.filled(np.ma.asarray(c, dtype=float), np.nan)) for c in (x, y)]
    if z is None:
        return [(name, f"{a:.7g}", f"{b:.7g}", "") for a, b in zip(*columns, strict=True)]
    depth = np.ravel(np.ma.filled(np.ma.asarray(z, dtype=float), np.nan))
    return [(name, f"{a:.7g}", f"{b:.7g}", f"{c:.7g}") for a, b, c in zip(*columns, depth, strict=True)]
