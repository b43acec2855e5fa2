"""Computes combinations on any executor, goes on after a kill, and outlives the combinations that fail."""

import contextlib
import hashlib
import importlib
import inspect
import itertools
import json
import math
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from workbook.checks import InputError
from workbook.choices.axes import POINTS, Multiverse, Option
from workbook.choices.notebook_study import run_notebook, study_digest
from workbook.choices.results import Outcomes, Value, collect, rounded
from workbook.progress import Progress

DIED = "its process died"
LONGEST_REASON = 200  # characters
SAMPLE_SEED = 20160528  # of the sample; any would do, so long as it stays


def design(multiverse: Multiverse) -> list[tuple[int, ...]]:
    """Points to compute, each an option's place on every axis; the default comes first, none comes twice.

    All combinations where there are at most 64; else as many as the study requires, from a scrambled Sobol
    sequence with a fixed seed, so that any first part of the list fills the space, too. Then what this leaves out of an
    entry whose own axes have at most 64 combinations, so that all of these are there.
    """
    sizes = [len(axis.options) for axis in multiverse.axes]
    first = [multiverse.default_point]
    if multiverse.size <= max(POINTS, multiverse.points):
        return list(dict.fromkeys([*first, *itertools.product(*map(range, sizes))]))
    found = dict.fromkeys(first)
    for drawn in _blocks(len(sizes)):
        for point in np.floor(drawn * sizes).astype(int).tolist():
            found.setdefault(tuple(point))
            if len(found) == multiverse.points:
                return _completed(multiverse, list(found))


