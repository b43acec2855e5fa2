"""Fig. 4 of the paper: the loop whose signals the pages name."""

from itertools import pairwise

from workbook import figures

BOX = {"boxstyle": "square,pad=0.45", "facecolor": "white", "edgecolor": figures.BLACK, "linewidth": 1}
ROUND = {**BOX, "boxstyle": "circle,pad=0.15"}


def paint_diagram():
    """Block diagram of the self-tuned feedforward; red: what the adaptation adds."""
    figure, axes = figures.new(1, 1, height=2.3)
    axes.set(xlim=(-0.2, 10.4), ylim=(-1.5, 1.6))
    axes.set_axis_off()
    _box(axes, 4.6, 1.0, "$P_1$\nprimary path")
    _box(axes, 2.9, -0.5, "$C_0 = W\\,\\psi$\nfeedforward")
    _box(axes, 5.2, -0.5, "$P_2$\nsecondary path")
    _box(axes, 8.9, -0.9, "$N\\hat P_2^{-1}$", figures.RED)
    for x, y in ((1.3, -0.5), (6.9, 0.3), (7.9, 0.3)):
        axes.text(x, y, "+", ha="center", va="center", fontsize=8, bbox=ROUND, zorder=3)
    black = (
        ("", (0.0, 1.0), (4.0, 1.0)),
        ("", (0.5, 1.0), (0.5, -0.5), (1.2, -0.5)),
        ("", (1.3, -0.5), (2.34, -0.5)),
        ("$u$", (3.05, -0.5), (4.48, -0.5)),
        ("$y_1$", (4.6, 1.0), (6.9, 1.0), (6.9, 0.44)),
        ("$y_2$", (5.5, -0.5), (6.9, -0.5), (6.9, 0.16)),
        ("$a_1$", (6.9, 0.3), (7.8, 0.3)),
        ("", (7.9, 0.3), (10.2, 0.3)),
        ("", (1.3, -1.3), (1.3, -0.64)),
        ("", (7.9, 1.2), (7.9, 0.44)),
    )
    for name, *corners in black:
        _arrow(axes, corners, name)
    _arrow(axes, [(8.9, 0.3), (8.9, -0.68)], "", figures.RED)
    _arrow(axes, [(8.9, -0.9), (7.4, -0.9), (7.4, -1.4), (2.9, -1.4), (2.9, -0.77)], "", figures.RED)
    for x, y, text, color in (
        (0.0, 1.15, "floor $a_0$", figures.BLACK),
        (1.4, -1.2, "noise $n_0$", figures.BLACK),
        (8.0, 1.1, "noise $n_1$", figures.BLACK),
        (9.2, 0.42, "measured", figures.BLACK),
        (4.4, -1.33, "filtered error $e$ adapts $W$", figures.RED),
    ):
        axes.text(x, y, text, fontsize=8, color=color, va="bottom")
    return figure


def _box(axes, x: float, y: float, text: str, color: str = figures.BLACK) -> None:
    look = {**BOX, "edgecolor": color}
    axes.text(x, y, text, ha="center", va="center", fontsize=8, color=color, bbox=look, zorder=3)


def _arrow(axes, corners: list[tuple[float, float]], name: str, color: str = figures.BLACK) -> None:
    """Line through corners that ends in an arrow, with the signal's name above its first part."""
    for start, end in pairwise(corners):
        style = {"arrowstyle": "-|>" if end == corners[-1] else "-", "color": color, "lw": 1}
        axes.annotate("", end, start, arrowprops={**style, "shrinkA": 0, "shrinkB": 0}, zorder=1)
    (x, y), (x_end, _) = corners[:2]
    axes.text((x + x_end) / 2, y + 0.08, name, ha="center", va="bottom", fontsize=8, color=color)
