"""Quick pictures of one drawing function, for explorers: a move of a slider has 100 ms."""

import io
from collections.abc import Callable

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import RendererAgg
from matplotlib.layout_engine import ConstrainedLayoutEngine


class Redraw:
    """Pictures of one drawing function, quick from the second on.

    Most of a picture's time goes into its layout, its ticks and its texts, which `savefig` makes anew: 100 to 200 ms
    for the explorers here. So the panels stay where they were laid out first, titles at the panels' edge, and a logarithmic
    axis shows its decades alone. A drawing function that keeps its figure and sets the data of what moves spares a third of
    the rest, its ticks and legends.

    Parameters
    ----------
    draw : callable
        Returns a `matplotlib.figure.Figure`.
    """

    def __init__(self, draw: Callable):
        self._draw = draw
        self._renderer = self._engine = None
        self._places = {}  # of the panels, by how many there are

    def __call__(self, **settings) -> bytes:
        """The picture for ``draw(**settings)``, as PNG."""
        figure = self._figure(settings)
        if isinstance(engine := figure.get_layout_engine(), ConstrainedLayoutEngine):
            self._engine = engine  # a figure that is kept has lost it
        if places := self._places.get(len(figure.axes)):
            figure.set_layout_engine("none")
            for axes, place in zip(figure.axes, places, strict=True):
                axes.set_position(place)
            self._render(figure)
            if self._complete(figure):
                return self._png()
            figure.set_layout_engine(self._engine)
            for axes in figure.axes:
                axes.set_in_layout(True)  # a panel that was put in its place takes no part in a layout
        return self._laid_out(figure)

    def _laid_out(self, figure) -> bytes:
        if isinstance(engine := figure.get_layout_engine(), ConstrainedLayoutEngine):
            engine.set(w_pad=0.08, h_pad=0.06)  # inches: room for tick labels to grow
        self._render(figure)
        self._places[len(figure.axes)] = [axes.get_position(original=True) for axes in figure.axes]
        return self._png()

    def _figure(self, settings: dict):
        with rc_context({"axes.titley": 1.0}):  # else the ticks of both axes are measured for it
            return self._draw(**settings)

    def _render(self, figure) -> None:
        for axes in figure.axes:
            axes.minorticks_off()
        size = figure.bbox.size
        if self._renderer is None or (self._renderer.width, self._renderer.height) != tuple(size):
            self._renderer = RendererAgg(*size, figure.dpi)
        self._renderer.clear()
        figure.draw(self._renderer)

    def _complete(self, figure) -> bool:
        """Whether no label of an axis reaches out of the picture."""
        labels = [axis.label for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
        boxes = [label.get_window_extent(self._renderer) for label in labels if label.get_text()]
        return all(box.x0 >= 0 and box.y0 >= 0 for box in boxes)

    def _png(self) -> bytes:
        from PIL import Image

        buffer = io.BytesIO()
        Image.fromarray(np.asarray(self._renderer.buffer_rgba())).save(buffer, "png", compress_level=1)
        return buffer.getvalue()
