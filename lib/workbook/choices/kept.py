"""``settings.csv`` of a topic: the best joint settings, and which printed number wants which option."""

import csv
import io
import json
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import astuple, dataclass, field, fields, replace
from pathlib import Path

from workbook import paths
from workbook.checks import require_choice

Pieces = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Window:
    """Where a printed number comes out.

    Attributes
    ----------
    axis, number : str
        Name of the choice, id of the entry.
    step : str
        Distance of the values that were searched at least, in the choice's unit or in per cent; `pieces` may lack what
        is narrower and where the value turns round too sharply to be seen from its neighbours.
    others : tuple of (str, str)
        Axis and option of the other choices that move it.
    pieces : tuple of (float, float)
        In the choice's unit, ascending; empty where it comes out nowhere in the range.
    """

    axis: str
    number: str
    step: str
    others: tuple[tuple[str, str], ...]
    pieces: Pieces


@dataclass(frozen=True)
class Setting:
    """One option of one choice.

    Attributes
    ----------
    axis, option : str
    best : bool
        Whether it is that of the best joint settings.
    agree : int
        How many numbers agree at once with it, at most.
    supports, contradicts : tuple of str
        Numbers that agree with it and not with every computed option; that were computed with it and agree with
        another option alone.
    indifferent : int
        Numbers that its choice touches and that agree with every computed option, or with none.
    """

    axis: str
    option: str
    best: bool
    agree: int
    supports: tuple[str, ...]
    contradicts: tuple[str, ...]
    indifferent: int


@dataclass(frozen=True)
class Joint:
    """The best joint settings of a paper.

    Attributes
    ----------
    agree, numbers : int
        Printed numbers that agree at once, of how many.
    settings : tuple of Setting
    lost, never : tuple of str
        Numbers that agree under other settings only; under none that was computed.
    tried, whole : int
        Combinations among which it is the best; those of them for which every number was computed. In the others those
        that were not computed count as not agreeing.
    bound : int
        How many numbers could agree at once, at most, were all that was not computed to agree.
    computed, possible : int
        Combinations of single studies that were computed, and how many there are.
    windows : tuple of Window
    equal : dict of str to dict of str to int
        Of each wording in ``paper.toml`` for choices that are one setting of the paper, how many numbers agree at
        once, at most, by the option that all of these choices have then.
    """

    agree: int
    numbers: int
    settings: tuple[Setting, ...]
    lost: tuple[str, ...]
    never: tuple[str, ...]
    tried: int = 1
    whole: int = 1
    bound: int = 0
    computed: int = 1
    possible: int = 1
    windows: tuple[Window, ...] = ()
    equal: dict[str, dict[str, int]] = field(default_factory=dict)

    @property
    def best(self) -> dict[str, str]:
        """Option of each axis."""
        return {each.axis: each.option for each in self.settings if each.best}

    @property
    def telling(self) -> set[str]:
        """Axes whose options a number tells apart, or with one of which fewer were found to agree at once."""
        return {
            each.axis
            for each in self.settings
            if each.supports or each.contradicts or each.agree < self.agree
        }

    @property
    def explained(self) -> str:
        """What was found where not all agree at once."""
        shown = self.bound < self.numbers
        return "no setting explains all" if shown else "none found among what was computed explains all"


KINDS = {kind.__name__: kind for kind in (Joint, Setting, Window)}


def settings_text(joint: Joint) -> str:
    """Text of ``settings.csv``: a row begins with what it is, and has its fields in order: words as they are, the rest as JSON."""
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n").writerow
    for each in replace(joint, settings=(), windows=()), *joint.settings, *joint.windows:
        cells = (x if isinstance(x, str) else json.dumps(x, ensure_ascii=False) for x in astuple(each))
        write([type(each).__name__, *cells])
    return text.getvalue()


def read_settings(topic: str) -> Joint | None:
    """What was kept of a topic; None where nothing was."""
    file = paths.data(topic, "settings.csv")
    return read_joint(file) if file.exists() else None


def read_joint(file: Path) -> Joint:
    """What was kept in a ``settings.csv``."""
    rows = defaultdict(list)
    for kind, *cells in csv.reader(io.StringIO(file.read_text(encoding="utf-8"))):
        rows[kind].append(_made(KINDS[kind], cells))
    return replace(rows["Joint"][0], settings=tuple(rows["Setting"]), windows=tuple(rows["Window"]))


def _made(kind, cells: list[str]):
    pairs = zip(fields(kind), cells, strict=True)
    return kind(*(text if each.type is str else _frozen(json.loads(text)) for each, text in pairs))


def _frozen(value):
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


def wanted(file: Path, axes: Iterable[str], never: Iterable[str] = ()) -> list[str]:
    """Which printed numbers agree under an option of these choices and not under every one: an option a line.

    Parameters
    ----------
    file : Path
        ``settings.csv`` of a topic, named by ``paths.data``, so that a notebook depends on it.
    axes : iterable of str
        Choices, by their names in ``choices.toml``.
    never : iterable of str
        Beginnings of ids, without their topic: those of them that agree under no computed setting have a line, too.

    Raises
    ------
    InputError
        When the topic has no such choice, or its settings were not searched.
    """
    joint, lines = read_joint(file), []
    for axis in axes:
        require_choice("axes", axis, {each.axis for each in joint.settings})
        for each in (one for one in joint.settings if one.axis == axis):
            names = ", ".join(name.partition(".")[2] for name in each.supports) or "none"
            lines.append(f"{axis} {each.option}{' (best joint)' if each.best else ''}: {names}")
    starts = tuple(never)
    lost = [name for each in joint.never if (name := each.partition(".")[2]).startswith(starts)]
    return lines + ([f"under no computed setting: {', '.join(lost)}"] if starts and lost else [])
