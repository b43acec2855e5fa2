"""The runner of anybody's observer: a Python file with a class ``Observer``.

It runs the file as ``python`` would, with all your rights, in one other process that has a limit of time: no sandbox, so
read a file that is not yours before you run it.
"""

import importlib.util
import sys
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import TimeoutError
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
from jaxtyping import Float64

from contest.nominal import NominalModel, NominalNoise, TuningParameter
from stillwork.base.checks import InputError
from workbook.workers import processes

SECONDS = 60  # of the clock that a scan may take, with its start


class Disqualified(Exception):
    """Why an observer is out of the contest."""


@cache
def module_of(file: str) -> ModuleType:
    """The file as an imported module, its folder on the path."""
    sys.path.insert(0, str(Path(file).parent))
    spec = importlib.util.spec_from_file_location("entrant", file)
    assert spec and spec.loader
    module = sys.modules["entrant"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def knobs_of(file: str) -> tuple[TuningParameter, ...]:
    """The tuning parameters ``KNOBS`` of a file, each (name, low, high, default); it must have a class ``Observer``."""
    module = module_of(file)
    if not isinstance(getattr(module, "Observer", None), type):
        raise AttributeError("it has no class Observer")
    knobs = tuple(TuningParameter(*knob) for knob in getattr(module, "KNOBS", ()))
    if not all(0 < knob.low <= knob.default <= knob.high < np.inf for knob in knobs):
        raise ValueError("KNOBS must list (name, low, high, default), numbers above zero in order")
    return knobs


class FileObserver:
    """The observer of a file on one scan, with the `start`, `step` and `run` of ours."""

    def __init__(self, file: str, settings: tuple[float, ...] = ()):
        self.observer, self.settings = module_of(file).Observer(), settings

    def start(self, model: NominalModel, noise: NominalNoise, sample_time: float) -> None:
        """Begin a scan."""
        self.states = len(model.a)
        self.observer.start(model, noise, sample_time, *self.settings)

    def step(self, input: np.ndarray, measurement: np.ndarray, *_) -> Float64[np.ndarray, " states"]:
        """The estimate at the sample of this measurement."""
        estimate = np.array(self.observer.step(input.copy(), measurement.copy()), dtype=float)
        if estimate.shape != (self.states,) or not np.isfinite(estimate).all():
            raise ValueError(f"step must return {self.states} finite numbers, not {estimate!r}")
        return estimate

    def run(self, inputs: np.ndarray, measurements: np.ndarray) -> Float64[np.ndarray, "samples states"]:
        """Estimates of a whole scan."""
        return np.array([self.step(*pair) for pair in zip(inputs, measurements, strict=True)])


def _attempt(file: str, function: Callable, arguments: tuple):
    try:
        return function(*arguments)
    except BaseException as error:  # whatever the file raises, exits among them
        lines = [step.lineno for step in traceback.extract_tb(error.__traceback__) if step.filename == file]
        line = f" (line {lines[-1]})" if lines else ""
        return Disqualified(f"raises {type(error).__name__}: {error}{line}")


@contextmanager
def running(file: str) -> Iterator[Callable]:
    """Gives ``call(function, *arguments)``, which runs in the file's process and may take `SECONDS` a scan.

    A call raises `Disqualified` when the file raises, ends or takes longer; it is the last one then.
    """

    def call(function: Callable, *arguments, scans: int = 1):
        try:
            answer = pool.submit(_attempt, file, function, arguments).result(scans * SECONDS)
        except TimeoutError:
            raise Disqualified(f"takes more than {SECONDS} s a scan") from None
        except BrokenProcessPool:
            raise Disqualified("its process ended") from None
        if isinstance(answer, Disqualified):
            raise answer
        return answer

    with processes(1) as pool:
        yield call


def checked_file(file: str | Path) -> str:
    """The absolute path of a Python file that can be read and compiled."""
    path = Path(file).resolve()
    if path.suffix != ".py":
        raise InputError(f"{file} is no Python file; give a file my_observer.py with a class Observer")
    try:
        compile(path.read_bytes(), path, "exec")
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error}); give a file my_observer.py") from None
    except (SyntaxError, ValueError) as error:
        raise InputError(f"{file} is no Python code ({error}); correct it") from None
    return str(path)
