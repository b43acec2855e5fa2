"""One seed of the contest on one plant: every observer on the same scans, one scan at a time."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np

from contest import bench
from contest.fixed_gain import FIXED
from contest.nominal import Baseline, OwnObserver, nominal_of
from contest.parametric import PARAMETRIC
from contest.plants import plant_of
from contest.runner import FileObserver
from contest.set_membership import SET_MEMBERSHIP
from contest.uncertainties import UNCERTAINTIES, Truth, hidden_seed, sample_truth

ENTRANTS: Mapping[str, Baseline] = {
    **FIXED,
    **PARAMETRIC,
    **SET_MEMBERSHIP,
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


def observer_of(
    entrant: str, file: str | None, knobs: tuple[float, ...]
) -> OwnObserver | FileObserver | Oracle:
    """An observer before a scan: the one of a `file`, or one of ours."""
    if file is not None:
        return FileObserver(file, knobs)
    return Oracle() if entrant == ORACLE else OwnObserver(ENTRANTS[entrant], knobs, _designs(entrant, knobs))


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


def estimate_scores(entrant: str, file: str | None, scan: Scan, knobs: tuple[float, ...]) -> dict[str, float]:
    """Errors of the rigid-body and the flexible states relative to those of the estimate zero."""
    record, given = recorded(scan), scan.given()
    observer = observer_of(entrant, file, knobs)
    observer.start(*given)
    estimates = observer.run(record.inputs, record.measurements)
    rigid, flexible = bench.state_errors(record, estimates, given[0].rigid_modes)
    return {"flexible": flexible, "rigid": rigid}


def loop_scores(scan: Scan, run: Callable) -> dict[str, float]:
    """Errors in the loop, of the scan and under an unknown force, over those of the cautious loop without an observer."""
    bold = bench.assemble(plant_of(scan.plant), truth_of(scan), bench.BANDWIDTH_RATIO_HIGH, estimated=True)
    # Machine and setpoint are those of the cautious loop.
    cautious = bench.loop_errors(bold, recorded(scan).states)
    ratios = bench.loop_errors(bold, run(bench.loop_scan(bold))) / cautious
    return {"tracking": float(ratios[0]), "rejection": float(ratios[1])}


def scores_of(entrant: str, file: str | None, scan: Scan, knobs: tuple[float, ...]) -> dict[str, float]:
    """What an observer gets on a scan, by score."""
    if scan.track == "estimate":
        return {} if entrant == ORACLE else estimate_scores(entrant, file, scan, knobs)

    def run(task: bench.Scan) -> np.ndarray:
        observer = observer_of(entrant, file, knobs)
        observer.start(*scan.given())
        return bench.run_scan(task, observer.step)

    if scan.track == "loop":
        return loop_scores(scan, run)
    return {"bandwidth": bench.allowed_bandwidth(plant_of(scan.plant), truth_of(scan), run)}


def rows_of(settings: Mapping[str, tuple[float, ...]], scans: Sequence[Scan]) -> list[tuple]:
    """Rows (score, public number, machine, uncertainty, seed, entrant, value) of ours with these settings."""
    return [
        (score, scan.public, scan.plant, scan.uncertainty, scan.seed, name, value)
        for scan in scans
        for name, knobs in settings.items()
        for score, value in scores_of(name, None, scan, knobs).items()
    ]
