"""``python -m workbook settings``: which choices explain the most printed numbers of a paper at once.

A paper has one machine, one noise, one definition: axes are shared by name over all studies of a topic. What agrees by
this search is calibrated, never predicted, and the count of tries stands beside it.
"""

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from workbook import paths
from workbook.choices.axes import load_axes, load_digits, option_text
from workbook.choices.judging import judge
from workbook.choices.kept import Joint, Setting, Window, settings_text
from workbook.choices.results import read_results
from workbook.choices.running import Journal
from workbook.choices.windows import windows_of
from workbook.claims import Entry, Tolerance, ledger, load_entries
from workbook.lock import held
from workbook.publish import replace_file
from workbook.workers import cores, processes

FACTORIAL = 5e7  # combinations of linked choices up to which all are tried
RESTARTS = 300  # of the search by one choice after the other, beyond


@dataclass(frozen=True)
class Number:
    """A printed number: under which settings of the choices that touch it ours agrees.

    Attributes
    ----------
    id : str
    axes : tuple of str
    agrees : dict of tuple of str to bool
        By the option of each axis; what was not tried is missing.
    """

    id: str
    axes: tuple[str, ...]
    agrees: dict[tuple[str, ...], bool]

    def allowed(self, axis: str) -> set[str]:
        """Options of an axis with which it agrees under some setting of the others."""
        place = self.axes.index(axis)
        return {setting[place] for setting, agrees in self.agrees.items() if agrees}

    def at(self, chosen: dict[str, str]) -> bool:
        return self.agrees.get(tuple(chosen[axis] for axis in self.axes), False)


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


def joint_settings(topic: str, windows: Iterable[Window]) -> Joint:
    """The best joint settings by the committed combinations and these windows."""
    axes, multiverses = load_axes(topic)
    entries = printed_entries(topic)
    claims = {each.entry.id: replace(each, entry=entries[each.entry.id]) for each in ledger(topic=topic)}
    options = {axis.name: list(axis.texts) for axis in axes.values() if axis.kind != "seed"}
    held = (pair for each in windows for pair in each.others)
    between = ((axis, option_text(x)) for axis, values in _between(windows).items() for x in values)
    for axis, text in (*held, *between):
        options[axis] += [text] * (text not in options[axis])
    numbers = []
    for name, one in judge(read_results(multiverses), entries, axes, claims).items():
        if one.agree is None or not one.entry.is_replication:
            continue
        known = ~one.failed
        agrees = (2 * one.agrees.sum(axis=1) >= known.sum(axis=1)) & known.any(axis=1)
        texts = [tuple(a.texts[k] for a, k in zip(one.options, each, strict=True)) for each in one.settings]
        found = Number(
            name, tuple(a.name for a in one.options), dict(zip(texts, agrees.tolist(), strict=True))
        )
        numbers.append(_with_windows(found, [each for each in windows if each.number == name], options))
    defaults = {axis.name: axis.texts[axis.default_index] for axis in axes.values() if axis.name in options}
    for axis, texts in options.items():
        if len(texts) > len(axes[axis].texts):
            options[axis] = _undominated(axis, texts, len(axes[axis].texts), numbers)
            numbers = [_kept(number, axis, options[axis]) for number in numbers]
    joint = best_joint(numbers, options, defaults)
    shown = [each for each in joint.settings if each.best or each.option in axes[each.axis].texts]
    return replace(joint, settings=tuple(shown), windows=tuple(windows))


def _between(windows: Iterable[Window]) -> dict[str, list[float]]:
    """One value of each axis in every cell between neighbouring ends of its windows, with as few digits as tell it apart."""
    ends = defaultdict(set)
    for each in windows:
        ends[each.axis] |= {end for piece in each.pieces for end in piece}
    return {axis: [_short(*cell) for cell in pairwise(sorted(found))] for axis, found in ends.items()}


def _short(low: float, high: float) -> float:
    middle = (low + high) / 2
    return next((x for d in range(1, 9) if low < (x := float(f"{middle:.{d}g}")) < high), middle)


def _with_windows(number: Number, windows: list[Window], options: dict[str, list[str]]) -> Number:
    """With the settings between the declared ones, of which its windows decide."""
    agrees = dict(number.agrees)
    for each in windows:
        place = number.axes.index(each.axis)
        for setting in list(agrees):
            chosen = dict(zip(number.axes, setting, strict=True))
            if all(chosen[axis] == option for axis, option in each.others):
                for text in options[each.axis]:
                    inside = any(low <= float(text) <= high for low, high in each.pieces)
                    agrees.setdefault((*setting[:place], text, *setting[place + 1 :]), inside)
    return replace(number, agrees=agrees)


