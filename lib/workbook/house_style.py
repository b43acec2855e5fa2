"""Figures that carry the workbook's style: matplotlib's settings change while one is made or drawn, no longer."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache, partial, wraps
from inspect import getmembers, isfunction

from matplotlib import RcParams, cycler, rcParams
from matplotlib.figure import Figure

from workbook.palette import COLOURS, STYLE

_SETTINGS = dict(RcParams({**STYLE, "axes.prop_cycle": cycler(color=COLOURS)}))
# matplotlib tests whether a class has others than its own.
_KEPT = ("get_data_ratio", "get_cursor_data", "cla")
_LOGARITHMIC = {"semilogx": "x", "semilogy": "y", "loglog": "xy"}  # methods, and the axes that they make so
_inside = False  # the settings are one for the process, and so is this


@contextmanager
def house_style() -> Iterator[None]:
    """matplotlib's settings of the workbook's figures; afterwards those from before."""
    global _inside
    if _inside:
        yield
        return
    before = {name: rcParams[name] for name in _SETTINGS}
    _inside = True
    # As matplotlib restores settings: they are checked, and to check them again at each call takes a millisecond.
    dict.update(rcParams, _SETTINGS)
    try:
        yield
    finally:
        dict.update(rcParams, before)
        _inside = False


def _styled(method):
    @wraps(method)
    def styled(*arguments, **options):
        if _inside:
            return method(*arguments, **options)
        with house_style():
            return method(*arguments, **options)

    return styled


def _scaled_once(method, axes: str):
    """Of a second line nothing but the line: matplotlib scales the axes of all panels that share them anew for each."""

    @wraps(method)
    def drawn(self, *arguments, **options):
        scaled = all(getattr(self, f"get_{axis}scale")() == "log" for axis in axes)
        plain = options.keys().isdisjoint({"base", "subs", "nonpositive"})
        return (self.plot if scaled and plain else partial(method, self))(*arguments, **options)

    return drawn


@cache
def _dressed(kind: type) -> type:
    """A class of figures or panels whose public methods run in the style: titles and ticks read it when they are made."""
    methods = {
        name: _styled(method)
        for name, method in getmembers(kind, isfunction)
        if not name.startswith("_") and name not in _KEPT
    }
    for name in _LOGARITHMIC.keys() & methods.keys():
        methods[name] = _scaled_once(methods[name], _LOGARITHMIC[name])
    return type(kind.__name__, (kind,), {"__module__": kind.__module__, **methods})


class HouseFigure(_dressed(Figure)):
    """A figure in the workbook's style, as is each panel that it is given: by `subplots`, `twinx` or a colour bar."""

    def add_subplot(self, *arguments, **options):
        return _dress(super().add_subplot(*arguments, **options))

    def add_axes(self, *arguments, **options):
        return _dress(super().add_axes(*arguments, **options))


def _dress(axes):
    if not hasattr(axes, "in_house_style"):
        axes.__class__ = _dressed(type(axes))
        axes.in_house_style = True
    return axes
