"""Pictures of one drawing function at one setting after another, as a slider asks for them."""

import io
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.text import Text

from stillwork.base.garbage import no_collection
from workbook.house_style import HouseFigure, house_style
from workbook.rendering import ticks_once

FRAMES = 32  # of panels that are remembered, 1 MB each at most


class Redraw:
    """Pictures of one drawing function, quick from the second on.

    Most of a picture's time goes into its layout, its ticks and its texts. So the panels stay where they were laid
    out first, a logarithmic axis shows its decades alone, and what frames a panel (axes, grid, labels, title) is
    drawn again only when it changes.

    Parameters
    ----------
    draw : callable
        Returns a `matplotlib.figure.Figure`.
    """

    def __init__(self, draw: Callable):
        self._draw = draw
        self._renderer = None
        self._places = []
        self._frames = {}

    def __call__(self, **settings) -> bytes:
        """The picture for ``draw(**settings)``, as PNG."""
        with no_collection():
            figure = self._draw(**settings)
            styled = house_style() if isinstance(figure, HouseFigure) else nullcontext()
            with styled:
                if len(figure.axes) == len(self._places):
                    figure.set_layout_engine("none")
                    for axes, place in zip(figure.axes, self._places, strict=True):
                        axes.set_position(place)
                    if self._render(figure):
                        return self._png()
                    figure = self._draw(**settings)  # a panel put in its place takes no part in a layout
                self._lay_out(figure)
                self._render(figure)
                return self._png()

    def _lay_out(self, figure) -> None:
        if (engine := figure.get_layout_engine()) is not None:
            engine.set(w_pad=0.08, h_pad=0.06)  # inches: room for tick labels to grow
            _without_minor_ticks(figure)
            engine.execute(figure)
            figure.set_layout_engine("none")
        self._places = [axes.get_position(original=True) for axes in figure.axes]

    def _render(self, figure) -> bool:
        """Draw a figure, its panels in their places; whether no label of an axis reaches out of the picture."""
        _without_minor_ticks(figure)
        width, height = figure.bbox.size
        if self._renderer is None or (self._renderer.width, self._renderer.height) != (width, height):
            self._renderer = RendererAgg(width, height, figure.dpi)
            self._frames.clear()
        self._renderer.clear()
        with ticks_once(figure):
            frames = [self._frame(axes) for axes in figure.axes]
            for axes, frame in zip(figure.axes, frames, strict=True):
                if frame:
                    frame.replace(axes)
            figure.draw(self._renderer)
        return all(
            frame.complete if frame else _complete(axes, self._renderer)
            for axes, frame in zip(figure.axes, frames, strict=True)
        )

    def _frame(self, axes) -> "_Frame | None":
        """What frames a panel, drawn now or before; None where that is not all in its key."""
        try:
            key = _key(axes)
        except _Unknown:
            return None
        if key not in self._frames:
            if len(self._frames) == FRAMES:
                self._frames.clear()
            self._frames[key] = _Frame.drawn(axes, self._renderer)
        return self._frames[key]

    def _png(self) -> bytes:
        from matplotlib.image import imsave

        buffer = io.BytesIO()
        fast = {"compress_level": 1}  # the picture goes a short way and is soon replaced
        rgba = self._renderer.buffer_rgba()
        imsave(buffer, rgba, format="png", metadata={"Software": None}, pil_kwargs=fast)
        return buffer.getvalue()


