"""Explorers that move without a kernel: their pictures at many settings, computed once for each build of a notebook."""

import base64
import contextlib
import itertools
import json
import os
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path

from workbook import paths
from workbook.checks import is_refusal
from workbook.explorer import Choice, Slider, basis_text, label
from workbook.figures import house_style
from workbook.notebooks import read_notebook
from workbook.progress import Progress
from workbook.publish import digest, replace_file
from workbook.redraw import Redraw
from workbook.site.explorers import Explorer, read_explorer, statements
from workbook.site.shapes import panels
from workbook.site.stops import Ladder, distance, ladder, shares
from workbook.tasks import Task
from workbook.workers import cores, processes

STATES = (120, 60, 30)  # pictures of an explorer: as many as go into a page
JOINT = 0.65  # share of these for two controls moved together, where there are more than two
COARSE, FEWEST = 5, 5  # stops by which controls are weighed, and of one that is moved together with another
MAIN = 15  # stops of the main control of the two, where it offers as many
LARGEST = 300_000  # bytes of a page's pictures
LONGEST_S = 60.0  # of computing for one explorer
SOURCES = ("explorers.py", "shapes.py", "stops.py", "states.py")


def picture(draw: Callable, settings: dict) -> list | dict:
    """The panels of a drawing function's figure, or its own word on why there is none."""
    try:
        return panels(draw(**settings))
    except ValueError as error:
        if not is_refusal(error):
            raise
        return {"message": f"no picture: {error}"}


def states(explorer: Explorer, count: int = STATES[0], known: dict | None = None) -> dict:
    """Pictures of an explorer: each control by itself, and the two that change the picture most together.

    Parameters
    ----------
    explorer : Explorer
    count : int
        How many pictures, about.
    known : dict, optional
        Pictures of a call before, which are not computed again.

    Returns
    -------
    dict
        ``controls`` (name, unit, stops, start, basis, and ``parameter`` where it is one of the page), ``joint`` (the two), ``states`` (for the stops of all controls,
        as ``"0.3.2"``, the place in ``pictures``), ``pictures`` and ``presets`` (name and stops of each named design).

    Raises
    ------
    TimeoutError
        When it takes longer than `LONGEST_S` of computing.
    """
    begun = time.process_time()
    controls = explorer.controls
    start = {name: control.start for name, control in controls.items()}
    known = {} if known is None else known

    def at(**moved):
        settings = {**start, **moved}
        key = tuple(settings.values())
        if key not in known:
            if time.process_time() - begun > LONGEST_S:
                raise TimeoutError
            known[key] = picture(explorer.draw, settings)
        return known[key]

    def along(name: str) -> Callable:
        return lambda value: at(**{name: value})

    pair = list(controls)
    swings: dict[str, float] = {name: _offered(control) for name, control in controls.items()}
    if len(pair) > 2:
        swings = {name: _swing(ladder(controls[name], along(name), COARSE), along(name)) for name in pair}
        pair = [name for name in controls if name in sorted(swings, key=swings.get)[-2:]]
    main = next(iter(controls))  # a page's first control has the most stops, where it is one of the two
    counts = _counts(controls, sorted(pair, key=lambda name: (name == main, swings[name])), count)
    also = {name: {design[name] for design in explorer.presets.values()} for name in controls}
    ladders = {name: ladder(controls[name], along(name), counts[name], also[name]) for name in controls}
    home = {name: each.start for name, each in ladders.items()}
    stops = {name: range(len(each.values)) for name, each in ladders.items()}
    wanted = [
        dict(zip(pair, each, strict=True)) for each in itertools.product(*(stops[name] for name in pair))
    ]
    wanted += [{name: stop} for name in controls if name not in pair for stop in stops[name]]
    presets = {
        design: {name: ladders[name].values.index(value) for name, value in settings.items()}
        for design, settings in explorer.presets.items()
    }
    wanted += presets.values()
    pictures: dict[str, int] = {}
    found = {}
    for moved in wanted:
        text = _text(at(**{name: ladders[name].values[stop] for name, stop in moved.items()}))
        place = pictures.setdefault(text, len(pictures))
        found[".".join(str(stop) for stop in {**home, **moved}.values())] = place
    return {
        "controls": [
            _control(name, controls[name], ladders[name])
            | ({"parameter": name} if name in explorer.parameters else {})
            for name in controls
        ],
        "joint": [list(controls).index(name) for name in pair],
        "states": found,
        "pictures": [json.loads(text) for text in pictures],
        "presets": [[design, list(stops.values())] for design, stops in presets.items()],
    }


def _swing(stops: Ladder, picture_of: Callable) -> float:
    """How much the picture changes on a control's way."""
    return sum(distance(picture_of(a), picture_of(b)) for a, b in itertools.pairwise(stops.values))


