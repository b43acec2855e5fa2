"""Whether committed values still come out: some of each study's runs are computed again, others each day.

The runs of a study are dealt into `DAYS` parts. A day takes one part, or as many as ``STILLWORK_SAMPLE`` states, so that
all come round in `DAYS` days or sooner. A value has moved when it differs by more than its entry's `drift`.
"""

import datetime
import json
import math
import os
import random
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from workbook import paths
from workbook.checks import InputError, require_count
from workbook.choices.axes import Multiverse
from workbook.choices.judging import agreement
from workbook.choices.notebook_study import study_digest
from workbook.choices.results import Outcomes, collect
from workbook.choices.running import Call, calls_at
from workbook.claims import Entry
from workbook.publish import replace_file

DAYS = 30
SAMPLE = "STILLWORK_SAMPLE"  # an environment variable: parts a day
ROUNDING = 1e-12

At = tuple[int, int]  # a run, by point and place of its seed


def today() -> int:
    """The day, counted from any."""
    return datetime.date.today().toordinal()


def parts_a_day() -> int:
    """From the environment; 1 by default."""
    text = os.environ.get(SAMPLE, "1")
    if not text.isdecimal():
        raise InputError(f"{SAMPLE} is {text!r}; give a whole number, 1 to {DAYS}")
    return min(require_count(SAMPLE, int(text)), DAYS)


def drawn(
    multiverse: Multiverse, runs: Iterable[At], day: int, parts: int = 1, outcomes: Outcomes | None = None
) -> list[At]:
    """The runs of a study whose turn it is on a day, at least one; with more parts, those of one part among them.

    An entry that has no value in any of them, by the committed `outcomes`, adds the next run that has one.
    """
    order = sorted(runs)
    random.Random(multiverse.study).shuffle(order)
    days = min(DAYS, len(order))
    turns = {(day + part * math.ceil(days / parts)) % days for part in range(parts)}
    chosen = [at for place, at in enumerate(order) if place % days in turns]
    first = (day + 1) % len(order) if order else 0
    for values in outcomes.values.values() if outcomes else ():
        if not any(math.isfinite(values[at]) for at in chosen):
            chosen += [at for at in (*order[first:], *order[:first]) if math.isfinite(values[at])][:1]
    return chosen


def moves(before: Outcomes, now: Outcomes, tried: list[At], entries: dict[str, Entry]) -> list[str]:
    """What of the runs `tried` differs from the committed results, one line each: entry, combination and both values."""
    multiverse = before.multiverse
    lines = []
    for at in sorted(tried):
        options = multiverse.combination(before.design[at[0]]) | {"seed": multiverse.seeds[at[1]]}
        where = ", ".join(f"{name} {option}" for name, option in options.items())
        if _kind(before, at) != _kind(now, at):
            was, comes = (each.failures.get(at, "values") for each in (before, now))
            lines.append(f"{multiverse.study} at {where}: {was} before, {comes} now")
            continue
        for entry in multiverse.entries:
            room = ROUNDING + entries[entry].drift.width(before.values[entry][at])
            for name in ("values", "low", "high"):
                was, comes = _number(before, name, entry, at), _number(now, name, entry, at)
                if not math.isclose(was, comes, rel_tol=0, abs_tol=room) and {was, comes} != {math.nan}:
                    which = "" if name == "values" else f" ({name})"
                    lines.append(f"{entry}{which} at {where}: {was:.7g} before, {comes:.7g} now")
    return lines


def short_form_differs(
    multiverse: Multiverse, entries: dict[str, Entry], compute: Callable[[Call], dict | str]
) -> list[str]:
    """Where a study's short form has another verdict than the whole one, one line each; empty where it may stand for it.

    Both are computed at the default and at every other option of each axis, the others at their default, with all seeds.
    """
    default = multiverse.default_point
    design = [default]
    for k, axis in enumerate(multiverse.axes):
        design += [
            (*default[:k], place, *default[k + 1 :])
            for place in range(len(axis.options))
            if place != default[k]
        ]
    outcomes = []
    for form in (replace(multiverse, lean=""), multiverse):
        runs = calls_at(form, design)
        outcomes.append(collect(form, design, {at: compute(run) for at, run in runs.items()}))
    lines = []
    for entry in multiverse.entries:
        if entries[entry].kind == "reported":
            continue
        whole, short = (agreement(outcome, entries[entry]).mean(axis=1) for outcome in outcomes)
        for k, point in enumerate(design):
            if (whole[k] >= 0.5) != (short[k] >= 0.5):
                where = ", ".join(
                    f"{axis.name} {axis.texts[point[n]]}"
                    for n, axis in enumerate(multiverse.axes)
                    if point[n] != default[n]
                )
                values = [float(np.nanmean(each.values[entry][k])) for each in outcomes]
                lines.append(
                    f"{entry} at {where or 'the default'}: {values[0]:.4g} whole, {values[1]:.4g} short"
                )
    return lines


def _number(outcomes: Outcomes, name: str, entry: str, at: At) -> float:
    """A value, or an end of its interval; NaN without one."""
    found = getattr(outcomes, name)
    value = float(found[entry][at]) if entry in found else math.nan
    return math.nan if math.isnan(value) else value  # one NaN, which is itself


def _kind(outcomes: Outcomes, at: At) -> str:
    """Kind of a failure; a message's wording may change."""
    return outcomes.failures.get(at, "").partition(":")[0]


def note(multiverse: Multiverse, moved: Iterable[At]) -> None:
    """Keep what came of a sample of a study today: the runs with a value that moved, with the code as it is."""
    record = {"code": _code(multiverse), "date": f"{datetime.date.today()}", "moved": sorted(moved)}
    replace_file(_record(multiverse), json.dumps(record).encode())


def forget(multiverse: Multiverse) -> None:
    """All was computed: earlier samples no longer count."""
    _record(multiverse).unlink(missing_ok=True)


def has_moved(multiverse: Multiverse) -> bool:
    """Whether a value of the study was found to have moved, with the code as it is."""
    return bool(_noted(multiverse).get("moved"))


def moved_before(multiverse: Multiverse) -> list[At]:
    """Runs that had moved in the last sample, whatever the code was: another day must not pass them over."""
    return [(point, seed) for point, seed in _record_of(multiverse).get("moved", ())]


def is_older(outcomes: Outcomes) -> bool:
    """Whether other code than today's gave them."""
    return outcomes.code != _code(outcomes.multiverse)


def age(outcomes: Outcomes) -> str:
    """A note on results of older code; empty for those of the present code."""
    if not is_older(outcomes):
        return ""
    record = _noted(outcomes.multiverse)
    if not record:
        return "computed with older code, not sampled again since"
    result = "found to have moved" if record["moved"] else "sampled again"
    return f"computed with older code, {result} on {record['date']}"


def _code(multiverse: Multiverse) -> str:
    return study_digest(multiverse.function)


def _noted(multiverse: Multiverse) -> dict:
    """What was noted of the code as it is; empty without."""
    record = _record_of(multiverse)
    return record if record.get("code") == _code(multiverse) else {}


def _record_of(multiverse: Multiverse) -> dict:
    """The last note; empty if there is none or it is unreadable."""
    try:
        record = json.loads(_record(multiverse).read_text(encoding="utf-8"))
        moved = [(int(point), int(seed)) for point, seed in record["moved"]]
        return {"code": record["code"], "date": record["date"], "moved": moved}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _record(multiverse: Multiverse) -> Path:
    return paths.root() / "build" / "choices" / "sampled" / multiverse.topic / f"{multiverse.study}.json"
