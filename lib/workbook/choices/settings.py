"""``python -m workbook settings``: which choices explain the most printed numbers of a paper at once.

A paper has one machine, one noise, one definition: axes are shared by name over all studies of a topic. What agrees by
this search is calibrated, never predicted, and the count of tries stands beside it.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise, product

import numpy as np

from workbook import paths
from workbook.checks import InputError, read_toml, require_choice
from workbook.choices.axes import load_axes, load_digits, option_text
from workbook.choices.judging import judge
from workbook.choices.kept import Joint, Setting, Window, settings_text
from workbook.choices.results import read_results
from workbook.choices.running import Journal, design
from workbook.choices.windows import meet, windows_of
from workbook.claims import Entry, Tolerance, ledger, load_entries
from workbook.lock import held
from workbook.publish import replace_file
from workbook.workers import cores, processes

LARGEST = 5e7  # combinations of the choices that are linked at a time, while one of them is maximised out
AGREES = 1000  # of a score, whose rest counts the choices that differ from their defaults

Table = tuple[tuple[str, ...], np.ndarray]


@dataclass(frozen=True)
class Number:
    """A printed number: under which settings of the choices that touch it ours agrees.

    Attributes
    ----------
    id : str
    axes : tuple of str
    agrees : ndarray of int8, an axis for each of `axes`
        1 where it agrees, 0 where it does not, -1 where that was not computed.
    """

    id: str
    axes: tuple[str, ...]
    agrees: np.ndarray

    def by(self, axis: str) -> np.ndarray:
        """`agrees` with a row for each option of one of its axes."""
        rows = np.moveaxis(self.agrees, self.axes.index(axis), 0)
        return rows.reshape(len(rows), -1)

    def at(self, places: dict[str, int]) -> bool:
        return bool(self.agrees[tuple(places[axis] for axis in self.axes)] == 1)


def printed_entries(topic: str) -> dict[str, Entry]:
    """The ledger with the tolerance of the printed digits, where choices.toml has that beside a wider one."""
    entries = load_entries(topic)
    for name, half in load_digits(topic).items():
        digits = Tolerance("half the last printed digit", absolute=half)
        entries[name] = replace(entries[name], tolerance=digits)
    return entries


def compute_settings(topic: str | None = None, *, jobs: int | None = None) -> list[str]:
    """Search the windows that the journal lacks, then the best joint settings; write them, and return the report's lines."""
    lines = []
    for each in paths.topics() if topic is None else [paths.require_topic(topic)]:
        _, multiverses = load_axes(each)
        journal = Journal(paths.root() / "build" / "choices" / f"{each}-windows.jsonl")
        running = "settings or combinations of this checkout are being tried; wait for them or stop them"
        with held("choices/lock", running), processes(jobs or cores()) as pool:
            windows = windows_of(multiverses, printed_entries(each), pool, journal)
        joint = joint_settings(each, windows)
        if joint.numbers:
            replace_file(paths.data(each, "settings.csv"), settings_text(joint).encode())
            lines += report(each, joint)
    return lines


def joint_settings(topic: str, windows: Sequence[Window]) -> Joint:
    """The best joint settings by the committed combinations and these windows."""
    axes, multiverses = load_axes(topic)
    options = {axis.name: list(axis.texts) for axis in axes.values() if axis.kind != "seed"}
    defaults = {axis: axes[axis].default_index for axis in options}
    untried = _said(topic, "untried", options)
    named = [where.split(" = ") for where in untried if " = " in where]
    for axis, text in [*(pair for each in windows for pair in each.others), *_between(windows), *named]:
        options[axis] += [text] * (text not in options[axis])
    known = (_with_windows(number, windows, options) for number in _numbers(topic))
    numbers = [_untried(number, untried, options, defaults) for number in known]
    joint = best_joint(numbers, options, defaults)
    shown = [each for each in joint.settings if each.best or each.option in axes[each.axis].texts]
    return replace(
        joint,
        settings=tuple(shown),
        bound=most_at_best(numbers),
        windows=tuple(windows),
        computed=sum(len(design(each)) for each in multiverses),
        possible=sum(each.size for each in multiverses),
        equal={
            says: as_one(mine, numbers, options, defaults)
            for says, mine in _said(topic, "equal", options).items()
        },
    )


