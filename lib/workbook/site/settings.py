"""The page "What the paper must have used": the windows of its continuous choices as bars above one another."""

from dataclasses import dataclass

from workbook.choices.axes import Multiverse
from workbook.choices.kept import Joint
from workbook.choices.settings import Meeting, meetings

WIDTH, ROW = 460, 16  # of the bars; height of one
LEAST = 2.0  # width of a bar that can be seen


@dataclass(frozen=True)
class Bars:
    """Windows of one choice, in SVG units.

    Attributes
    ----------
    axis : str
    ends : tuple of float
        Of the scale, in the choice's unit.
    steps : tuple of str
        Distances of the searched values, one a study.
    groups : tuple of (Meeting, float, tuple of (float, str, str))
        Of each setting of the other choices its height, and of each number its own height, its id and the path of its bars.
    height : float
    """

    axis: str
    ends: tuple[float, float]
    steps: tuple[str, ...]
    groups: tuple[tuple[Meeting, float, tuple[tuple[float, str, str], ...]], ...]
    height: float
    width: int = WIDTH


def bars(joint: Joint) -> list[Bars]:
    """Of each choice with windows; settings of the others under which they meet come first."""
    drawn = []
    for axis in dict.fromkeys(each.axis for each in joint.windows):
        mine = sorted((m for m in meetings(joint.windows) if m.axis == axis), key=lambda m: not m.pieces)
        ends = [end for m in mine for each in m.windows for piece in each.pieces for end in piece]
        low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
        scale = WIDTH / ((high - low) or 1.0)
        groups, y = [], 0.0
        for met in mine:
            top, rows = y + ROW, []
            y = top
            for each in met.windows:
                y += ROW
                spans = [(scale * (a - low), max(scale * (b - a), LEAST)) for a, b in each.pieces]
                path = "".join(f"M{x:.1f} {y:.1f}h{wide:.1f}" for x, wide in spans)
                rows.append((y, each.number, path))
            groups.append((met, top, tuple(rows)))
            y += ROW / 2
        steps = dict.fromkeys(each.step for m in mine for each in m.windows)
        drawn.append(Bars(axis, (low, high), tuple(steps), tuple(groups), y + ROW))
    return drawn


def unsearched(multiverses: list[Multiverse]) -> list[str]:
    """Choices of numbers between which others could stand and of which no study searches a range."""
    searched = {axis for each in multiverses for axis in each.windows}
    numeric = {
        axis.name: None
        for each in multiverses
        for axis in each.axes
        if all(isinstance(option, float) for option in axis.options)
    }
    return [axis for axis in numeric if axis not in searched]
