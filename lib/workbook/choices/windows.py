"""For which values of a continuous choice a printed number comes out: windows, by root finding on the number's own study."""

import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise, product

import numpy as np

from workbook.choices.axes import POINTS, Axis, Multiverse
from workbook.choices.kept import Pieces, Window
from workbook.choices.notebook_study import study_digest
from workbook.choices.running import Journal, calls_at, compute
from workbook.claims import Entry
from workbook.progress import Progress

HALVINGS = 3  # of a cell in which a value may turn round, at most, before its turn is searched
TRIES = 12  # of a value at a turn
FITS = 3  # of a study whose values join the options of its choices
FAR = 1e6  # tolerances from the printed number, at most; where a study fails, too
DIGITS, KEPT = 5, 0.99  # of a window's ends, at least; share of it that rounding leaves
LOGARITHMIC = 50  # ratio of the ends of a range from which on it is divided by ratios


def windows_of(
    multiverses: list[Multiverse], entries: dict[str, Entry], pool, journal: Journal
) -> list[Window]:
    """Windows of all judged numbers on every axis with a range in their study, without the choices that do not move them.

    Parameters
    ----------
    multiverses : list of Multiverse
        Of one topic.
    entries : dict of str to Entry
        With the tolerance of their printed digits.
    pool : concurrent.futures.Executor
    journal : Journal
        What it holds is not searched again.
    """
    starts = _fits(multiverses, entries)
    _run(fit, starts, pool, journal, "fit")
    fitted = [
        _with_options(each, [journal.found[k] for k in starts if starts[k][0] is each])
        for each in multiverses
    ]
    tasks = searches(multiverses, entries) | searches(fitted, entries)
    _run(search_window, tasks, pool, journal, "window")
    found = []
    for key, (multiverse, axis, point, _) in tasks.items():
        texts = {each.name: each.texts[k] for each, k in zip(multiverse.axes, point, strict=True)}
        for name, pieces in journal.found[key].items():
            others = [k for k in texts if k in multiverse.touched[name] and k != axis.name]
            held = tuple((other, texts[other]) for other in others)
            found.append(Window(axis.name, name, _step(multiverse, axis), held, tuple(map(tuple, pieces))))
    return _without_idle(list(dict.fromkeys(found)))


def _run(function, tasks: Mapping[str, tuple], pool, journal: Journal, unit: str) -> None:
    missing = [key for key in tasks if key not in journal.found]
    with Progress(len(missing), task="settings", unit=unit, tenths=True) as progress:
        running = {pool.submit(function, *tasks[key]): key for key in missing}
        for future in as_completed(running):
            journal.add(running[future], future.result())
            progress.step()


def _key(multiverse: Multiverse, point: tuple[int, ...], entries: list[Entry], *more) -> str:
    """Under which a journal keeps what was found of these entries at a point."""
    facts = [study_digest(multiverse.function), repr(entries), multiverse.options(point), multiverse.seeds]
    return hashlib.sha256(
        json.dumps([facts, HALVINGS, TRIES, multiverse.windows, *more]).encode()
    ).hexdigest()


def _fits(multiverses: list[Multiverse], entries: dict[str, Entry]) -> dict[str, tuple]:
    """Arguments of `fit` for the studies in which several choices have a range, by the key of what it finds.

    These choices begin at their first options, and at their last ones, for each setting of the others.
    """
    tasks = {}
    for multiverse in multiverses:
        judged = [entries[name] for name in multiverse.entries if entries[name].is_replication]
        values = [each for each in judged if each.kind == "value" and each.better is None]
        mine = [each for each in values if each.tolerance.interval is None]
        ranged = [k for k, axis in enumerate(multiverse.axes) if axis.name in multiverse.windows]
        ends = {tuple(0 for _ in ranged), tuple(len(multiverse.axes[k].texts) - 1 for k in ranged)}
        points = _points(multiverse, "", multiverse.entries) if mine and len(ranged) > 1 else ()
        for point in (each for each in points if tuple(each[k] for k in ranged) in ends):
            tasks[_key(multiverse, point, mine, "fit")] = (multiverse, point, mine)
    return tasks


def _with_options(multiverse: Multiverse, fits: list) -> Multiverse:
    """With the values of the fits by which most numbers agree among its options."""
    best = sorted(fits, key=lambda found: -found["agree"])[:FITS]
    axes = []
    for axis in multiverse.axes:
        more = [found["values"][axis.name] for found in best if axis.name in found["values"]]
        axes.append(replace(axis, options=tuple(dict.fromkeys((*axis.options, *more)))))
    return replace(multiverse, axes=tuple(axes))


def searches(multiverses: list[Multiverse], entries: dict[str, Entry]) -> dict[str, tuple]:
    """Arguments of `search_window` for all windows, by the key under which a journal keeps what it found."""
    tasks = {}
    for multiverse in multiverses:
        for axis in (each for each in multiverse.axes if each.name in multiverse.windows):
            touched = [name for name in multiverse.entries if axis.name in multiverse.touched[name]]
            judged = [entries[name] for name in touched if entries[name].kind != "reported"]
            mine = [entry for entry in judged if entry.is_replication]
            for point in _points(multiverse, axis.name, touched) if mine else ():
                tasks[_key(multiverse, point, mine, axis.name)] = (multiverse, axis, point, mine)
    return tasks