def _said(topic: str, name: str, options: Iterable[str]) -> dict[str, list[str]]:
    """What ``paper.toml`` says of several choices: ``equal``, which are one setting; ``untried``, of which numbers."""
    file = paths.data(topic, "paper.toml")
    given = read_toml(file).get(name, {}) if file.exists() else {}
    for axis in given if name == "untried" else (each for mine in given.values() for each in mine):
        require_choice(f"{file}: {name}", axis.partition(" = ")[0], options)
    return given


def _untried(number: Number, untried: dict, options: dict, defaults: dict[str, int]) -> Number:
    """With the choices that move it and that its study holds: known at their defaults, or the option named, alone."""
    for where, begins in untried.items():
        axis, _, option = where.partition(" = ")
        if axis not in number.axes and any(f"{number.id}.".startswith(f"{each}.") for each in begins):
            table = np.full((*number.agrees.shape, len(options[axis])), -1, np.int8)
            table[..., options[axis].index(option) if option else defaults[axis]] = number.agrees
            number = Number(number.id, (*number.axes, axis), table)
    return number


def _numbers(topic: str) -> list[Number]:
    """What the ledger judges, by the committed combinations."""
    axes, multiverses = load_axes(topic)
    entries = printed_entries(topic)
    claims = {each.entry.id: replace(each, entry=entries[each.entry.id]) for each in ledger(topic=topic)}
    numbers = []
    for name, one in judge(read_results(multiverses), entries, axes, claims).items():
        if not one.entry.is_replication or replace(claims[name], over=one).verdict == "not judged":
            continue
        known = ~one.failed
        agrees = (2 * one.agrees.sum(axis=1) >= known.sum(axis=1)) & known.any(axis=1)
        table = np.full([len(axis.texts) for axis in one.options], -1, np.int8)
        table[(..., *np.array(one.settings, int).reshape(len(agrees), -1).T)] = agrees
        numbers.append(Number(name, tuple(axis.name for axis in one.options), table))
    return numbers


def _between(windows: Iterable[Window]) -> Iterable[tuple[str, str]]:
    """One value of each axis in every cell between neighbouring ends of its windows, with as few digits as tell it apart."""
    ends = defaultdict(set)
    for each in windows:
        ends[each.axis] |= {end for piece in each.pieces for end in piece}
    return ((axis, option_text(_short(*cell))) for axis in ends for cell in pairwise(sorted(ends[axis])))


def _short(low: float, high: float) -> float:
    middle = (low + high) / 2
    return next((x for d in range(1, 9) if low < (x := float(f"{middle:.{d}g}")) < high), middle)


def _with_windows(number: Number, windows: Iterable[Window], options: dict[str, list[str]]) -> Number:
    """With all options of its axes, the declared ones first, of which its windows decide where none was computed."""
    more = [(0, len(options[a]) - k) for a, k in zip(number.axes, number.agrees.shape, strict=True)]
    table = np.pad(number.agrees, more, constant_values=-1) if more else number.agrees
    for each in (one for one in windows if one.number == number.id):
        held = dict(each.others)
        at = tuple(
            options[axis].index(held[axis]) if axis in held else slice(None)
            for axis in number.axes
            if axis != each.axis
        )
        rows = np.moveaxis(table, number.axes.index(each.axis), 0)
        for k, text in enumerate(options[each.axis]):
            inside = any(low <= float(text) <= high for low, high in each.pieces)
            rows[k, *at] = np.where(rows[k, *at] < 0, inside, rows[k, *at])
    return replace(number, agrees=table)


# === Most numbers at once =========================================================================================