def _undominated(axis: str, texts: list[str], declared: int, numbers: list[Number]) -> list[str]:
    """The declared options, and of the others those with which more agrees, or other numbers, than with any that is kept."""
    agreeing = {text: set() for text in texts}
    for number in numbers:
        place = number.axes.index(axis) if axis in number.axes else None
        for setting, agrees in number.agrees.items() if place is not None else ():
            if agrees:
                agreeing[setting[place]].add((number.id, *setting[:place], *setting[place + 1 :]))
    kept = texts[:declared]
    for text in sorted(texts[declared:], key=lambda text: -len(agreeing[text])):
        if not any(agreeing[text] <= agreeing[other] for other in kept):
            kept.append(text)
    return kept


def _kept(number: Number, axis: str, texts: list[str]) -> Number:
    """With these options of an axis alone."""
    if axis not in number.axes:
        return number
    place = number.axes.index(axis)
    return replace(number, agrees={each: one for each, one in number.agrees.items() if each[place] in texts})


def best_joint(numbers: list[Number], options: dict[str, list[str]], defaults: dict[str, str]) -> Joint:
    """Most numbers at once; among equals the settings nearest to the defaults.

    Parameters
    ----------
    numbers : list of Number
    options : dict of str to list of str
        By axis.
    defaults : dict of str to str

    Returns
    -------
    Joint
        Every combination is tried of choices that numbers link, where these are at most fifty million; else one choice
        after the other is moved, from the defaults and from hundreds of settings that explain some number.
    """
    reduced = [_without_idle(number, options) for number in numbers]
    best, at_most, tried = dict(defaults), {}, 1
    for names in _linked(reduced):
        mine = [number for number in reduced if number.axes and number.axes[0] in names]
        few = math.prod(len(options[name]) for name in names) <= FACTORIAL
        some, counts, count = (_factorial if few else _climbed)(mine, options, defaults, names)
        best, at_most, tried = best | some, at_most | counts, tried + count
    agree = sum(number.at(best) for number in numbers)
    settings = []
    for axis, texts in options.items():
        touched = [number for number in numbers if axis in number.axes]
        allowed = {number.id: number.allowed(axis) for number in touched}
        divided = {name: found for name, found in allowed.items() if 0 < len(found) < len(texts)}
        top = max(at_most[axis].values(), default=0) if axis in at_most else 0
        for text in texts:
            loses = top - at_most[axis][text] if axis in at_most else 0
            settings.append(
                Setting(
                    axis,
                    text,
                    text == best[axis],
                    agree - loses,
                    tuple(name for name, found in divided.items() if text in found),
                    tuple(name for name, found in divided.items() if text not in found),
                    len(touched) - len(divided),
                )
            )
    never = tuple(number.id for number in numbers if not any(number.agrees.values()))
    lost = tuple(n.id for n in numbers if not n.at(best) and n.id not in never)
    return Joint(agree, len(numbers), tried, tuple(settings), lost, never)


def _without_idle(number: Number, options: dict[str, list[str]]) -> Number:
    """Without the choices that do not move it, where all its settings were tried."""
    if len(number.agrees) < math.prod(len(options[axis]) for axis in number.axes):
        return number
    for axis in number.axes:
        place = number.axes.index(axis)
        less = defaultdict(set)
        for setting, agrees in number.agrees.items():
            less[(*setting[:place], *setting[place + 1 :])].add(agrees)
        if all(len(each) == 1 for each in less.values()):
            rest = (*number.axes[:place], *number.axes[place + 1 :])
            number = Number(number.id, rest, {setting: each.pop() for setting, each in less.items()})
    return number


def _linked(numbers: list[Number]) -> list[list[str]]:
    """Choices that some number needs together, directly or over others."""
    groups: list[list[str]] = []
    for number in numbers:
        if number.axes:
            joined = [group for group in groups if set(group) & set(number.axes)]
            groups = [group for group in groups if group not in joined]
            groups.append(list(dict.fromkeys(sum(joined, [*number.axes]))))
    return groups


