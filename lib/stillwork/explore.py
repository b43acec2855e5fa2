"""Explorers: turn a drawing function into sliders with live redraw, or a static picture in a build."""

import io
from collections.abc import Callable
from dataclasses import dataclass

from stillwork.checks import InputError, nearest, require_number
from stillwork.paths import in_batch


@dataclass(frozen=True)
class Slider:
    """A number a reader may move.

    Attributes
    ----------
    low, high : float
        Range. Where these, `published` and `step` are ``int``, so is what the parameter gets.
    published : float
        The work's own setting: the start, the mark and what Reset returns to.
    unit : str
        Shown behind the name.
    step : float, optional
        By default 1/50 of the range, for a whole number at least 1; in decades for a logarithmic slider.
    log : bool
        Move in decades.
    """

    low: float
    high: float
    published: float
    unit: str = ""
    step: float | None = None
    log: bool = False

    def __post_init__(self):
        require_number("published", self.published, at_least=self.low, at_most=self.high)
        if self.log:
            require_number("low", self.low, above=0)

    @property
    def whole(self) -> bool:
        """Whether the parameter is a whole number."""
        return all(isinstance(value, int) for value in (self.low, self.high, self.published, self.step or 1))

    def read(self, value: float) -> float:
        """What the parameter gets when the control stands at `value`."""
        return round(value) if self.whole else value

    def widget(self, name: str):
        import ipywidgets as widgets

        text = f"{name.replace('_', ' ')}{f' ({self.unit})' if self.unit else ''}"
        shared = {"description": text, "continuous_update": False}
        shared["style"] = {"description_width": "initial"}
        shared["layout"] = widgets.Layout(width="32em")
        if self.log:
            from math import log10

            return widgets.FloatLogSlider(
                value=self.published,
                min=log10(self.low),
                max=log10(self.high),
                step=self.step or 0.02,
                **shared,
            )
        step = self.step or (self.high - self.low) / 50
        kind = widgets.FloatSlider
        if self.whole:
            kind, step = widgets.IntSlider, max(1, round(step))
        return kind(value=self.published, min=self.low, max=self.high, step=step, **shared)


@dataclass(frozen=True)
class Choice:
    """One of a few named settings; `published` is the work's own."""

    options: tuple[str, ...]
    published: str

    def __post_init__(self):
        if self.published not in self.options:
            raise InputError(
                f"published is {self.published!r}, not an option{nearest(self.published, self.options)}"
            )

    def read(self, value: str) -> str:
        """What the parameter gets: the name as it is."""
        return value

    def widget(self, name: str):
        import ipywidgets as widgets

        return widgets.Dropdown(
            options=self.options,
            value=self.published,
            description=name.replace("_", " "),
            style={"description_width": "initial"},
            layout=widgets.Layout(width="32em"),
        )


@dataclass(frozen=True)
class StaticPicture:
    """What stands where no widgets run."""

    png: bytes
    settings: str

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"explorer at the published setting: {self.settings}"


def explore(draw: Callable, **controls: Slider | Choice):
    """Redraw ``draw(**settings)`` whenever a control moves; Reset returns to the published setting.

    Parameters
    ----------
    draw : callable
        Returns a `matplotlib.figure.Figure`.
    **controls : Slider or Choice
        One a parameter of `draw`.

    Returns
    -------
    ipywidgets.VBox or StaticPicture
        The picture at the published setting where a build, not a person, runs the notebook.
    """
    published = {name: control.published for name, control in controls.items()}
    if in_batch():
        return StaticPicture(_png(draw(**published)), ", ".join(f"{k} = {v}" for k, v in published.items()))

    import ipywidgets as widgets

    rows = {name: control.widget(name) for name, control in controls.items()}
    picture = widgets.Image(format="png", layout=widgets.Layout(max_width="100%"))
    message = widgets.HTML()
    reset = widgets.Button(description="Published setting", icon="undo")

    def redraw(_change=None):
        settings = {name: controls[name].read(row.value) for name, row in rows.items()}
        try:
            picture.value = _png(draw(**settings))
            at_home = settings == published
            message.value = "at the published setting" if at_home else "moved from the published setting"
        except InputError as error:  # an impossible setting is an answer, not a crash
            message.value = f"no picture: {_escaped(str(error))}"

    def go_home(_button):
        for name, row in rows.items():
            row.value = published[name]

    for row in rows.values():
        row.observe(redraw, names="value")
    reset.on_click(go_home)
    redraw()
    marked = [
        widgets.HBox([row, widgets.Label(f"published: {published[name]}")]) for name, row in rows.items()
    ]
    return widgets.VBox([*marked, widgets.HBox([reset, message]), picture])


def _png(figure) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer = io.BytesIO()
    # `savefig` would draw twice, once for the layout.
    FigureCanvasAgg(figure).print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


def _escaped(text: str) -> str:
    from html import escape

    return escape(text)
