"""For which values of a continuous choice a printed number comes out: windows, by root finding on the number's own study."""

import hashlib
import json
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import replace
from itertools import pairwise, product

import numpy as np

from workbook.choices.axes import POINTS, Axis, Multiverse
from workbook.choices.kept import Window
from workbook.choices.notebook_study import study_digest
from workbook.choices.running import Journal, calls_at, compute, design
from workbook.claims import Entry
from workbook.progress import Progress

GRID = 24  # values over the range, between which roots are searched
FITS = 3  # of a study whose values join the options of its choices
FAR = 1e6  # tolerances from the printed number, at most
DIGITS = 5  # of a window's ends
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
            found.append(Window(axis.name, name, held, tuple(map(tuple, pieces))))
    return _without_idle(list(dict.fromkeys(found)))


def _run(function, tasks: Mapping[str, tuple], pool, journal: Journal, unit: str) -> None:
    missing = [key for key in tasks if key not in journal.found]
    with Progress(len(missing), task="settings", unit=unit, tenths=True) as progress:
        running = {pool.submit(function, *tasks[key]): key for key in missing}
        for future in as_completed(running):
            journal.add(running[future], future.result())
            progress.step()


def _fits(multiverses: list[Multiverse], entries: dict[str, Entry]) -> dict[str, tuple]:
    """Arguments of `fit` for the studies in which several choices have a range, by the key of what it finds.

    These choices begin at their first options, and at their last ones, for each setting of the others.
    """
    tasks = {}
    for multiverse in multiverses:
        judged = [entries[name] for name in multiverse.entries if entries[name].is_replication]
        two_sided = (each for each in judged if each.kind == "value" and each.better is None)
        mine = [each for each in two_sided if each.tolerance.interval is None]
        ranged = [k for k, axis in enumerate(multiverse.axes) if axis.name in multiverse.windows]
        ends = {tuple(0 for _ in ranged), tuple(len(multiverse.axes[k].texts) - 1 for k in ranged)}
        points = _points(multiverse, "", multiverse.entries) if mine and len(ranged) > 1 else ()
        for point in (each for each in points if tuple(each[k] for k in ranged) in ends):
            facts = ["fit", study_digest(multiverse.function), multiverse.windows, repr(mine)]
            facts += [multiverse.options(point), multiverse.seeds]
            tasks[hashlib.sha256(json.dumps(facts).encode()).hexdigest()] = (multiverse, point, mine)
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
        for axis in multiverse.axes:
            touched = [name for name in multiverse.entries if axis.name in multiverse.touched[name]]
            judged = [entries[name] for name in touched if entries[name].kind != "reported"]
            mine = [entry for entry in judged if entry.is_replication]
            ends = multiverse.windows.get(axis.name)
            for point in _points(multiverse, axis.name, touched) if ends and mine else ():
                facts = [study_digest(multiverse.function), ends, repr(mine)]
                facts += [multiverse.options(point), axis.name, multiverse.seeds]
                key = hashlib.sha256(json.dumps(facts).encode()).hexdigest()
                tasks[key] = (multiverse, axis, point, mine)
    return tasks


def _points(multiverse: Multiverse, name: str, touched: Sequence[str]) -> list[tuple[int, ...]]:
    """Settings of the other axes that touch these entries, the rest at the default; many of them as the study samples them."""
    open_ = [
        a.name != name and any(a.name in multiverse.touched[e] for e in touched) for a in multiverse.axes
    ]
    default = multiverse.default_point
    places = [
        range(len(a.texts)) if o else (k,) for a, o, k in zip(multiverse.axes, open_, default, strict=True)
    ]
    if math.prod(map(len, places)) <= POINTS:
        return list(product(*places))
    return list(
        dict.fromkeys(
            tuple(p if o else k for p, o, k in zip(point, open_, default, strict=True))
            for point in design(multiverse)
        )
    )


def search_window(multiverse: Multiverse, axis: Axis, point: tuple[int, ...], entries: list[Entry]) -> dict:
    """Pieces of the axis' range in which each entry agrees, the other choices at `point`; by id."""
    calls = calls_at(multiverse, [point]).values()
    known: dict[float, list] = {}

    def outside(entry: Entry, side: int, x: float) -> float:
        """By how much ours lies above (side 0) or below (1) what agrees; large where the study fails."""
        if x not in known:
            moved = [replace(call, options=call.options | {axis.keyword: x}) for call in calls]
            known[x] = [compute(call) for call in moved]
        values = [given[entry.id] for given in known[x] if not isinstance(given, str)]
        found = _outside(entry, values)[side] if values else math.nan
        return found if math.isfinite(found) else 1e9

    grid = _grid(multiverse, axis)
    return {
        entry.id: _pieces(lambda side, x, entry=entry: outside(entry, side, x), grid) for entry in entries
    }