def _factorial(numbers: list[Number], options, defaults, names: list[str]):
    """Best settings, most numbers at once with each option, and combinations tried."""
    sizes = [len(options[name]) for name in names]
    counts, moved = np.zeros(sizes, np.int16), np.zeros(sizes, np.int8)
    for number in numbers:
        order = sorted(number.axes, key=names.index)
        table = np.zeros([len(options[axis]) for axis in order], bool)
        for setting, agrees in number.agrees.items():
            chosen = dict(zip(number.axes, setting, strict=True))
            table[tuple(options[axis].index(chosen[axis]) for axis in order)] = agrees
        counts += table.reshape([len(options[name]) if name in order else 1 for name in names])
    for k, name in enumerate(names):
        other = np.array([text != defaults[name] for text in options[name]], np.int8)
        moved += other.reshape([-1 if j == k else 1 for j in range(len(names))])
    places = np.unravel_index(np.argmin(np.where(counts == counts.max(), moved, 127)), sizes)
    best = {name: options[name][k] for name, k in zip(names, places, strict=True)}
    at_most = {}
    for k, name in enumerate(names):
        most = counts.max(axis=tuple(j for j in range(len(names)) if j != k))
        at_most[name] = dict(zip(options[name], most.tolist(), strict=True))
    return best, at_most, counts.size


def _climbed(numbers: list[Number], options, defaults, names: list[str]):
    """As `_factorial`, moving one choice after the other."""
    touching = {name: [number for number in numbers if name in number.axes] for name in names}
    tried = set()

    def climb(chosen: dict[str, str], kept: str = "") -> tuple[int, int, dict[str, str]]:
        before = None
        while before != chosen:
            before = dict(chosen)
            for name in names:
                scores = {}
                for text in options[name] if name != kept else ():
                    other = chosen | {name: text}
                    tried.add(tuple(other.values()))
                    agree = sum(number.at(other) for number in touching[name])
                    scores[text] = (agree, text == defaults[name], text == chosen[name])
                chosen = chosen | ({name: max(scores, key=scores.get)} if scores else {})
        moved = sum(chosen[name] != defaults[name] for name in names)
        return sum(number.at(chosen) for number in numbers), -moved, chosen

    first = {name: defaults[name] for name in names}
    explained = [
        dict(zip(n.axes, s, strict=True)) for n in numbers for s, agrees in n.agrees.items() if agrees
    ]
    drawn = np.random.default_rng(1).permutation(len(explained))[:RESTARTS]
    tops = [climb(first | some) for some in ({}, *(explained[k] for k in drawn))]
    best: dict[str, str] = {}
    while (found := max(tops, key=lambda top: top[:2])[2]) != best:
        best = found
        held = {(name, text): climb(best | {name: text}, name) for name in names for text in options[name]}
        tops = [climb(best), *held.values()]
    at_most = {name: {text: held[name, text][0] for text in options[name]} for name in names}
    return best, at_most, len(tried)


# === Shown ===============================================================================================


@dataclass(frozen=True)
class Meeting:
    """Windows of several numbers on one axis, the other choices held; `pieces` is where they all meet."""

    axis: str
    others: dict[str, str]
    windows: tuple[Window, ...] = ()
    pieces: tuple[tuple[float, float], ...] = ((-math.inf, math.inf),)

    def with_(self, window: Window) -> "Meeting":
        """This and the window of a further number."""
        pairs = product(self.pieces, window.pieces)
        both = tuple((max(a, c), min(b, d)) for (a, b), (c, d) in pairs if max(a, c) <= min(b, d))
        return Meeting(self.axis, self.others | dict(window.others), (*self.windows, window), both)


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
            joined = [m.with_(w) for m, w in pairs if all(m.others.get(k, o) == o for k, o in w.others)]
        found += joined
    return found


def report(topic: str, joint: Joint) -> list[str]:
    """The result as lines of text."""
    all_ = "all" if joint.agree == joint.numbers else f"no setting explains all: {joint.agree} of"
    lines = [
        f"{topic}: {all_} {joint.numbers} printed numbers agree at once, calibrated among {joint.tried} combinations",
        f"{len(joint.lost)} agree under other settings only, {len(joint.never)} under none",
    ]
    for each in joint.settings:
        if each.best and (each.supports or each.contradicts):
            others = [one for one in joint.settings if one.axis == each.axis and not one.best]
            second = max(others, key=lambda one: one.agree, default=None)
            loses = f"; {second.option} loses {joint.agree - second.agree}" if second else ""
            lines.append(
                f"{each.axis} {each.option}: {len(each.supports)} support it, "
                f"{len(each.contradicts)} contradict it, {each.indifferent} do not care{loses}"
            )
    for met in meetings(joint.windows):
        held = ", ".join(f"{name} {option}" for name, option in met.others.items())
        each = "; ".join(f"{one.number} {ranges(one.pieces)}" for one in met.windows)
        lines.append(f"{met.axis} with {held or 'any others'}: {each}; all {ranges(met.pieces)}")
    return lines


def ranges(pieces: Iterable[tuple[float, float]]) -> str:
    """Pieces of a range in words."""
    return " and ".join(f"{low:g} to {high:g}" for low, high in pieces) or "nowhere"