def best_joint(numbers: list[Number], options: dict[str, list[str]], defaults: dict[str, int]) -> Joint:
    """Most numbers at once; among equals the settings nearest to the defaults.

    Parameters
    ----------
    numbers : list of Number
    options : dict of str to list of str
        By axis.
    defaults : dict of str to int
        Places of the options.

    Returns
    -------
    Joint
        Of all combinations of choices that numbers link: one choice after the other is maximised out.
    """
    moving = [_without_idle(number) for number in numbers]
    best, loses, tried, whole = dict(defaults), {}, 0, 0
    for names in _linked(moving):
        mine = [number for number in moving if number.axes and number.axes[0] in names]
        moved = {
            (axis,): -np.not_equal(range(len(options[axis])), defaults[axis]).astype(np.int32)
            for axis in names
        }
        scores = _summed(mine, AGREES, moved)
        score, places = eliminate(list(scores.items()), np.add, np.max)
        best |= places
        for axis in names:
            held = (_held(scores, axis, k) for k in range(len(options[axis])))
            loses[axis] = [_agreeing(score) - _agreeing(eliminate(each, np.add, np.max)[0]) for each in held]
        tried += math.prod(len(options[axis]) for axis in names)
        known = [(each.axes, (each.agrees >= 0).astype(np.int64)) for each in mine]
        whole += eliminate(known, np.multiply, np.sum)[0]
    agree = sum(number.at(best) for number in numbers)
    settings = []
    for axis, texts in options.items():
        touched = {each.id: each.by(axis).max(axis=1) for each in numbers if axis in each.axes}
        divided = {name: under for name, under in touched.items() if {0, 1} <= {*under.tolist()}}
        for k, text in enumerate(texts):
            supports = tuple(name for name, under in divided.items() if under[k] == 1)
            contradicts = tuple(name for name, under in divided.items() if under[k] == 0)
            most, rest = agree - loses.get(axis, [0] * len(texts))[k], len(touched) - len(divided)
            settings.append(Setting(axis, text, k == best[axis], most, supports, contradicts, rest))
    never = tuple(number.id for number in numbers if not (number.agrees == 1).any())
    lost = tuple(n.id for n in numbers if not n.at(best) and n.id not in never)
    return Joint(agree, len(numbers), tuple(settings), lost, never, max(tried, 1), max(whole, 1))


def most_at_best(numbers: list[Number]) -> int:
    """How many numbers agree at once at most, what was not computed taken as agreeing."""
    hoped = [replace(number, agrees=(number.agrees != 0).astype(np.int8)) for number in numbers]
    scores = _summed(map(_without_idle, hoped), 1, {(): np.zeros((), np.int32)})
    return int(eliminate(list(scores.items()), np.add, np.max)[0])


def _summed(numbers: Iterable[Number], weight: int, start: dict) -> dict[tuple[str, ...], np.ndarray]:
    """A table for each set of choices: `weight` for every number of it that agrees, beside those of `start`."""
    scores = dict(start)
    for each in numbers:
        scores[each.axes] = np.asarray(scores.get(each.axes, 0) + np.int32(weight) * (each.agrees == 1))
    return scores


