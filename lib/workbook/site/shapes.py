"""What a figure shows, as numbers that a page's script can draw: every line and area in units of its panel."""

import numpy as np

WIDTH, HEIGHT = (
    1800,
    800,
)  # units of a figure's width and of a panel's height: twice the pixels of a wide page
MARKERS = {"o": "o", ".": "o", "D": "D", "d": "D", "s": "s", "^": "^", "v": "v", "x": "x", "+": "+", "*": "o"}
DASHES = {"-": "", "--": "6 3", ":": "1.5 2.5", "-.": "7 3 1.5 3"}
PIXELS = 96  # an inch


def panels(figure) -> list[dict]:
    """The panels of a figure.

    Returns
    -------
    list of dict
        ``place`` (row and column), ``height`` in pixels, ``title``, ``x`` and ``y`` (label, limits, ticks), ``units``
        (how many it is wide and high), ``ratio`` (height over width where that is the figure's, else None), ``items``
        (lines, areas and words, from the back to the front) and ``legend`` (its title and names, or None).
    """
    shown = [axes for axes in figure.axes if axes.get_visible() and axes.get_label() != "<colorbar>"]
    found = []
    for axes in shown:
        axes.apply_aspect()
        legend = axes.get_legend() or next(iter(figure.legends if axes is shown[0] else []), None)
        found.append(
            {
                **_place(axes),
                "units": [_width(axes), HEIGHT],
                "title": axes.get_title(loc="left") or axes.get_title(),
                "x": _axis(axes, "x"),
                "y": _axis(axes, "y"),
                "ratio": _short(axes.get_data_ratio()) if axes.get_aspect() == 1.0 else None,
                "items": [item for artist in _artists(axes) for item in _items(axes, _width(axes), artist)],
                "legend": legend
                and [legend.get_title().get_text(), *(each.get_text() for each in legend.get_texts())],
            }
        )
    return found


def _place(axes) -> dict:
    height = axes.figure.get_size_inches()[1] * PIXELS
    if (spot := axes.get_subplotspec()) is None:
        return {"place": [0, 0], "height": round(height)}
    share = len(spot.rowspan) / spot.get_gridspec().nrows
    return {"place": [spot.rowspan.start, spot.colspan.start], "height": round(height * share)}


def _width(axes) -> int:
    """Units that a panel is wide."""
    spot = axes.get_subplotspec()
    return WIDTH // (spot.get_gridspec().ncols if spot else 1)


def _axis(axes, letter: str) -> dict:
    """Label, limits (decades for a logarithmic one), and the ticks where the figure itself names them."""
    from matplotlib.ticker import FixedLocator, NullLocator

    axis = getattr(axes, f"{letter}axis")
    siblings = getattr(axes, f"get_shared_{letter}_axes")().get_siblings(axes)
    labels = [
        each.label.get_text() for each in (axis, *(getattr(one, axis.axis_name + "axis") for one in siblings))
    ]
    logarithmic = axis.get_scale() == "log"
    scale = np.log10 if logarithmic else np.float64
    ticks = None
    if isinstance(axis.get_major_locator(), FixedLocator | NullLocator):
        places = axis.get_majorticklocs()
        words = axis.get_major_formatter().format_ticks(places)
        ticks = [[_short(at), str(word)] for at, word in zip(scale(places), words, strict=True)]
    return {
        "label": next(filter(None, labels), ""),
        "log": logarithmic,
        "limits": [_short(each) for each in scale(axis.get_view_interval())],
        "ticks": ticks,
    }


def _artists(axes) -> list:
    """Lines, areas and words in the order in which they are drawn."""
    drawn = [*axes.patches, *axes.collections, *axes.lines, *axes.texts]
    return sorted(
        (artist for artist in drawn if artist.get_visible()), key=lambda artist: artist.get_zorder()
    )


def _items(axes, width: int, artist) -> list[dict]:
    from matplotlib.collections import Collection
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

    if isinstance(artist, Text):
        return _words(axes, width, artist)
    label = str(artist.get_label() or "")
    name = {} if label.startswith("_") else {"label": label}
    if isinstance(artist, Line2D):
        return [{**name, **_line(axes, width, artist)}]
    if isinstance(artist, Collection):
        return [
            {**(name if number == 0 else {}), **each}
            for number, each in enumerate(_collected(axes, width, artist))
        ]
    to_panel = artist.get_transform() - axes.transAxes
    paint = {"fill": _colour(artist.get_facecolor())} if artist.get_fill() else {}
    return [{**name, **paint, "path": _path(artist.get_path(), to_panel, width, exact=True)}]


