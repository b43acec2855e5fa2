"""Draw a figure in one pass: the pixels of `savefig`, for a good half of the time."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from copy import copy

import numpy as np
from matplotlib.backends.backend_agg import RendererAgg

from stillwork.base.checks import InputError, short_repr
from stillwork.base.garbage import no_collection
from workbook.house_style import HouseFigure, house_style


def pixels(figure, dpi: float) -> np.ndarray:
    """The picture of a figure, as `matplotlib.figure.Figure.savefig` draws it; the figure stays as it is.

    `savefig` draws twice where a figure has a layout engine, the first time to find the layout alone. Here the
    engine is called directly.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    dpi : float
        Dots per inch.

    Returns
    -------
    ndarray of uint8, shape (height, width, 4)
        Red, green, blue and alpha; rows from the top.

    Raises
    ------
    InputError
        When a formula in the figure cannot be set, or its layout cannot be found.
    """
    with ExitStack() as stack:
        stack.enter_context(no_collection())
        stack.enter_context(_text_named(figure))
        stack.enter_context(house_style() if isinstance(figure, HouseFigure) else nullcontext())
        canvas = stack.enter_context(_canvas(figure, dpi))
        stack.enter_context(ticks_once(figure))
        stack.enter_context(_places(figure))
        engine = figure.get_layout_engine()
        if engine is not None:
            _lay_out(figure, engine)
            stack.callback(figure.set_layout_engine, engine)
            figure.set_layout_engine("none")
        canvas.draw()
        return np.array(canvas.buffer_rgba())


@contextmanager
def _text_named(figure) -> Iterator[None]:
    """Formulas are read only when they are set: report which text could not be read."""
    try:
        yield
    except ValueError:
        if (text := _unset(figure)) is not None:
            raise InputError(
                f"figure has the text {short_repr(text)}, which cannot be set; correct its formula, or write \\$ for a dollar"
            ) from None
        raise


def _unset(figure) -> str | None:
    """The first text of a figure whose formula cannot be read."""
    from matplotlib.mathtext import MathTextParser
    from matplotlib.text import Text

    parser = MathTextParser("path")
    for each in figure.findobj(Text):
        text, is_formula = each._preprocess_math(each.get_text())
        if is_formula is True:
            for line in text.split("\n"):
                try:
                    parser.parse(line)
                except ValueError:
                    return each.get_text()
    return None


def _lay_out(figure, engine) -> None:
    try:
        engine.execute(figure)
    except ValueError as error:  # it has rules of its own, such as panels from one grid alone
        raise InputError(f"figure has no such layout ({error}); make it with layout='constrained'") from None


@contextmanager
def _canvas(figure, dpi: float) -> Iterator:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    before, before_dpi = figure.canvas, figure.dpi
    canvas = FigureCanvasAgg(figure)
    figure.set_dpi(dpi)
    try:
        yield canvas
    finally:
        figure.set_dpi(before_dpi)
        figure.set_canvas(before)


@contextmanager
def _places(figure) -> Iterator[None]:
    """Put back what a layout and a drawing move: margins, parts, panels, their views, the figure's titles."""
    figures = [figure]
    for each in figures:
        figures += each.subfigs
    panels = [panel for axes in figure.axes for panel in (axes, *axes.child_axes)]
    boxes = [part.bbox_relative for part in figures[1:]] + [panel.viewLim for panel in panels]
    boxes = [(box, box.frozen()) for box in boxes]
    margins = [(each.subplotpars, dict(vars(each.subplotpars))) for each in figures]
    titles = [(text, text.get_position()) for each in figures for text in each.texts]
    places = [
        # Where a locator put it last; without one a panel finds its place from the original one when drawn.
        (each, each.get_in_layout(), each.get_position(True), each.get_position(not each.get_axes_locator()))
        for each in panels
    ]
    try:
        yield
    finally:
        for margin, before in margins:
            margin.update(**before)
        for text, place in titles:
            text.set_position(place)
        for panel, in_layout, place, located in places:
            panel.set_position(place)  # takes it out of later layouts
            panel.set_position(located, which="active")
            panel.set_in_layout(in_layout)
        for box, before in boxes:
            box.set(before)


@contextmanager
def ticks_once(figure) -> Iterator[None]:
    """Place ticks and measure their labels once for each view and place of a panel: a layout needs them a dozen times."""
    every = [axis for axes in figure.axes for panel in (axes, *axes.child_axes) for axis in _axes_of(panel)]
    for axis in every:
        ticks = _Ticks(axis)
        axis._update_ticks, axis._get_ticklabel_bboxes = ticks.placed, ticks.boxes
    try:
        yield
    finally:
        for axis in every:
            del axis._update_ticks, axis._get_ticklabel_bboxes


