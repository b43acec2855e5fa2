"""At which settings an explorer's pictures are computed: more stops where the picture changes more."""

import itertools
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from workbook.explorer import Choice, Slider

SAMPLES = 64  # of a curve, by which two pictures are compared


@dataclass(frozen=True)
class Ladder:
    """The values that a control may take here, in order, and the place of the start."""

    values: tuple
    start: int


def shares(control: Slider) -> np.ndarray:
    """Where the values that a slider offers lie between its ends (0 to 1), the start among them."""
    low, high = control.low, control.high
    span = np.log10(high / low) if control.log else high - low
    step = control.step or (0.02 if control.log else (high - low) / 50)
    if control.whole and not control.log:
        step = max(1, round(step))
    start = _share(control, control.start)
    regular = np.arange(round(span / step) + 1) * step / span
    others = regular[(regular < 1 + 1e-9) & (abs(regular - start) > 1e-9)]
    return np.unique(np.append(others, start))


def _share(control: Slider, value: float) -> float:
    low, high = control.low, control.high
    return np.log(value / low) / np.log(high / low) if control.log else (value - low) / (high - low)


def value_at(control: Slider, share: float):
    """What the parameter gets at a share of the slider's way."""
    low, high = control.low, control.high
    value = low * (high / low) ** share if control.log else low + share * (high - low)
    if np.isclose(value, control.start, rtol=1e-9, atol=1e-9 * (high - low)):
        return control.start
    return control.read(float(f"{value:.3g}" if control.log else f"{value:.10g}"))


def ladder(control: Slider | Choice, picture_of: Callable, count: int, also: Collection = ()) -> Ladder:
    """Stops of a control while the others stay: its ends, its start, what `also` names, and between them where it matters.

    Parameters
    ----------
    control : Slider or Choice
    picture_of : callable
        The picture for a value of this control.
    count : int
        Stops at most; a choice has all of its options.
    also : collection
        Values of the control that have a stop in any case.
    """
    if isinstance(control, Choice):
        return Ladder(control.options, control.options.index(control.start))
    offered = {value_at(control, share): share for share in shares(control)}
    offered |= {value: _share(control, value) for value in also}
    offered = dict(sorted(offered.items()))
    values, places = list(offered), list(offered.values())
    home = values.index(control.start)
    chosen = sorted({0, home, len(values) - 1, *map(values.index, also)})
    while len(chosen) < min(count, len(values)):
        gaps = [
            (_gap(picture_of, values[a], values[b]) + (places[b] - places[a]) / 4, a, b)
            for a, b in itertools.pairwise(chosen)
            if b - a > 1
        ]
        _, a, b = max(gaps)
        middle = int(np.argmin(abs(np.array(places[a + 1 : b]) - (places[a] + places[b]) / 2)))
        chosen = sorted({*chosen, a + 1 + middle})
    return Ladder(tuple(values[each] for each in chosen), chosen.index(home))


def _gap(picture_of: Callable, a, b) -> float:
    return distance(picture_of(a), picture_of(b))


def distance(one: list | dict, other: list | dict) -> float:
    """How far what two pictures draw lies apart, in shares of a panel: 0 for equal ones, at most 1."""
    a, b = _signature(one), _signature(other)
    return 1.0 if a.shape != b.shape or not a.size else float(np.minimum(abs(a - b), 1.0).mean())


def _signature(picture: list | dict) -> np.ndarray:
    """Each path's heights at regular places, and where it begins and ends."""
    if isinstance(picture, dict):  # no picture
        return np.empty(0)
    rows = []
    for panel in picture:
        width, height = panel["units"]
        for item in panel["items"]:
            for path in item.get("path", [])[:1]:
                x, y = np.cumsum(np.reshape(path, (-1, 2)), axis=0).T
                order = np.argsort(x, kind="stable")
                heights = np.interp(np.linspace(0, width, SAMPLES), x[order], y[order]) / height
                rows.append(np.append(heights, [x[0] / width, x[-1] / width]))
    return np.array(rows)