def _counts(controls: dict, pair: list[str], count: int) -> dict[str, int]:
    """Stops of each control; a choice has as many as options."""
    if len(pair) == 1:
        return {pair[0]: count}
    others = len(controls) - len(pair)
    budget = round(JOINT * count) if others else count
    counts = dict.fromkeys(controls, 1 + (count - budget) // max(1, others))
    first, second = pair  # the main one last; of a choice all options count
    if isinstance(controls[second], Choice):
        first, second = second, first
    main = min(MAIN, _offered(controls[second]))
    size = _offered(controls[first])
    counts[first] = size if isinstance(controls[first], Choice) else min(size, max(FEWEST, budget // main))
    counts[second] = max(main, budget // counts[first])
    return counts


def _offered(control: Slider | Choice) -> int:
    return len(control.options) if isinstance(control, Choice) else len(shares(control))


def _control(name: str, control: Slider | Choice, stops: Ladder) -> dict:
    choice = isinstance(control, Choice)
    unit = "" if choice else control.unit
    words = list(stops.values) if choice else _numbers(stops.values)
    return {
        "name": label(name, unit).removesuffix(f" ({unit})"),
        "unit": unit,
        "choice": choice,
        "stops": words,
        "start": stops.start,
        "basis": basis_text(control, f"{words[stops.start]} {unit}".strip()),
    }


def _numbers(values: tuple) -> list[str]:
    """The shortest words, of three digits or more, that tell them all apart and are what the parameter gets."""
    for digits in range(3, 17):
        words = [f"{value:.{digits}g}" for value in values]
        if all(float(word) == value for word, value in zip(words, values, strict=True)):
            break
    return words


def _text(value) -> str:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def packed(value: dict) -> str:
    """JSON, deflated, as letters that an attribute holds."""
    return base64.b64encode(zlib.compress(_text(value).encode(), 9)).decode()


def compute(name: str) -> dict:
    """What a page holds of a notebook's explorer: ``states``, their ``count`` and the ``start`` as PNG, or ``reason`` why it has none."""
    with (
        tempfile.TemporaryDirectory() as folder,  # for what a notebook's page would write
        paths.under({**os.environ, paths.OUTPUT_VARIABLE: folder}),
        house_style(),
    ):
        # What a drawing function trips over is told on its page, and does not stop the site.
        try:
            explorer, known = read_explorer(read_notebook(name)), {}
            for count in STATES:  # what takes too long or is too large for many pictures may do for fewer
                try:
                    found = states(explorer, count, known)
                except TimeoutError:
                    reason = f"its pictures take more than {LONGEST_S:g} s to compute"
                    continue
                if len(text := packed(found)) <= LARGEST:
                    png = Redraw(explorer.draw)(**{k: each.start for k, each in explorer.controls.items()})
                    start = base64.b64encode(png).decode()
                    return {"states": text, "count": len(found["pictures"]), "start": start}
                reason = f"its pictures take more than {LARGEST // 1000} kB"
        except Exception as error:
            reason = f"to compute its pictures failed: {type(error).__name__}: {error}"
    return {"reason": reason}


def _file(name: str) -> Path:
    return paths.root() / "build" / "explorers" / f"{name}.json"


def _key(task: Task) -> str:
    """Of all that the notebook's results depend on, and of what computes the states."""
    here = Path(__file__).parent
    sources = [digest((here / each).read_bytes()) for each in SOURCES]
    return digest(json.dumps([sorted(task.inputs.items()), sources]).encode())


def kept_states(of: list[Task]) -> dict[str, dict]:
    """What `compute` gave for these notebooks, where nothing that they depend on has changed since."""
    found = {}
    for task in of:
        with contextlib.suppress(OSError, ValueError):
            kept = json.loads(_file(task.notebook.name).read_text(encoding="utf-8"))
            if kept.pop("key") == _key(task):
                found[task.notebook.name] = kept
    return found


def make_states(of: list[Task]) -> dict[str, dict]:
    """`kept_states`, after computing those that are missing."""
    found = kept_states(of)
    missing = {task.notebook.name: _key(task) for task in missing_states(of, found)}
    if missing:
        print(f"computing the pictures of {len(missing)} explorers; they are kept for the next time")
        jobs = min(cores(), len(missing))
        with Progress(len(missing), task="explorers", unit="notebook", tenths=True) as progress:
            with processes(jobs) as pool:
                for name, made in zip(missing, pool.map(compute, missing), strict=True):
                    replace_file(_file(name), _text({"key": missing[name], **made}).encode())
                    found[name] = made
                    if "reason" in made:
                        progress.print_line(f"{name}: the explorer stands still: {made['reason']}")
                    progress.step()
    return found


def missing_states(of: list[Task], found: dict[str, dict]) -> list[Task]:
    """Of these notebooks those with an explorer of which nothing is kept."""
    return [task for task in of if task.notebook.name not in found and statements(task.notebook.source)]
