"""Whether committed values still come out: some of each study's runs are computed again, others each day.

The runs of a study are dealt into `DAYS` parts. A day takes one part, or as many as ``STILLWORK_SAMPLE`` says, so that
all come round in `DAYS` days or sooner. A value has moved when it differs by more than its entry's `drift`.
"""

import datetime
import json
import math
import os
import random
import time
from collections.abc import Iterable
from pathlib import Path

from stillwork.base import paths
from stillwork.base.checks import InputError, require_count
from stillwork.workbook.claims import Entry
from stillwork.workbook.publish import replace_file
from stillwork.workbook.readings.axes import Multiverse
from stillwork.workbook.readings.closure import study_digest
from stillwork.workbook.readings.results import Outcomes, collect
from stillwork.workbook.readings.running import calls_of, compute

DAYS = 30
LIGHT = 2.0  # s of CPU; a study that takes less is computed whole
SAMPLE = "STILLWORK_SAMPLE"  # an environment variable: parts a day
ROUNDING = 1e-12

At = tuple[int, int]  # a run, by point and place of its seed


def today() -> int:
    """The day, counted from any."""
    return datetime.date.today().toordinal()


def parts_a_day() -> int:
    """As the environment says; 1 where it says nothing."""
    text = os.environ.get(SAMPLE, "1")
    if not text.isdecimal():
        raise InputError(f"{SAMPLE} is {text!r}; give a whole number, 1 to {DAYS}")
    return min(require_count(SAMPLE, int(text)), DAYS)


def drawn(multiverse: Multiverse, runs: Iterable[At], day: int, parts: int = 1) -> list[At]:
    """The runs of a study whose turn it is on a day, at least one; with more parts, those of one part among them."""
    order = sorted(runs)
    random.Random(multiverse.study).shuffle(order)
    days = min(DAYS, len(order))
    turns = {(day + part * math.ceil(days / parts)) % days for part in range(parts)}
    return [at for place, at in enumerate(order) if place % days in turns]


def compute_again(before: Outcomes, day: int, parts: int = 1) -> tuple[Outcomes, list[At]]:
    """What the runs of a day give here and now, and which they are; all runs, where the study is light."""
    runs = calls_of(before.multiverse)
    found, least = {}, math.inf
    for at in drawn(before.multiverse, runs, day, parts):
        begin = time.process_time()
        found[at] = compute(runs[at])
        least = min(least, time.process_time() - begin)  # the first one may compile
    if least * len(runs) < LIGHT:
        found |= {at: compute(run) for at, run in runs.items() if at not in found}
    return collect(before.multiverse, before.design, found), list(found)


def moves(before: Outcomes, now: Outcomes, tried: list[At], entries: dict[str, Entry]) -> list[str]:
    """What of the runs `tried` differs from the committed results, a line each: entry, combination and both values."""
    multiverse = before.multiverse
    lines = []
    for at in sorted(tried):
        options = multiverse.reading(before.design[at[0]]) | {"seed": multiverse.seeds[at[1]]}
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


def _number(outcomes: Outcomes, name: str, entry: str, at: At) -> float:
    """A value, or an end of its interval; NaN without one."""
    found = getattr(outcomes, name)
    value = float(found[entry][at]) if entry in found else math.nan
    return math.nan if math.isnan(value) else value  # one NaN, which is itself


def _kind(outcomes: Outcomes, at: At) -> str:
    """Kind of a failure; a message's wording may change."""
    return outcomes.failures.get(at, "").partition(":")[0]


def note(multiverse: Multiverse, moved: bool) -> None:
    """Keep what came of a sample of a study today: whether a value moved, with the code as it is."""
    record = {"code": _code(multiverse), "date": f"{datetime.date.today()}", "moved": moved}
    replace_file(_record(multiverse), json.dumps(record).encode())


def forget(multiverse: Multiverse) -> None:
    """All was computed: what came of samples before says nothing any more."""
    _record(multiverse).unlink(missing_ok=True)


def has_moved(multiverse: Multiverse) -> bool:
    """Whether a value of the study was found to have moved, with the code as it is."""
    return _noted(multiverse).get("moved", False)


def is_older(outcomes: Outcomes) -> bool:
    """Whether other code than today's gave them."""
    return outcomes.code != _code(outcomes.multiverse)


def age(outcomes: Outcomes) -> str:
    """What is to be said of results that older code gave; empty for those of the code as it is."""
    if not is_older(outcomes):
        return ""
    record = _noted(outcomes.multiverse)
    if not record:
        return "computed with older code, not sampled again since"
    result = "found to have moved" if record["moved"] else "sampled again"
    return f"computed with older code, {result} on {record['date']}"


def _code(multiverse: Multiverse) -> str:
    return study_digest(multiverse.function, multiverse.room)


def _noted(multiverse: Multiverse) -> dict:
    """What was noted of the code as it is; empty without."""
    try:
        record = json.loads(_record(multiverse).read_text(encoding="utf-8"))
        fits = record["code"] == _code(multiverse) and {"date", "moved"} <= record.keys()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
    return record if fits else {}


def _record(multiverse: Multiverse) -> Path:
    return paths.root() / "build" / "readings" / "sampled" / multiverse.room / f"{multiverse.study}.json"
