"""Progress of a long search: a line at every tenth, apart from the output of the command."""

import sys
import time
from collections.abc import Callable


def count_steps(total: int, task: str) -> Callable[[object], None]:
    """What to call after each of `total` steps, with anything."""
    begin, done = time.monotonic(), 0

    def step(_: object = None) -> None:
        nonlocal done
        before, done = done, done + 1
        if 10 * done // total > 10 * before // total:
            rest = (time.monotonic() - begin) * (total / done - 1)
            left = f", {rest:.0f} s left" if done < total else ""
            print(f"{task}: {done} of {total}{left}", file=sys.stderr, flush=True)

    return step
