"""``settings.csv`` of a topic: the best joint settings, and which printed number wants which option."""

import csv
import io
import json
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
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
    others : tuple of (str, str)
        Axis and option of the other choices that move it.
    pieces : tuple of (float, float)
        In the choice's unit, ascending; empty where it comes out nowhere in the range.
    """

    axis: str
    number: str
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
        Numbers that agree with it and not with every option; that agree with another option alone.
    indifferent : int
        Numbers that its choice touches and that agree with every option, or with none.
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
    tried : int
        Combinations among which it is the best.
    settings : tuple of Setting
    lost, never : tuple of str
        Numbers that agree under other settings only; that no setting explains.
    windows : tuple of Window
    """

    agree: int
    numbers: int
    tried: int
    settings: tuple[Setting, ...]
    lost: tuple[str, ...]
    never: tuple[str, ...]
    windows: tuple[Window, ...] = ()

    @property
    def best(self) -> dict[str, str]:
        """Option of each axis."""
        return {each.axis: each.option for each in self.settings if each.best}


def settings_text(joint: Joint) -> str:
    """Text of ``settings.csv``: a row begins with what it is."""
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n").writerow
    write(["joint", joint.agree, joint.numbers, joint.tried])
    for each in joint.settings:
        lists = [" ".join(each.supports), " ".join(each.contradicts)]
        write(["setting", each.axis, each.option, int(each.best), each.agree, *lists, each.indifferent])
    for kind, names in {"lost": joint.lost, "never": joint.never}.items():
        for name in names:
            write([kind, name])
    for each in joint.windows:
        held = json.dumps(dict(each.others), ensure_ascii=False)
        write(["window", each.axis, each.number, held, *(end for piece in each.pieces for end in piece)])
    return text.getvalue()


def read_settings(topic: str) -> Joint | None:
    """What was kept of a topic; None where nothing was."""
    file = paths.data(topic, "settings.csv")
    return read_joint(file) if file.exists() else None


def read_joint(file: Path) -> Joint:
    """What was kept in a ``settings.csv``."""
    rows = defaultdict(list)
    for kind, *row in csv.reader(io.StringIO(file.read_text(encoding="utf-8"))):
        rows[kind].append(row)
    settings = [
        Setting(axis, option, best == "1", int(agree), tuple(yes.split()), tuple(no.split()), int(rest))
        for axis, option, best, agree, yes, no, rest in rows["setting"]
    ]
    windows = [
        Window(axis, number, tuple(json.loads(held).items()), tuple(zip(ends[::2], ends[1::2], strict=True)))
        for axis, number, held, *texts in rows["window"]
        for ends in [[float(text) for text in texts]]
    ]
    lost, never = (tuple(name for (name,) in rows[kind]) for kind in ("lost", "never"))
    agree, numbers, tried = map(int, rows["joint"][0])
    return Joint(agree, numbers, tried, tuple(settings), lost, never, tuple(windows))


def wanted(file: Path, axes: Iterable[str], never: Iterable[str] = ()) -> list[str]:
    """Which printed numbers agree under an option of these choices and not under every one: an option a line.

    Parameters
    ----------
    file : Path
        ``settings.csv`` of a topic, named by ``paths.data``, so that a notebook depends on it.
    axes : iterable of str
        Choices, by their names in ``choices.toml``.
    never : iterable of str
        Beginnings of ids, without their topic: those of them that agree under no setting have a line, too.

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
    return lines + ([f"under no setting: {', '.join(lost)}"] if starts and lost else [])