def _points(multiverse: Multiverse, name: str, touched: Sequence[str]) -> list[tuple[int, ...]]:
    """Settings of the other axes that touch these entries, the rest at the default; of many that of the default alone."""
    touching = {axis for entry in touched for axis in multiverse.touched[entry]} - {name}
    places = [range(len(a.texts)) if a.name in touching else (a.default_index,) for a in multiverse.axes]
    return list(product(*places)) if math.prod(map(len, places)) <= POINTS else [multiverse.default_point]


def search_window(multiverse: Multiverse, axis: Axis, point: tuple[int, ...], entries: list[Entry]) -> dict:
    """Pieces of the axis' range in which each entry agrees, the other choices at `point`; by id."""
    calls = calls_at(multiverse, [point]).values()

    @cache
    def outside(x: float) -> dict[str, tuple[float, float]]:
        found = [compute(replace(call, options=call.options | {axis.keyword: x})) for call in calls]
        given = [each for each in found if not isinstance(each, str)]
        return {entry.id: _outside(entry, [each[entry.id] for each in given]) for entry in entries}

    grid = _grid(multiverse, axis)
    return {entry.id: pieces_of(lambda x, name=entry.id: outside(x)[name], grid) for entry in entries}


def _grid(multiverse: Multiverse, axis: Axis) -> list[float]:
    low, high, cells = multiverse.windows[axis.name]
    spaced = np.geomspace if 0 < LOGARITHMIC * low < high else np.linspace
    return spaced(low, high, cells + 1).tolist()


def _step(multiverse: Multiverse, axis: Axis) -> str:
    first, second, third, *_ = _grid(multiverse, axis)
    even = math.isclose(second - first, third - second)
    return f"{second - first:.3g}" if even else f"{100 * (second / first - 1):.2g} %"


def pieces_of(outside: Callable[[float], tuple[float, float]], grid: list[float]) -> Pieces:
    """Where a number agrees.

    Parameters
    ----------
    outside : callable
        By how much it lies above and below what agrees; both at most 0 where it agrees.
    grid : list of float
        Values between which roots are searched, ascending. Cells in which a side may turn round, by the bend of the
        values around, are halved first.

    Returns
    -------
    tuple of (float, float)
        The number agrees at both ends and in the middle of each piece, and at no searched value beside them; where
        a middle disagrees, the piece is searched again in two parts.
    """
    outside, asked = cache(outside), set(grid)

    def excess(side: int, x: float) -> float:
        asked.add(float(x))
        return outside(float(x))[side]

    for halving in range(HALVINGS + 1):
        for low, high, side in list(_turning(sorted(asked), outside)):
            if halving < HALVINGS:
                asked.add((low + high) / 2)
            else:
                _turn(partial(excess, side), low, high)
    for _ in range(2 * HALVINGS):
        known = sorted(asked)
        pieces = meet(*(_side(partial(excess, side), known) for side in (0, 1)))
        ends = [grid[0], *(end for piece in pieces for end in piece), grid[-1]]
        asked |= {(one + two) / 2 for one, two in pairwise(ends)}
        agree = {x: max(outside(x)) <= 0 for x in asked}
        if all(inside == any(low <= x <= high for low, high in pieces) for x, inside in agree.items()):
            break
    return tuple(_rounded(outside, grid, *piece) for piece in pieces if agree[sum(piece) / 2])


def _turning(known: list[float], outside) -> Iterable[tuple[float, float, int]]:
    """Cells between whose ends a side keeps its sign, but lies nearer to 0 than the bend beside them; and the side."""
    x, excess = np.array(known)[:, None], np.array([outside(x) for x in known])
    share = (x[1:-1] - x[:-2]) / (x[2:] - x[:-2])
    bend = np.abs(excess[1:-1] - (1 - share) * excess[:-2] - share * excess[2:])
    bend = np.maximum(np.vstack([bend[:1], bend]), np.vstack([bend, bend[-1:]]))
    near = np.minimum(np.abs(excess[:-1]), np.abs(excess[1:]))
    cells = ((excess[:-1] > 0) == (excess[1:] > 0)) & (near < bend)
    return ((known[k], known[k + 1], side) for k, side in np.argwhere(cells).tolist())


def _turn(excess: Callable[[float], float], low: float, high: float) -> None:
    """Ask for the values around a turn within a cell: the largest one where its ends agree, else the smallest."""
    from scipy.optimize import minimize_scalar

    sign = 1 if excess(low) > 0 else -1
    minimize_scalar(lambda x: sign * excess(x), bounds=(low, high), options={"maxiter": TRIES})


