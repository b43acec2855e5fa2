"""Some of a study's runs once more."""

import time

from workbook.choices.checking import At, drawn, moved_before
from workbook.choices.results import Outcomes, collect
from workbook.choices.running import calls_of, compute

LIGHT = 2.0  # s of CPU; a study that takes less is computed whole


def compute_again(before: Outcomes, day: int, parts: int = 1) -> tuple[Outcomes, list[At]]:
    """What the runs of a day give here and now, and which they are; all runs, where the study is light.

    With them, those that had moved when they were tried last.
    """
    runs = calls_of(before.multiverse)
    found, spent = {}, []
    again = [at for at in moved_before(before.multiverse) if at in runs]
    for at in dict.fromkeys([*drawn(before.multiverse, runs, day, parts, before), *again]):
        begin = time.process_time()
        found[at] = compute(runs[at])
        spent.append(time.process_time() - begin)
    later = spent[1:] or spent  # the first one may compile
    if sum(later) / len(later) * len(runs) < LIGHT:
        found |= {at: compute(run) for at, run in runs.items() if at not in found}
    return collect(before.multiverse, before.design, found), list(found)
