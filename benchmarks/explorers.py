"""Redraw times of every explorer: at the start, with each control at its ends and in its middle, and at each preset.

Processor time, which other programs disturb less than the clock. A slider moves a little at each, so that what an
explorer remembers of the very same setting counts for nothing. `ARGS="TOPIC/NOTEBOOK"` chooses one.
"""

import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(os.environ.get("STILLWORK_ROOT") or Path(__file__).parents[1])
sys.path[:0] = [str(Path(__file__).parents[1] / "lib"), str(ROOT)]
os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", MPLBACKEND="Agg")

from stillwork.base.checks import InputError  # noqa: E402
from workbook import figures  # noqa: E402
from workbook.explorer import Choice, Slider  # noqa: E402
from workbook.notebooks import select  # noqa: E402
from workbook.redraw import Redraw  # noqa: E402
from workbook.site.explorers import read_explorer  # noqa: E402

LIMIT_MS = 100.0


def settings(controls: dict) -> list[dict]:
    """The start, then one control moved at a time."""
    start = {name: control.start for name, control in controls.items()}
    moved = [start]
    for name, control in controls.items():
        for value in _places(control):
            moved.append({**start, name: value})
    return moved


def _places(control) -> tuple:
    if isinstance(control, Choice):
        return control.options
    low, high = control.low, control.high
    middle = (low * high) ** 0.5 if control.log else (low + high) / 2
    return low, control.read(middle), high


def moves(controls: dict, one: dict) -> list[dict]:
    """A setting, with the slider that left its start, else the first one, moved by a little and a little more."""
    sliders = {name: each for name, each in controls.items() if isinstance(each, Slider)}
    moved = [name for name, each in sliders.items() if one[name] != each.start]
    name = next(iter([*moved, *sliders]))
    return [{**one, name: _beside(sliders[name], one[name], part)} for part in (0.011, 0.023)]


def _beside(slider, value: float, part: float) -> float:
    """A value of a slider a part of its range, at least a step, further towards its middle."""
    low, high = slider.low, slider.high
    middle = (low * high) ** 0.5 if slider.log else (low + high) / 2
    if slider.log:
        return slider.read(value * (high / low) ** (part if value < middle else -part))
    way = max(part * (high - low), (slider.step or 1) if slider.whole else 0)
    return slider.read(value + (way if value < middle else -way))


def redraw_ms(redraw: Callable, settings: list[dict]) -> float | None:
    """Milliseconds of processor time, the shortest of the settings; None where one is impossible."""
    spans = []
    for one in settings:
        start = time.process_time()
        try:
            redraw(**one)
        except InputError:
            return None
        spans.append(1e3 * (time.process_time() - start))
    return min(spans)


def main() -> None:
    figures.use_house_style()
    slow = []
    print(f"{'explorer':34} {'start':>10} {'slowest':>10}   ms; slowest at")
    for notebook in select(*sys.argv[1:]):
        with contextlib.redirect_stdout(None):  # the notebook's own tables
            explorer = read_explorer(notebook)
        if explorer is None:
            continue
        controls, redraw = explorer.controls, Redraw(explorer.draw)
        redraw(**settings(controls)[0])  # the first picture finds the layout of all
        times = [
            (redraw_ms(redraw, moves(controls, one)), one)
            for one in [*settings(controls), *explorer.presets.values()]
        ]
        longest, worst = max((span, repr(one), one) for span, one in times if span is not None)[::2]
        start = times[0][1]
        where = ", ".join(
            f"{k} = {v:.4g}" if isinstance(v, float) else f"{k} = {v}"
            for k, v in worst.items()
            if v != start[k]
        )
        print(
            f"{notebook.name:34} {times[0][0]:10.0f} {longest:10.0f}   {where or 'the start'}",
            flush=True,
        )
        if longest > LIMIT_MS:
            slow.append(notebook.name)
    print(f"over {LIMIT_MS:g} ms: {', '.join(slow) or 'none'}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.environ["STILLWORK_OUTPUT"] = folder
        main()