def _agreeing(score) -> int:
    return -(-int(score) // AGREES)


def _without_idle(number: Number) -> Number:
    """Without the choices that do not move it, where all its settings were computed."""
    axes, table = number.axes, number.agrees
    for axis in axes if (table >= 0).all() else ():
        place = axes.index(axis)
        if (table == table.take([0], place)).all():
            axes, table = (*axes[:place], *axes[place + 1 :]), table[(*[slice(None)] * place, 0, ...)]
    return Number(number.id, axes, table)


def _linked(numbers: list[Number]) -> list[list[str]]:
    """Choices that some number needs together, directly or over others."""
    groups: list[list[str]] = []
    for number in numbers:
        if number.axes:
            joined = [group for group in groups if set(group) & set(number.axes)]
            groups = [group for group in groups if group not in joined]
            groups.append(list(dict.fromkeys(sum(joined, [*number.axes]))))
    return groups


def _held(tables: dict[tuple[str, ...], np.ndarray], axis: str, place: int) -> list[Table]:
    """With one option of an axis alone."""
    return [(a, t.take([place], a.index(axis)) if axis in a else t) for a, t in tables.items()]


def eliminate(tables: Sequence[Table], join: Callable, over: Callable) -> tuple[int, dict[str, int]]:
    """Join all tables, each an array with its axes' names, and reduce over all axes, one after the other.

    What is reduced at a time has the axes that tables share with one, not all: the largest sum over fifty choices is
    found exactly without a table of all their combinations.

    Parameters
    ----------
    tables : sequence of (tuple of str, ndarray)
    join : callable
        ``np.add`` or ``np.multiply``.
    over : callable
        ``np.max`` or ``np.sum``; the join is distributive over it.

    Returns
    -------
    tuple of int and dict
        The result; of a maximum, the place on each axis that has it.

    Raises
    ------
    InputError
        When too many choices are linked at a time.
    """
    steps, waiting = [], list(tables)
    while names := sorted({axis for axes, _ in waiting for axis in axes}):
        sizes = {a: size for axes, table in waiting for a, size in zip(axes, table.shape, strict=True)}
        beside = {name: {a for axes, _ in waiting if name in axes for a in axes} - {name} for name in names}
        name = min(names, key=lambda name: sizes[name] * math.prod(sizes[a] for a in beside[name]))
        axes = (name, *sorted(beside[name]))
        if math.prod(sizes[a] for a in axes) > LARGEST:
            raise InputError(
                f"the choices {', '.join(axes)} are too many that numbers link; declare fewer options"
            )
        table = reduce(join, (_spread(each, axes) for each in waiting if name in each[0]))
        waiting = [each for each in waiting if name not in each[0]] + [(axes[1:], over(table, axis=0))]
        steps.append((axes, table))
    places: dict[str, int] = {}
    for axes, table in reversed(steps):
        places[axes[0]] = int(table[(slice(None), *(places[a] for a in axes[1:]))].argmax())
    return int(reduce(join, (table for _, table in waiting))), places


def _spread(table: Table, axes: tuple[str, ...]) -> np.ndarray:
    """With these axes, of size 1 where it has none."""
    mine, values = table
    order = [mine.index(axis) for axis in axes if axis in mine]
    return values.transpose(order).reshape([values.shape[mine.index(a)] if a in mine else 1 for a in axes])


def as_one(axes: Sequence[str], numbers: list[Number], options, defaults) -> dict[str, int]:
    """How many numbers agree at once, at most, where these axes have the same option; by the options that all of them have."""
    grid = np.array(np.meshgrid(*(options[axis] for axis in axes), indexing="ij"))
    same = Number("", tuple(axes), (grid == grid[0]).all(axis=0).astype(np.int8))
    many = len(numbers) + 1  # what is worth more than all numbers is not given up for them
    joint = best_joint([*numbers, *[same] * many], options, defaults)
    first = [each for each in joint.settings if each.axis == axes[0]]
    return {each.option: each.agree - many for each in first if each.agree >= many}


# === Shown ===============================================================================================


@dataclass(frozen=True)
class Meeting:
    """Windows of several numbers on one axis, the other choices held; `pieces` is where they all meet."""

    axis: str
    others: dict[str, str]
    windows: tuple[Window, ...] = ()
    pieces: tuple[tuple[float, float], ...] = ((-math.inf, math.inf),)


def meetings(windows: Iterable[Window]) -> list[Meeting]:
    """The windows of each axis, together for every setting of the other choices."""
    groups = defaultdict(lambda: defaultdict(list))
    for each in windows:
        groups[each.axis][each.number].append(each)
    found = []
    for axis, by_number in groups.items():
        joined = [Meeting(axis, {})]
        for mine in by_number.values():
            pairs = product(joined, mine)
            joined = [
                Meeting(axis, m.others | dict(w.others), (*m.windows, w), tuple(meet(m.pieces, w.pieces)))
                for m, w in pairs
                if all(m.others.get(k, o) == o for k, o in w.others)
            ]
        found += joined
    return found


def report(topic: str, joint: Joint) -> list[str]:
    """The result as lines of text."""
    all_ = "all" if joint.agree == joint.numbers else f"{joint.explained}: {joint.agree} of"
    lines = [
        f"{topic}: {all_} {joint.numbers} printed numbers agree at once, calibrated among {joint.tried} combinations",
        f"at most {joint.bound} could, were what was not computed to agree",
        f"put together from {joint.computed} of {joint.possible} combinations of single studies; "
        f"for {joint.whole} every number was computed, in the others what was not counts as not agreeing",
        f"{len(joint.lost)} agree under other settings only, {len(joint.never)} under none that was computed",
    ]
    for says, by_option in joint.equal.items():
        each = ", ".join(f"{agree} with {option}" for option, agree in by_option.items())
        lines.append(f"with {says} in all of the paper at most {each}")
    telling = (each for each in joint.settings if each.best and each.axis in joint.telling)
    best = ", ".join(f"{each.axis} {each.option}" for each in telling)
    return [
        *lines,
        f"best with {best or 'any settings'}; data/{topic}/settings.csv and the site have all of it",
    ]


def ranges(pieces: Iterable[tuple[float, float]]) -> str:
    """Pieces of a range in words."""
    return " and ".join(f"{low:.12g} to {high:.12g}" for low, high in pieces) or "nowhere"