def _side(excess: Callable[[float], float], searched: list[float]) -> list[tuple[float, float]]:
    """Where one side is at most 0, with ends where it still is."""
    from scipy.optimize import elementwise

    accuracy = {"xatol": 1e-6 * (searched[-1] - searched[0])}
    signed = np.vectorize(lambda x: excess(float(x)) or -1e-300, otypes=[float])  # 0 agrees, too
    ends = [searched[0]] if excess(searched[0]) <= 0 else []
    for one, two in pairwise(searched):
        if (excess(one) <= 0) != (excess(two) <= 0):
            root = elementwise.find_root(signed, (one, two), tolerances=accuracy)
            ends.append(float(root.bracket[int(root.f_bracket[1] < 0)]))
    ends += [searched[-1]] if excess(searched[-1]) <= 0 else []
    return list(zip(ends[::2], ends[1::2], strict=True))


def _rounded(outside, grid: list[float], low: float, high: float) -> tuple[float, float]:
    """Rounded to the inside, to digits that leave nearly all of it and with which the number agrees."""
    least = 1e-3 * (grid[-1] - grid[0])
    for digits in range(DIGITS, 13):
        ends = []
        for x, to in ((low, math.ceil), (high, math.floor)):
            places = digits - 1 - math.floor(math.log10(max(abs(x), least)))
            ends.append(x if x in grid else round(to(round(x * 10**places, 3)) / 10**places, places) + 0.0)
        if ends[1] - ends[0] >= KEPT * (high - low) and max(outside(ends[0]) + outside(ends[1])) <= 0:
            return tuple(ends)
    return low, high


def meet(first, second) -> list[tuple[float, float]]:
    """Pieces that two lists of pieces share."""
    both = ((max(a, c), min(b, d)) for (a, b), (c, d) in product(first, second))
    return [(low, high) for low, high in both if low <= high]


def fit(multiverse: Multiverse, point: tuple[int, ...], entries: list[Entry]) -> dict:
    """Least squares from `point` over all choices with a range: how many numbers agree, and the choices' values by name.

    A number's distance is in tolerances; a far one counts little.
    """
    from scipy.optimize import least_squares

    calls = calls_at(multiverse, [point]).values()
    axes = [axis for axis in multiverse.axes if axis.name in multiverse.windows]
    grids = [_grid(multiverse, axis) for axis in axes]
    shares = [np.linspace(0, 1, len(grid)) for grid in grids]

    def at(x: np.ndarray) -> list[float]:
        return [float(np.interp(*each)) for each in zip(x, shares, grids, strict=True)]

    def distances(x: np.ndarray) -> np.ndarray:
        moved = {axis.keyword: value for axis, value in zip(axes, at(x), strict=True)}
        found = [compute(replace(call, options=call.options | moved)) for call in calls]
        given = [each for each in found if not isinstance(each, str)]
        sides = np.array([_outside(entry, [each[entry.id] for each in given]) for entry in entries])
        off = (sides[:, 0] - sides[:, 1]) / 2 / [entry.tolerance.width(entry.published) for entry in entries]
        return np.clip(off, -FAR, FAR)

    options = multiverse.options(point)
    start = [np.interp(options[a.keyword], g, s) for a, g, s in zip(axes, grids, shares, strict=True)]
    start = np.clip(start, 1e-3, 1 - 1e-3)  # inside its bounds
    found = least_squares(distances, start, bounds=(0, 1), loss="soft_l1", diff_step=1e-4)
    named = {axis.name: float(f"{x:.{DIGITS}g}") for axis, x in zip(axes, at(found.x), strict=True)}
    return {"agree": int(np.sum(np.abs(found.fun) <= 1)), "values": named}


def _outside(entry: Entry, values: list) -> tuple[float, float]:
    """How far what the seeds gave lies above and below what agrees with the printed number; both at most 0 where it agrees."""
    from workbook.studies import spread_interval

    ends = [value[1] if isinstance(value, tuple | list) else (value, value) for value in values]
    middle = [value[0] if isinstance(value, tuple | list) else value for value in values]
    if not values or not np.isfinite(middle).all():
        return FAR, -FAR
    aim = 1.0 if entry.published is None else entry.published
    if entry.is_fraction:
        shares = middle if entry.threshold is None else [low for low, _ in ends]
        return -1.0, (entry.threshold or aim) - float(np.median(shares)) or -1.0
    if entry.tolerance.interval is None:
        ours, width = float(np.median(middle)), entry.tolerance.width(aim)
        low, high = ours - width, ours + width
    elif any(low != high for low, high in ends) or len(values) < 2:
        low, high = np.median(ends, axis=0)
    else:
        low, high = spread_interval(np.array(middle), entry.tolerance.interval)
    above, below = float(low - aim), float(aim - high)
    return -1.0 if entry.better == "larger" else above, -1.0 if entry.better == "smaller" else below


def _without_idle(windows: list[Window]) -> list[Window]:
    """Of each number on each axis one window a setting of those other choices that move it."""
    groups = defaultdict(list)
    for each in windows:
        groups[each.axis, each.number].append(each)
    kept = []
    for mine in groups.values():
        for name in [name for name, _ in mine[0].others]:
            less = [replace(each, others=tuple(o for o in each.others if o[0] != name)) for each in mine]
            settled = len({each.others for each in less}) == len(set(less))
            if settled and len({dict(each.others)[name] for each in mine}) > 1:  # else it was held
                mine = list(dict.fromkeys(less))
        kept += mine
    return kept
