"""Explorers: turn a drawing function into sliders with live redraw, or a static picture in a build."""

import shlex
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from html import escape

from workbook.checks import InputError, is_refusal, nearest, require_choice, require_number
from workbook.paths import in_batch

BASES = ("printed", "assumed", "our result", "default")


def label(name: str, unit: str = "") -> str:
    """A control's words: its parameter's name, the unit in brackets and neither it nor its numerator in the name, too."""
    *words, last = name.split("_")
    doubled = words and last in (unit.lower(), unit.lower().partition("/")[0])
    text = " ".join(words if doubled else [*words, last])
    return f"{text} ({unit})" if unit else text


def _require_basis(basis: str, place: str) -> None:
    require_choice("basis", basis, BASES)
    if (basis == "printed") != bool(place):
        raise InputError(
            "place is for what is printed, and needed there; give basis='printed', place='Table 1'"
        )


@dataclass(frozen=True)
class Slider:
    """A number a reader may move.

    Attributes
    ----------
    low, high : float
        Range. Where these, `start` and `step` are ``int``, so is what the parameter gets.
    start : float
        Where it stands first, its mark, and what Reset returns to.
    unit : str
        Shown behind the name.
    step : float, optional
        By default 1/50 of the range, for a whole number at least 1; in decades for a logarithmic slider.
    log : bool
        Move in decades.
    basis : str
        What the start is: ``printed`` in the paper, ``assumed``, ``our result``, or a ``default`` of ours.
    place : str
        Where it is printed.
    """

    low: float
    high: float
    start: float | None = None
    unit: str = ""
    step: float | None = None
    log: bool = False
    basis: str = "default"
    place: str = ""

    def __post_init__(self):
        require_number("start", self.start, at_least=self.low, at_most=self.high)
        _require_basis(self.basis, self.place)
        if self.log:
            require_number("low", self.low, above=0)

    @property
    def whole(self) -> bool:
        """Whether the parameter is a whole number."""
        return all(isinstance(value, int) for value in (self.low, self.high, self.start, self.step or 1))

    def require(self, name: str, value: float) -> None:
        """Raise an `InputError` where the control `name` cannot stand at `value`."""
        require_number(name, value, at_least=self.low, at_most=self.high)

    def read(self, value: float) -> float:
        """What the parameter gets when the control stands at `value`."""
        return round(value) if self.whole else value

    def widget(self, name: str):
        import ipywidgets as widgets

        # While the kernel draws, the front end keeps the last place alone: a drag is never behind by more than one.
        shared = {"description": label(name, self.unit), "continuous_update": True}
        shared["style"] = {"description_width": "initial"}
        shared["layout"] = widgets.Layout(width="32em")
        if self.log:
            from math import log10

            return widgets.FloatLogSlider(
                value=self.start,
                min=log10(self.low),
                max=log10(self.high),
                step=_through(log10(self.start / self.low), self.step or 0.02),
                **shared,
            )
        step = self.step or (self.high - self.low) / 50
        kind = widgets.FloatSlider
        if self.whole:
            kind, step = widgets.IntSlider, max(1, round(step))
            step = next(each for each in range(step, 0, -1) if (self.start - self.low) % each == 0)
        else:
            step = _through(self.start - self.low, step)
        return kind(value=self.start, min=self.low, max=self.high, step=step, **shared)


def _through(way: float, step: float) -> float:
    """A step near `step` that leads from the lower end to the start: a slider jumps to its nearest step when it is touched."""
    steps = round(way / step)
    return way / steps if steps else step


@dataclass(frozen=True)
class Choice:
    """One of a few named settings; `start`, `basis` and `place` as of a `Slider`."""

    options: tuple[str, ...]
    start: str = ""
    basis: str = "default"
    place: str = ""

    def __post_init__(self):
        if self.start not in self.options:
            raise InputError(f"start is {self.start!r}, not an option{nearest(self.start, self.options)}")
        _require_basis(self.basis, self.place)

    def require(self, name: str, value: str) -> None:
        """Raise an `InputError` where the control `name` has no such option."""
        require_choice(name, value, self.options)

    def read(self, value: str) -> str:
        """What the parameter gets: the name as it is."""
        return value

    def widget(self, name: str):
        import ipywidgets as widgets

        return widgets.Dropdown(
            options=self.options,
            value=self.start,
            description=label(name),
            style={"description_width": "initial"},
            layout=widgets.Layout(width="32em"),
        )


def basis_text(control: Slider | Choice, start: str) -> str:
    """What stands beside a control: its start, and what that is."""
    known = f"{control.basis}, {control.place}" if control.place else control.basis
    return f"start: {start} ({known})"


def whole_settings(
    presets: Mapping[str, Mapping], controls: Mapping[str, Slider | Choice]
) -> dict[str, dict]:
    """Each named design at all controls; what it does not name stands at its start."""
    for name, settings in presets.items():
        for control, value in settings.items():
            controls[require_choice(f"a control of preset {name!r}", control, controls)].require(
                control, value
            )
    start = {name: control.start for name, control in controls.items()}
    return {name: start | settings for name, settings in presets.items()}