def _completed(multiverse: Multiverse, points: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """With the points that lack of the settings of an entry's own axes, where these are few; other axes at their default."""
    for columns in sorted({multiverse.columns(entry) for entry in multiverse.entries}):
        sizes = [len(multiverse.axes[k].options) for k in columns]
        if math.prod(sizes) > POINTS:
            continue
        there = {tuple(point[k] for k in columns) for point in points}
        for setting in itertools.product(*map(range, sizes)):
            if setting not in there:
                point = list(multiverse.default_point)
                for k, place in zip(columns, setting, strict=True):
                    point[k] = place
                points.append(tuple(point))
    return points


def _blocks(dimensions: int):
    """The sequence in blocks of 64, without end."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(SAMPLE_SEED))
    while True:
        yield sequence.random(POINTS)  # a power of two, as the sequence requires


class Journal:
    """Lines ``{"key": ..., "found": ...}`` of a file that only grows; a torn last line is left out.

    Parameters
    ----------
    file : Path
        Made with its folder when the first line is written.
    """

    def __init__(self, file: Path):
        self.file = file
        self.found: dict[str, dict | str] = {}
        self._torn = False
        if file.exists():
            text = file.read_text(encoding="utf-8", errors="replace")
            self._torn = bool(text) and not text.endswith("\n")
            for line in text.splitlines():
                try:
                    record = json.loads(line)
                    self.found[record["key"]] = record["found"]
                except (ValueError, TypeError, KeyError):  # the line that a kill cut short
                    continue

    def add(self, key: str, found: dict | str) -> None:
        """Keep what a combination gave: values by entry, or why it failed."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        with self.file.open("a", encoding="utf-8") as file:
            file.write("\n" * self._torn + json.dumps({"key": key, "found": found}) + "\n")
        self._torn = False
        self.found[key] = found


@dataclass(frozen=True)
class Call:
    """One call of a study: a combination and a seed.

    Attributes
    ----------
    function, topic : str
    options : dict
        Arguments.
    seed : int
    lean : bool
    entries : tuple of str
        What it must return.
    code : str
        Digest of the caller's code; a worker whose code differs refuses.
    """

    function: str
    topic: str
    options: dict[str, Option]
    seed: int
    lean: bool
    entries: tuple[str, ...]
    code: str

    @property
    def key(self) -> str:
        """Under which the journal keeps what it gave."""
        facts = [self.code, self.function, self.options, self.seed, self.lean, self.entries]
        return hashlib.sha256(json.dumps(facts).encode()).hexdigest()


def calls_of(multiverse: Multiverse) -> dict[tuple[int, int], Call]:
    """All runs of a study, by point and place of the seed."""
    return calls_at(multiverse, design(multiverse))


def calls_at(multiverse: Multiverse, points: list[tuple[int, ...]]) -> dict[tuple[int, int], Call]:
    """The runs of a study at these points, by point and place of the seed."""
    code = study_digest(multiverse.function)
    own_seed = multiverse.seeded and "/" in multiverse.function  # a parameter of the notebook
    return {
        (k, s): Call(
            multiverse.function,
            multiverse.topic,
            multiverse.options(point) | ({"seed": seed} if own_seed else {}),
            seed,
            bool(multiverse.lean),
            multiverse.entries,
            code,
        )
        for k, point in enumerate(points)
        for s, seed in enumerate(multiverse.seeds)
    }


def compute(run: Call) -> dict[str, Value] | str:
    """What the study gives, rounded to the digits that are kept; the reason, where it raises.

    Raises
    ------
    InputError
        When the study cannot be called like this, does not return what it should, or is other code than required.
    """
    if study_digest(run.function) != run.code:
        raise InputError(f"{run.function}: the worker's checkout differs; bring it to the same state")
    function = _function_of(run)
    arguments = run.options | {"seed": run.seed}
    try:
        signature = inspect.signature(function)
        if run.lean or "lean" in signature.parameters:
            arguments["lean"] = run.lean
        signature.bind(**arguments)
    except TypeError as error:
        raise InputError(f"{run.function} cannot take the axes that touch its entries: {error}") from None
    try:
        given = dict(function(**arguments))
    except Exception as error:  # a combination that cannot be computed is a result, too
        return " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST_REASON]
    for entry in (*run.entries, *given):
        if (entry in given) != (entry in run.entries):
            word = "is not among its entries" if entry in given else "is missing from what it returns"
            raise InputError(f"{run.function}: {entry} {word}; correct it or choices.toml")
    return {entry: _kept(given[entry]) for entry in run.entries}


def _function_of(run: Call) -> Callable[..., dict[str, Value]]:
    """The study itself: a function, or a notebook that is run with other parameters."""
    if "/" in run.function:
        return lambda **_: run_notebook(run.function, run.entries, run.options)
    module, _, name = run.function.partition(":")
    function = getattr(importlib.import_module(module), name, None)
    if function is None:
        raise InputError(f"{module} has no function {name!r}; correct choices.toml")
    return function


def _kept(value: Value | np.bool_) -> Value:
    """Rounded; NaN for what is not finite; 1 for what is true."""
    if isinstance(value, tuple):
        middle, (low, high) = value
        ends = (_kept(low), _kept(high))
        return (_kept(middle), ends) if all(map(math.isfinite, ends)) else _kept(middle)
    value = float(value)
    return rounded(value) if math.isfinite(value) else math.nan


def run_combinations(
    multiverses: list[Multiverse],
    executor: Callable[[], contextlib.AbstractContextManager[Executor]],
    journal: Journal,
    *,
    at_once: int = 2,
    budget_s: float = math.inf,
    stopped: Callable[[], bool] = lambda: False,
    runs_of: Callable[[Multiverse], dict[tuple[int, int], Call]] = calls_of,
) -> list[Outcomes]:
    """Compute what the journal does not hold yet; returns the studies that are whole.

    The numbers depend neither on the executor, on its workers, on their order, nor on interruptions.

    Parameters
    ----------
    multiverses : list of Multiverse
    executor : callable
        Gives a context with an executor; called again when a process of the first one dies.
    journal : Journal
    at_once : int
        Combinations that are submitted at a time.
    budget_s : float
        After so many seconds no combination is begun.
    stopped : callable
        If this returns True, running combinations are given up, too.
    runs_of : callable
        The runs of a study to compute, by default all.
    """
    plans = [(multiverse, runs_of(multiverse)) for multiverse in multiverses]
    missing = {run.key: run for _, runs in plans for run in runs.values() if run.key not in journal.found}
    waiting = deque(missing.values())
    end = time.monotonic() + budget_s
    with Progress(len(missing), task="choices", unit="combination", tenths=True) as progress:

        def keep(run: Call, found: dict | str) -> None:
            journal.add(run.key, found)
            progress.step()

        with contextlib.suppress(_Interrupted):
            while waiting and time.monotonic() < end:
                suspects = _run_until_broken(waiting, executor, at_once, keep, end, stopped)
                for run in suspects:
                    keep(run, _run_alone(run, executor))
    return [
        collect(
            multiverse,
            design(multiverse),
            {at: journal.found[run.key] for at, run in runs.items()},
            next(iter(runs.values())).code,
        )
        for multiverse, runs in plans
        if all(run.key in journal.found for run in runs.values())
    ]


class _Interrupted(Exception):
    """Leaves the executor's context at once."""


def _run_until_broken(waiting: deque[Call], executor, at_once, keep, end, stopped) -> list[Call]:
    """Submit runs until none waits; returns those that were running when a process died."""
    running = {}
    with executor() as pool:
        try:
            while running or (waiting and time.monotonic() < end):
                if stopped():
                    raise _Interrupted
                while waiting and len(running) < at_once and time.monotonic() < end:
                    future = pool.submit(compute, waiting[0])  # refused by a broken pool: it still waits
                    running[future] = waiting.popleft()
                done, _ = wait(running, timeout=0.2, return_when=FIRST_COMPLETED)
                for future in done:
                    found = _found(future)
                    keep(running.pop(future), found)
        except BrokenExecutor:
            return list(running.values())
        except BaseException:
            for future in running:
                future.cancel()
            raise
    return []


def _found(future: Future) -> dict | str:
    try:
        return future.result()
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # a cluster gives up on it after several workers
            return DIED
        raise


def _run_alone(run: Call, executor) -> dict | str:
    with executor() as pool:
        try:
            return pool.submit(compute, run).result()
        except BrokenExecutor:
            return DIED
