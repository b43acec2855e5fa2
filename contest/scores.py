"""One seed of the contest on one plant: every observer on the same scans, one scan at a time."""

import fcntl
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from contest import bench
from contest.adaptive import ADAPTIVE
from contest.fixed_gain import FIXED
from contest.learned import LEARNED
from contest.moving_horizon import MOVING
from contest.multi_model import MULTI_MODEL
from contest.nominal import Baseline, OwnObserver, nominal_of
from contest.parametric import PARAMETRIC
from contest.plants import plant_of
from contest.runner import Disqualified, ExternalObserver
from contest.structured import STRUCTURED
from contest.uncertainties import UNCERTAINTIES, Truth, hidden_seed, sample_truth

ENTRANTS: Mapping[str, Baseline] = {
    **FIXED,
    **STRUCTURED,
    **PARAMETRIC,
    **ADAPTIVE,
    **MOVING,
    **MULTI_MODEL,
    **LEARNED,
}
ORACLE = "oracle"  # the true states, in the loop alone


class Scan(NamedTuple):
    """What one scan of the contest is of."""

    track: str  # estimate, loop or bandwidth
    plant: str
    uncertainty: str
    public: str
    seed: int

    @property
    def stream(self) -> int:
        """Its hidden seed: tracks share nothing, so that what one scan shows is of no use on another."""
        return hidden_seed(self.public, self.track, self.plant, self.uncertainty, self.seed)

    def given(self) -> tuple:
        """What the observers are given before it."""
        plant = plant_of(self.plant)
        return *nominal_of(plant, UNCERTAINTIES[self.uncertainty].noise), plant.sample_time


class Scored(NamedTuple):
    """What one observer got on one scan."""

    entrant: str
    scan: Scan
    score: str
    value: float


class Oracle:
    """Uses the true states."""

    def start(self, model, *_) -> None:
        """Begin a scan."""
        self.states = len(model.a)

    def step(self, input, measurement, state: np.ndarray) -> np.ndarray:
        """The true state."""
        return state[: self.states].copy()


@cache  # they serve all seeds, and every thread of a worker
def _designs(name: str, knobs: tuple[float, ...]) -> dict:
    return {}


@contextmanager
def turn() -> Iterator[None]:
    """Scans of observers that are not ours run one at a time on a machine: by its load they could speak to each other."""
    with open(Path(tempfile.gettempdir()) / f"stillwork-contest-{os.getuid()}", "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def opened(entrant: str, source: str | None, given: tuple, knobs: tuple[float, ...]) -> Iterator:
    """An observer at the beginning of a scan: from `source`, or one of ours."""
    if source is not None:
        with turn(), ExternalObserver(source) as observer:
            observer.start(*given, knobs)
            yield observer
        return
    own = Oracle() if entrant == ORACLE else OwnObserver(ENTRANTS[entrant], knobs, _designs(entrant, knobs))
    own.start(*given)
    yield own


@lru_cache(maxsize=64)  # all observers run on the same
def truth_of(scan: Scan) -> Truth:
    """The machine as it is on a scan, and its noises."""
    samples = 2 * bench.PERIOD + 1 if scan.track == "bandwidth" else bench.SAMPLES
    plant, rng = plant_of(scan.plant), np.random.default_rng(scan.stream)
    truth = sample_truth(plant, UNCERTAINTIES[scan.uncertainty], samples, rng)
    return bench.push(plant, truth) if scan.track == "loop" else truth


@lru_cache(maxsize=64)
def recorded(scan: Scan) -> bench.ScanRecord:
    """A scan in the cautious loop, which has no observer."""
    plant = plant_of(scan.plant)
    return bench.record(bench.assemble(plant, truth_of(scan), bench.BANDWIDTH_RATIO_LOW, estimated=False))


def estimate_scores(
    entrant: str, source: str | None, scan: Scan, knobs: tuple[float, ...]
) -> dict[str, float]:
    """Errors of the rigid-body and the flexible states relative to those of the estimate zero, time and memory.

    Microseconds a sample: of one of ours without its design; of a file all that its process takes, over its samples.
    """
    record, given = recorded(scan), scan.given()
    with opened(entrant, source, given, knobs) as observer:
        if source is not None:
            estimates = bench.run_scan(bench.open_scan(record, len(given[0].a)), observer.step)
        else:
            observer.step(record.inputs[0], record.measurements[0])  # compiles it
            observer.start(*given)
            began = time.thread_time()  # what else the machine does is not the observer's time
            estimates = observer.run(record.inputs, record.measurements)
            taken, held = time.thread_time() - began, float(observer.bytes)
    if source is not None:
        taken, held = observer.cpu_seconds, np.nan
    rigid, flexible = bench.state_errors(record, estimates, given[0].rigid_modes)
    return {"flexible": flexible, "rigid": rigid, "microseconds": 1e6 * taken / len(estimates), "bytes": held}


def loop_scores(scan: Scan, run: Callable) -> dict[str, float]:
    """Errors in the loop, of the scan and under an unknown force, over those of the cautious loop without an observer."""
    bold = bench.assemble(plant_of(scan.plant), truth_of(scan), bench.BANDWIDTH_RATIO_HIGH, estimated=True)
    # Machine and setpoint are those of the cautious loop.
    cautious = bench.loop_errors(bold, recorded(scan).states)
    ratios = bench.loop_errors(bold, run(bench.loop_scan(bold))) / cautious
    return {"tracking": float(ratios[0]), "rejection": float(ratios[1])}


def scores_of(entrant: str, source: str | None, scan: Scan, knobs: tuple[float, ...]) -> dict[str, float]:
    """What an observer gets on a scan, by score."""
    if scan.track == "estimate":
        return {} if entrant == ORACLE else estimate_scores(entrant, source, scan, knobs)

    def run(task: bench.Scan) -> np.ndarray:
        with opened(entrant, source, scan.given(), knobs) as observer:
            return bench.run_scan(task, observer.step)

    if scan.track == "loop":
        return loop_scores(scan, run)
    return {"bandwidth": bench.allowed_bandwidth(plant_of(scan.plant), truth_of(scan), run)}


def contest_trial(
    tasks: Sequence[tuple[Scan, Mapping[str, tuple[float, ...]]]], sources: Mapping[str, str]
) -> tuple[list[Scored], dict[str, str]]:
    """Scores on these scans, each with the settings of its entrants, and who was disqualified, with the reason.

    `sources` are those of observers that are not ours, by name.
    """
    scores: list[Scored] = []
    out: dict[str, str] = {}
    for scan, settings in tasks:
        for name, knobs in settings.items():
            if name in out:
                continue
            try:
                found = scores_of(name, sources.get(name), scan, knobs)
            except Disqualified as reason:
                out[name] = str(reason)
            else:
                scores += [Scored(name, scan, score, value) for score, value in found.items()]
    return scores, out
