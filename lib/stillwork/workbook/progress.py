"""What a person sees of a build: a bar with the time left in a terminal, plain lines elsewhere."""

import sys


class Progress:
    """Counts code cells; `say` prints a line without tearing the bar."""

    def __init__(self, cells: int):
        self._bar = None
        if sys.stderr.isatty():
            from tqdm import tqdm

            self._bar = tqdm(total=cells, unit="cell", desc="figures", leave=False)

    def step(self, cells: int = 1) -> None:
        if self._bar is not None:
            self._bar.update(cells)

    def say(self, line: str) -> None:
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
