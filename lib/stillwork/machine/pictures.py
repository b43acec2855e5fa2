"""Style of the pictures on the commands' pages."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

from stillwork.base.checks import one_line

# Of Okabe and Ito's palette: distinguished by colour-blind readers, and in grey by lightness.
BLACK, GREY = "#000000", "#7F7F7F"
BLUE, RED, GREEN, ORANGE, PURPLE, SKY = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9"

STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}


@contextmanager
def house_style() -> Iterator[None]:
    """matplotlib's settings of the pages' pictures, for a ``with`` or as a decorator of what draws one."""
    from cycler import cycler
    from matplotlib import style

    colours = cycler(color=(BLUE, RED, GREEN, ORANGE, PURPLE, SKY, BLACK))
    with style.context({**STYLE, "axes.prop_cycle": colours}):
        yield


def new(rows: int, columns: int, height: float | None = None, **options):
    """New figure in the width of a page, `height` in inches: ``figure, axes = new(2, 3)``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, height or 2.4 * rows + 0.5), layout="constrained")
    return figure, figure.subplots(rows, columns, **options)


def legend_below(axes, columns: int) -> None:
    """What one panel's lines mean, below the whole figure."""
    handles = axes.get_legend_handles_labels()
    axes.figure.legend(*handles, loc="outside lower center", ncols=columns)


def literal(text: str) -> str:
    """A text of a file's in a figure, on one line: a $ in it begins no formula, and a legend shows what begins with _."""
    return re.sub(r"^_", " _", one_line(text)).replace("$", r"\$")