def build_line(notebook: str, parameters: Collection[str], settings: Mapping, start: Mapping) -> str:
    """The command that builds a notebook's page with the settings of its explorer; empty where none is a parameter of the page."""
    if not set(parameters) & set(settings):
        return ""
    moved = {name: value for name, value in settings.items() if value != start[name]}
    given = "".join(
        f" -p {shlex.quote(f'{name}={value}')}" for name, value in moved.items() if name in parameters
    )
    rest = ", ".join(name for name in moved if name not in parameters)
    return f'make figures ARGS="{notebook}{given}"' + (
        f"  # the page has no parameter {rest}" if rest else ""
    )


def _own_page() -> tuple[str, Collection[str]]:
    """The notebook that runs this, by its `page`, and its parameters; nothing where there is none."""
    from workbook.conclusions import accepted_settings
    from workbook.page import shell

    here = shell()
    notebook = getattr(here and here.user_ns.get("page"), "notebook", "")
    return notebook, tuple(accepted_settings(notebook)) if notebook else ()


AT_START = "explorer at its start"  # how one is printed where no widgets run


@dataclass(frozen=True)
class StaticPicture:
    """What stands where no widgets run."""

    png: bytes
    settings: str

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"{AT_START}: {self.settings}"


def lines_of(figure) -> list[list]:
    """Points (n, 2) of the lines of each panel; lines across a whole panel are marks, not data."""
    return [
        [line.get_xydata().copy() for line in axes.lines if line.get_transform() == axes.transData]
        for axes in figure.axes
    ]


def show_behind(figure, lines: list[list]) -> list:
    """Lines, as `lines_of` gives them, in grey behind a figure of as many panels; its axes keep their limits."""
    from matplotlib.lines import Line2D

    from workbook.palette import GREY

    if len(lines) != len(figure.axes):
        return []
    return [
        axes.add_artist(Line2D(*points.T, color=GREY, alpha=0.45, lw=2.5, zorder=0.5))
        for axes, each in zip(figure.axes, lines, strict=True)
        for points in each
    ]


# What `explore` drew last behind a figure: `draw` may keep the figure and set the data of what moves, also for an
# explorer that is made again.
_behind: list = []


def _over_the_start(draw: Callable, start: dict) -> Callable:
    """The picture of a setting, before the lines of the start in grey."""
    from workbook.redraw import Redraw

    ghost: list[list] = []

    def drawn(**settings):
        while _behind:
            _behind.pop().remove()
        figure = draw(**settings)
        if settings == start:
            ghost[:] = lines_of(figure)
        else:
            _behind.extend(show_behind(figure, ghost))
        return figure

    return Redraw(drawn)


def explore(draw: Callable, presets: Mapping[str, Mapping] | None = None, **controls: Slider | Choice):
    """Redraw ``draw(**settings)`` while a control moves, before the lines of the start in grey; Reset returns to it.

    Parameters
    ----------
    draw : callable
        Returns a `matplotlib.figure.Figure`; where building one takes long, the one of before with the data set anew.
    presets : mapping of str to mapping, optional
        Named designs, a button each: values of controls, e.g. ``{"MC": {"damping": 0.0}}``; the others stand at their start.
    **controls : Slider or Choice
        One a parameter of `draw`.

    Returns
    -------
    ipywidgets.VBox or StaticPicture
        The picture at the start where a build, not a person, runs the notebook.
    """
    start = {name: control.start for name, control in controls.items()}
    designs = whole_settings(presets or {}, controls)
    picture_of = _over_the_start(draw, start)
    if in_batch():
        return StaticPicture(picture_of(**start), ", ".join(f"{k} = {v}" for k, v in start.items()))

    import ipywidgets as widgets

    rows = {name: control.widget(name) for name, control in controls.items()}
    picture = widgets.Image(format="png", layout=widgets.Layout(max_width="100%"))
    message, line = widgets.HTML(), widgets.HTML()
    notebook, parameters = _own_page()
    reset = widgets.Button(description="Back to the start", icon="undo")

    def redraw(_change=None):
        settings = {name: controls[name].read(row.value) for name, row in rows.items()}
        line.value = f"<code>{escape(build_line(notebook, parameters, settings, start))}</code>"
        try:
            picture.value = picture_of(**settings)
            at_home = settings == start
            message.value = "at the start" if at_home else "moved; in grey the start"
        except ValueError as error:
            if not is_refusal(error):
                raise
            # an impossible setting is an answer, not a crash
            message.value = f"no picture: {escape(str(error))}"

    def go_to(settings):
        for row in rows.values():
            row.unobserve(redraw, names="value")
        for name, row in rows.items():
            row.value = settings[name]
        watch()

    def watch():
        for row in rows.values():
            row.observe(redraw, names="value")
        redraw()

    buttons = [widgets.Button(description=name, layout=widgets.Layout(width="auto")) for name in designs]
    for button, settings in zip([reset, *buttons], [start, *designs.values()], strict=True):
        button.on_click(lambda _button, settings=settings: go_to(settings))
    watch()
    marked = [
        widgets.HBox([row, widgets.Label(basis_text(controls[name], str(start[name])))])
        for name, row in rows.items()
    ]
    named = [widgets.HBox(buttons)] if buttons else []
    under = [line] if build_line(notebook, parameters, start, start) else []
    return widgets.VBox([*named, *marked, widgets.HBox([reset, message]), picture, *under])
