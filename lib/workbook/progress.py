"""Progress of a long run: a bar with the time left in a terminal, plain lines elsewhere."""

import sys
import time
from importlib.util import find_spec


class Progress:
    """Counts steps; `print_line` prints a line without tearing the bar.

    Parameters
    ----------
    total : int
        Steps of the run.
    task, unit : str
        What runs, and what a step is.
    tenths : bool
        Whether to print a line at every tenth if there is no terminal for the bar.
    """

    def __init__(
        self,
        total: int,
        *,
        task: str = "figures",
        unit: str = "cell",
        tenths: bool = False,
    ):
        self._bar = None
        self._tenths = tenths
        self._task, self._total, self._done, self._begin = task, total, 0, time.monotonic()
        if sys.stderr.isatty() and find_spec("tqdm"):  # of an extra
            from tqdm import tqdm

            self._bar = tqdm(total=total, unit=unit, desc=task, leave=False)

    def step(self, steps: int = 1) -> None:
        before, self._done = self._done, self._done + steps
        if self._bar is not None:
            self._bar.update(steps)
        elif self._tenths and 10 * self._done // self._total > 10 * before // self._total:
            self.print_line(f"{self._task}: {self._done} of {self._total}{self.left()}")

    def left(self) -> str:
        """The time left as the end of a line; empty where the bar shows it, and while nothing is known."""
        if self._bar is not None or not 0 < self._done < self._total:
            return ""
        return f", {(time.monotonic() - self._begin) * (self._total / self._done - 1):.0f} s left"

    def print_line(self, line: str) -> None:
        if self._bar is not None:
            self._bar.clear()
        print(line, flush=True)
        if self._bar is not None:
            self._bar.refresh()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._bar is not None:
            self._bar.close()