def _grid(multiverse: Multiverse, axis: Axis) -> list[float]:
    low, high = multiverse.windows[axis.name]
    spaced = np.geomspace if 0 < LOGARITHMIC * low < high else np.linspace
    return spaced(low, high, GRID + 1).tolist()


def fit(multiverse: Multiverse, point: tuple[int, ...], entries: list[Entry]) -> dict:
    """Least squares from `point` over all choices with a range: how many numbers agree, and the choices' values by name.

    A number's distance is in tolerances; a far one counts little.
    """
    from scipy.optimize import least_squares

    calls = calls_at(multiverse, [point]).values()
    axes = [axis for axis in multiverse.axes if axis.name in multiverse.windows]
    grids, shares = [_grid(multiverse, axis) for axis in axes], np.linspace(0, 1, GRID + 1)

    def at(x: np.ndarray) -> list[float]:
        return [float(np.interp(share, shares, grid)) for share, grid in zip(x, grids, strict=True)]

    def distances(x: np.ndarray) -> np.ndarray:
        moved = {axis.keyword: value for axis, value in zip(axes, at(x), strict=True)}
        found = [compute(replace(call, options=call.options | moved)) for call in calls]
        given = [each for each in found if not isinstance(each, str)]
        if not given:
            return np.full(len(entries), FAR)
        sides = np.array([_outside(entry, [each[entry.id] for each in given]) for entry in entries])
        off = (sides[:, 0] - sides[:, 1]) / 2 / [entry.tolerance.width(entry.published) for entry in entries]
        return np.clip(np.nan_to_num(off, nan=FAR), -FAR, FAR)

    options = multiverse.options(point)
    start = [np.interp(options[axis.keyword], grid, shares) for axis, grid in zip(axes, grids, strict=True)]
    start = np.clip(start, 1e-3, 1 - 1e-3)  # inside its bounds
    found = least_squares(distances, start, bounds=(0, 1), loss="soft_l1", diff_step=1e-4)
    named = {axis.name: float(f"{x:.{DIGITS}g}") for axis, x in zip(axes, at(found.x), strict=True)}
    return {"agree": int(np.sum(np.abs(found.fun) <= 1)), "values": named}


def _pieces(outside, grid: list[float]) -> list[tuple[float, float]]:
    from scipy.optimize import brentq

    ends, accuracy = {grid[0], grid[-1]}, 1e-6 * (grid[-1] - grid[0])
    for side in (0, 1):
        for one, two in pairwise(grid):
            if (outside(side, one) > 0) != (outside(side, two) > 0):
                ends.add(brentq(lambda x, side=side: outside(side, x) or -1e-300, one, two, xtol=accuracy))
    pieces: list[tuple[float, float]] = []
    for one, two in pairwise(sorted(ends)):
        if max(outside(side, (one + two) / 2) for side in (0, 1)) <= 0:
            joined = pieces and pieces[-1][1] == one
            pieces = [*pieces[:-1], (pieces[-1][0], two)] if joined else [*pieces, (one, two)]
    return [tuple(float(f"{x:.{DIGITS}g}") * (abs(x) > accuracy) + 0.0 for x in piece) for piece in pieces]


def _outside(entry: Entry, values: list) -> tuple[float, float]:
    """How far what the seeds gave lies above and below what agrees with the printed number; both at most 0 where it agrees."""
    from workbook.studies import spread_interval

    ends = [value[1] if isinstance(value, tuple | list) else (value, value) for value in values]
    middle = [value[0] if isinstance(value, tuple | list) else value for value in values]
    aim = 1.0 if entry.published is None else entry.published
    if entry.is_fraction:
        shares = middle if entry.threshold is None else [low for low, _ in ends]
        return -1.0, (entry.threshold or aim) - float(np.median(shares))
    if entry.tolerance.interval is None:
        ours, width = float(np.median(middle)), entry.tolerance.width(aim)
        low, high = ours - width, ours + width
    elif any(low != high for low, high in ends) or len(values) < 2:
        low, high = np.median(ends, axis=0)
    else:
        low, high = spread_interval(np.array(middle), entry.tolerance.interval)
    above, below = low - aim, aim - high
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
            if len({each.others for each in less}) == len(set(less)):
                mine = list(dict.fromkeys(less))
        kept += mine
    return kept