@dataclass(frozen=True)
class _Frame:
    """Axes, grid, labels and titles of a panel as pixels; `x`, `y` of the lower left one in the picture."""

    image: np.ndarray  # uint8 (height, width, 4), rows from below
    x: int
    y: int
    complete: bool

    @classmethod
    def drawn(cls, axes, like: RendererAgg) -> "_Frame":
        renderer = RendererAgg(like.width, like.height, like.dpi)
        parts = {axes.xaxis, axes.yaxis, *_titles(axes)}
        others = [one for one in axes.get_children() if one not in parts and one.get_visible()]
        for one in others:
            one.set_visible(False)
        axes.draw(renderer)
        for one in others:
            one.set_visible(True)
        pixels = np.asarray(renderer.buffer_rgba())[::-1]
        inked = pixels[..., 3] > 0
        rows, columns = np.flatnonzero(inked.any(axis=1)), np.flatnonzero(inked.any(axis=0))
        if not len(rows):
            return cls(pixels[:1, :1].copy(), 0, 0, True)
        (y, top), (x, right) = rows[[0, -1]], columns[[0, -1]]
        image = pixels[y : top + 1, x : right + 1].copy()
        return cls(image, int(x), int(y), _complete(axes, renderer))

    def replace(self, axes) -> None:
        """Put the pixels in the place of what they show."""
        stamp = _Stamp(self)
        stamp.set_zorder(axes.xaxis.get_zorder())
        axes.xaxis.set_visible(False)
        axes.yaxis.set_visible(False)
        for title in _titles(axes):
            title.set_text("")
        axes.add_artist(stamp)


class _Stamp(Artist):
    def __init__(self, frame: _Frame):
        super().__init__()
        self._frame = frame

    def draw(self, renderer) -> None:
        renderer.draw_image(renderer.new_gc(), self._frame.x, self._frame.y, self._frame.image)


class _Unknown(Exception):
    """What a panel's frame shows is not all known."""


def _without_minor_ticks(figure) -> None:
    for axes in figure.axes:
        axes.minorticks_off()


def _complete(axes, renderer) -> bool:
    labels = [axis.label for axis in (axes.xaxis, axes.yaxis) if axis.label.get_text()]
    boxes = [label.get_window_extent(renderer) for label in labels]
    return all(box.x0 >= 0 and box.y0 >= 0 for box in boxes)


def _titles(axes) -> list[Text]:
    return [one for one in axes.get_children() if isinstance(one, Text) and one not in axes.texts]


def _key(axes) -> tuple:
    """All that a panel's frame shows; `_Unknown` where something else may count."""
    alone = len(axes._twinned_axes.get_siblings(axes)) == 1 and not axes.child_axes
    if not alone or axes.name != "rectilinear" or not axes.axison or not axes.get_visible():
        raise _Unknown
    axes.apply_aspect()
    parts = [axes.get_position().bounds, *map(_text_key, _titles(axes))]
    for axis in (axes.xaxis, axes.yaxis):
        parts += [axis.get_scale(), *axis.get_view_interval(), axis.get_visible(), axis.get_zorder()]
        parts += [axis.get_label_position(), axis.get_ticks_position(), _text_key(axis.label)]
        parts += [_plain(axis.get_tick_params()), _ticker_key(axis.major.locator)]
        parts += [_ticker_key(axis.major.formatter)]
        for tick in vars(axis).get("majorTicks", ()):  # made before they are drawn, so perhaps changed
            grid = tick.gridline
            parts += [grid.get_visible(), grid.get_color(), grid.get_linestyle(), grid.get_linewidth()]
            parts += [_text_key(tick.label1), _text_key(tick.label2)]
    return tuple(parts)


def _text_key(text: Text) -> tuple:
    font, colour = text.get_fontproperties(), _plain(text.get_color())
    place = text.get_horizontalalignment(), text.get_verticalalignment(), text.get_rotation()
    return text.get_text(), text.get_visible(), colour, font, *place


def _ticker_key(ticker) -> tuple:
    fields = {name: value for name, value in vars(ticker).items() if name != "axis"}
    return type(ticker), _plain(fields)


def _plain(value):
    """Settings as what can be compared; `_Unknown` where they hold an object of any other kind."""
    if value is None or isinstance(value, (bool, int, float, str, np.generic)):
        return value
    if isinstance(value, np.ndarray):
        return tuple(value.ravel().tolist())
    if isinstance(value, dict):
        return tuple((name, _plain(value[name])) for name in sorted(value))
    if isinstance(value, (list, tuple)):
        return tuple(_plain(one) for one in value)
    if isinstance(value, (set, frozenset)):
        return tuple(sorted(value))
    if isinstance(value, partial):  # ticks with words of their own: `axes.set_xticks(places, words)`
        return value.func, _plain(value.args), _plain(value.keywords)
    raise _Unknown