class _Ticks:
    """An axis's ticks, for as long as they are the same."""

    def __init__(self, axis):
        self._axis, self._update, self._measure = axis, axis._update_ticks, axis._get_ticklabel_bboxes
        self._seen = self._offset = self._placed = self._boxes = None

    def placed(self) -> list:
        axis, axes = self._axis, self._axis.axes
        seen = (
            *(axes.viewLim.bounds, axes.bbox.bounds, axis.get_transform()),
            *(axis.major.locator, axis.minor.locator, axis.major.formatter, axis.minor.formatter),
        )
        # Panels that share an axis share its formatter, whose offset is that of the ticks it saw last.
        if self._seen != seen or self._offset != axis.major.formatter.get_offset():
            self._placed, self._boxes = self._update(), None
            self._seen, self._offset = seen, axis.major.formatter.get_offset()
        return self._placed

    def boxes(self, ticks: list, renderer) -> tuple[list, list]:
        if ticks is not self._placed:
            return self._measure(ticks, renderer)
        if self._boxes is None:
            self._boxes = self._measure(ticks, renderer)
        return self._boxes


@contextmanager
def copied_ticks() -> Iterator[None]:
    """Make the ticks of an axis as copies of its first one: matplotlib makes each anew, and then gives it that one's looks."""
    from matplotlib.axis import Axis

    before = Axis.get_major_ticks

    def copied(self, numticks=None):
        ticks = self.majorTicks
        count = len(self.get_majorticklocs()) if numticks is None else numticks
        ticks += [_copy_tick(ticks[0]) for _ in range(count - len(ticks))]
        return ticks[:count]

    Axis.get_major_ticks = copied
    try:
        yield
    finally:
        Axis.get_major_ticks = before


def _copy_tick(tick):
    """Its place and its words are set before it is drawn; of its parts none is shared but what is never changed in place."""
    new = copy(tick)
    for name in ("tick1line", "tick2line", "gridline", "label1", "label2"):
        setattr(new, name, copy(getattr(tick, name)))
    for label in (new.label1, new.label2):
        label.set_fontproperties(label.get_fontproperties().copy())
    return new


@contextmanager
def known_layouts(known: dict) -> Iterator[None]:
    """Lay a text out once: its lines, seen from its own place, are the same wherever it stands."""
    from matplotlib.text import Text

    before = Text._get_layout

    def laid_out(self, renderer):
        if self.get_wrap():  # as wide as its place allows
            return before(self, renderer)
        text = (
            *(self.get_text(), self.get_parse_math(), self.get_usetex(), hash(self.get_fontproperties())),
            *(self.get_rotation(), self.get_rotation_mode(), self._linespacing),
            *(self.get_horizontalalignment(), self.get_verticalalignment(), self._get_multialignment()),
            self.get_figure(root=True).dpi,
        )
        if (layout := known.get(text)) is None:
            if len(known) == TEXTS:
                known.clear()
            layout = known[text] = before(self, renderer)
        return layout

    Text._get_layout = laid_out
    try:
        yield
    finally:
        Text._get_layout = before


def _axes_of(panel) -> tuple:
    return panel.xaxis, panel.yaxis


TEXTS = 512  # that are remembered, a few kilobytes each


class RememberingRenderer(RendererAgg):
    """A renderer that makes the glyphs of a text in one place once: that takes longer than to put them there."""

    def __init__(self, width: float, height: float, dpi: float):
        super().__init__(width, height, dpi)
        self._texts = {}

    def draw_text(self, gc, x, y, s, prop, angle, ismath=False, mtext=None):
        # matplotlib 3.11's words for a font, which 3.10 lacks
        words = [getattr(mtext, name, tuple)() for name in ("get_fontfeatures", "get_language")]
        text = (x, y, s, hash(prop), *words, angle, ismath, gc.get_antialiased())
        glyphs = self._texts.get(text)
        if glyphs is not None:
            for glyph in glyphs:
                self._renderer.draw_text_image(*glyph, gc)
            return
        kernel, self._renderer = self._renderer, _Noting(self._renderer)
        try:
            super().draw_text(gc, x, y, s, prop, angle, ismath, mtext)
            glyphs = self._renderer.glyphs
        finally:
            self._renderer = kernel
        if glyphs is not None:
            if len(self._texts) == TEXTS:
                self._texts.clear()
            self._texts[text] = glyphs


class _Noting:
    """Agg, and the glyphs that it has drawn; None with the bar of a fraction or a root among them."""

    def __init__(self, kernel):
        self._kernel, self.glyphs = kernel, []

    def draw_text_image(self, pixels, x, y, angle, gc):
        self._kernel.draw_text_image(pixels, x, y, angle, gc)
        if self.glyphs is not None:
            self.glyphs.append((pixels, x, y, angle))

    def draw_path(self, *arguments):
        self._kernel.draw_path(*arguments)
        self.glyphs = None