def _line(axes, width: int, line) -> dict:
    to_panel = line.get_transform() - axes.transAxes
    found = {}
    if (dash := DASHES.get(line.get_linestyle())) is not None:
        found["stroke"] = _colour(line.get_color())
        found["width"] = _short(line.get_linewidth() * PIXELS / 72)
        if dash:
            found["dash"] = dash
    marker = MARKERS.get(line.get_marker())
    if marker:
        fill = line.get_markerfacecolor()
        size = _short(line.get_markersize() * PIXELS / 72)
        found["mark"] = [marker, size, _colour(line.get_markeredgecolor()), _colour(fill)]
    return {**found, "path": _path(line.get_path(), to_panel, width, exact=bool(marker))}


def _collected(axes, width: int, collection) -> list[dict]:
    """Points of a scatter as marks; of other collections each path with its own colour."""
    faces, edges = collection.get_facecolor(), collection.get_edgecolor()
    filled, drawn = len(faces) > 0, len(edges) > 0
    paths = collection.get_paths()
    if type(collection).__name__ == "PathCollection":
        to_panel = collection.get_offset_transform() - axes.transAxes
        from matplotlib.path import Path

        colour = _colour(faces[0]) if filled else None
        size = _short(np.sqrt(collection.get_sizes()[0]) * PIXELS / 72)
        mark = ["o", size, _colour(edges[0]) if drawn else colour, colour]
        return [{"mark": mark, "path": _path(Path(collection.get_offsets()), to_panel, width, exact=True)}]
    to_panel = collection.get_transform() - axes.transAxes
    widths = collection.get_linewidth()
    items = []
    for number, path in enumerate(paths):
        item = {"path": _path(path, to_panel, width, exact=False)}
        if filled:
            item["fill"] = _colour(faces[number % len(faces)])
        if drawn and type(collection).__name__ != "FillBetweenPolyCollection":
            item["stroke"] = _colour(edges[number % len(edges)])
            item["width"] = _short(widths[number % len(widths)] * PIXELS / 72)
        items.append(item)
    return items


def _words(axes, width: int, text) -> list[dict]:
    """A text where it stands; an annotation's distance from its point is that of a wide page."""
    if not text.get_text():
        return []
    if offset := getattr(text, "anncoords", "data") == "offset points":
        x, y = axes.transData.transform(text.xy) if text.xycoords == "data" else text.xy
        at = axes.transAxes.inverted().transform((x, y))
        shift = [_short(each * PIXELS / 72) for each in text.xyann]
    else:
        coordinates = getattr(text, "anncoords", None) or getattr(text, "xycoords", None)
        to_panel = {"axes fraction": axes.transAxes, "data": axes.transData}.get(
            coordinates, text.get_transform()
        )
        at = (to_panel - axes.transAxes).transform(text.get_unitless_position())
    if not np.all(np.isfinite(at)) or not (-0.05 <= at[0] <= 1.05 and -0.05 <= at[1] <= 1.05):
        return []
    anchor = {"left": "start", "center": "middle", "right": "end"}[text.get_horizontalalignment()]
    return [
        {
            "text": text.get_text(),
            "at": [round(at[0] * width), round(at[1] * HEIGHT)],
            "shift": shift if offset else [0, 0],
            "anchor": anchor,
        }
    ]


def _path(path, to_panel, width: int, exact: bool) -> list[list[int]]:
    """Pieces of a path, each as x, y, then steps, in units of the panel; thinned by less than a unit unless `exact`."""
    from matplotlib.transforms import Affine2D

    if not len(path.vertices):
        return []
    vertices = np.ma.filled(np.ma.asarray(path.vertices, float), np.nan)
    moved = (to_panel + Affine2D().scale(width, HEIGHT)).transform_path(type(path)(vertices, path.codes))
    moved.simplify_threshold = 0.5  # units
    clean = moved.cleaned(remove_nans=True, curves=False, simplify=not exact)
    inside = np.clip(clean.vertices, (-width, -HEIGHT), (2 * width, 2 * HEIGHT))
    points = np.rint(inside).astype(int)
    pieces = []
    for (x, y), code in zip(points.tolist(), clean.codes.tolist(), strict=True):
        if code == path.MOVETO:
            pieces.append([(x, y)])
        elif code == path.LINETO and (exact or pieces[-1][-1] != (x, y)):
            pieces[-1].append((x, y))
    return [_steps(piece) for piece in pieces]


def _steps(piece: list[tuple[int, int]]) -> list[int]:
    (x, y), *rest = piece
    steps = [x, y]
    for a, b in rest:
        steps += [a - x, b - y]
        x, y = a, b
    return steps


def _colour(colour) -> str | None:
    from matplotlib.colors import to_hex, to_rgba

    alpha = to_rgba(colour)[3]
    return to_hex(colour, keep_alpha=alpha < 1) if alpha else None


def _short(number: float) -> float:
    """To five digits, which no eye tells from more."""
    return float(f"{number:.5g}")
