"""One seed of the contest on one plant: every observer on the same scans, open and in the loop."""

import time
from collections.abc import Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from contest import bench
from contest.adaptive import ADAPTIVE
from contest.fixed_gain import FIXED
from contest.multi_model import MULTI_MODEL
from contest.nominal import Baseline, OwnObserver, nominal_of
from contest.parametric import PARAMETRIC
from contest.plants import ContestPlant, sample_plant
from contest.runner import Disqualified, ExternalObserver
from contest.uncertainties import UNCERTAINTIES, hidden_seed, sample_truth

ENTRANTS: Mapping[str, Baseline] = {**FIXED, **PARAMETRIC, **ADAPTIVE, **MULTI_MODEL}


SCORES = ("rigid", "flexible", "tracking", "peak")


class Scored(NamedTuple):
    """What one observer got on one scan."""

    entrant: str
    plant: str
    doubt: str
    seed: int
    rigid: float  # errors of the states relative to those of the estimate zero
    flexible: float
    tracking: float  # rms error in the loop over the cautious loop's; infinite where it runs away
    peak: float  # the same of the largest error
    microseconds: float  # a sample, on the scan outside the loop
    bytes: int  # that the observer holds; 0 for a foreign one


def contest_trial(
    plant: str,
    seed: int,
    public: str,
    settings: Mapping[str, Sequence[float]],
    files: Mapping[str, str],
    doubts: Sequence[str] = tuple(UNCERTAINTIES),
    loops: bool = True,
) -> tuple[list[Scored], dict[str, str]]:
    """Scores of all observers on one plant at one hidden seed, and who was shown to the door, with the reason.

    `settings` says where the knobs of our entrants stand, `files` holds foreign observers by name.
    """
    machine = sample_plant(plant, np.random.default_rng(hidden_seed(public, plant, seed)))
    prepared = [_prepare(machine, doubt, hidden_seed(public, plant, seed, doubt)) for doubt in doubts]
    scores: list[Scored] = []
    out: dict[str, str] = {}
    for name, knobs in settings.items():
        own = OwnObserver(ENTRANTS[name], tuple(knobs), _designs(name, tuple(knobs)))
        scores += _judged(name, plant, seed, prepared, _own_scans(own, prepared, loops))
    for name, file in files.items():
        try:
            scores += _judged(name, plant, seed, prepared, _foreign_scans(file, prepared, loops))
        except Disqualified as reason:
            out[name] = str(reason)
    return scores, out


class _Prepared(NamedTuple):
    """One doubt's scan, and what the observers are told of it."""

    doubt: str
    cautious: bench.Bench
    bold: bench.Bench
    record: bench.ScanRecord
    told: tuple


def _prepare(machine: ContestPlant, doubt: str, stream: int) -> _Prepared:
    truth = sample_truth(machine, UNCERTAINTIES[doubt], bench.SAMPLES, np.random.default_rng(stream))
    cautious = bench.assemble(machine, truth, bench.BANDWIDTH_RATIO_LOW, estimated=False)
    bold = bench.assemble(machine, truth, bench.BANDWIDTH_RATIO_HIGH, estimated=True)
    told = (*nominal_of(machine, UNCERTAINTIES[doubt].noise), machine.sample_time)
    return _Prepared(doubt, cautious, bold, bench.record(cautious), told)


@cache  # they serve all seeds, and every thread of a worker
def _designs(name: str, knobs: tuple[float, ...]) -> dict:
    return {}


def _own_scans(observer: OwnObserver, prepared: Sequence[_Prepared], loops: bool) -> list[tuple]:
    """Estimates, microseconds a sample, states in the loop (None without) and bytes, a scan each."""
    results = []
    for each in prepared:
        observer.start(*each.told)
        observer.step(each.record.inputs[0], each.record.measurements[0])  # compiles it
        observer.start(*each.told)
        began = time.thread_time()  # what else the machine does is not the observer's time
        estimates = observer.run(each.record.inputs, each.record.measurements)
        taken = 1e6 * (time.thread_time() - began) / len(estimates)
        moved = None
        if loops:
            observer.start(*each.told)
            scan = bench.loop_scan(each.bold)
            [moved] = bench.run_scans([scan], lambda _, u, y: [observer.step(u[0], y[0])])
        results.append((estimates, taken, moved, observer.bytes))
    return results


def _foreign_scans(file: str, prepared: Sequence[_Prepared], loops: bool) -> list[tuple]:
    """The same of a foreign observer, all scans side by side; its time is that of an average sample, pipe and all."""
    states = len(prepared[0].told[0].a)
    scans = [bench.open_scan(each.record, states) for each in prepared]
    scans += [bench.loop_scan(each.bold) for each in prepared if loops]
    with ExternalObserver(file) as observer:
        observer.start([each.told for each in prepared] * (2 if loops else 1))
        began = time.perf_counter()
        results = bench.run_scans(scans, observer.step)
        taken = 1e6 * (time.perf_counter() - began) / (len(scans) * bench.SAMPLES)
    moved = results[len(prepared) :] or [None] * len(prepared)
    return [(results[k], taken, moved[k], 0) for k in range(len(prepared))]


def _judged(name, plant, seed, prepared, results) -> list[Scored]:
    found = []
    for each, (estimates, taken, moved, held) in zip(prepared, results, strict=True):
        loop = np.full(2, np.nan)
        if moved is not None:
            steady = bench.tracking_errors(each.cautious, each.record.states)
            loop = bench.tracking_errors(each.bold, moved) / steady
        errors = bench.state_errors(each.record, estimates, each.told[0].rigid_modes)
        found.append(Scored(name, plant, each.doubt, seed, *errors, *map(float, loop), taken, held))
    return found
