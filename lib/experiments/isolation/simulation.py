"""Closed-loop runs of a twin: passive, with feedback, with frozen or self-tuned feedforward."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.isolation import loop
from experiments.isolation.recorded_floors import LOUDEST, RecordedFloor
from experiments.isolation.sources import BLOCK, Floor, Sources
from experiments.isolation.twin import Twin
from stillwork.base.checks import (
    InputError,
    pluralise,
    require_array,
    require_choice,
    require_count,
    require_number,
)
from stillwork.estimation.adaptive import FeLms, FeRls, Recursion
from stillwork.estimation.online import UnstableAdaptation

TOGETHER = 8  # runs in one kernel

SIGNALS = (*loop.Signals._fields[:6], "floor")  # of a `Run`: what the kernel leaves behind, and the floor


@dataclass(frozen=True)
class Run:
    """What a closed-loop run leaves behind."""

    sample_rate: float  # Hz
    time_s: Float64[np.ndarray, " kept"]  # end of each interval of the two histories below
    weights: Float64[np.ndarray, "kept actuators regressors"]  # W, N per (m/s^2)
    error_power: Float64[np.ndarray, " kept"]  # quadratic filtered error e'e, mean over the interval, N^2
    final_weights: Float64[np.ndarray, "actuators regressors"]  # W after the last sample, or at the break
    covariance: Float64[np.ndarray, "regressors regressors"]  # P after the last sample; one unless FeRLS ran
    # share of the last time constant in which FeRLS's `growth_limit` acted on each regressor
    held: Float64[np.ndarray, " regressors"]
    # from `signals_from_s` on; those not asked for are empty
    floor: Float64[np.ndarray, "sensors _"]  # a0 without noise, m/s^2
    platform: Float64[np.ndarray, "outputs _"]  # a1 without noise, m/s^2
    # sensed_floor, measured_platform: the same through noisy sensors and their conditioners: what the
    # controller and an analyser see
    sensed_floor: Float64[np.ndarray, "sensors _"]
    measured_platform: Float64[np.ndarray, "outputs _"]
    command: Float64[np.ndarray, "actuators _"]  # u, N
    filtered_regressors: Float64[np.ndarray, "regressors _"]  # psi_N
    error: Float64[np.ndarray, "actuators _"]  # e, N
    broke_s: float | None = None  # when it was stopped as unstable; what is kept ends before


def simulate(
    twin: Twin,
    floor: Floor | list[tuple[float, Floor]],
    duration_s: float | None = None,
    *,
    adaptation: FeLms | FeRls | None = None,
    seed: int = 0,
    **settings,
) -> Run:
    """Run a twin in closed loop from rest.

    The four cases of the paper: ``feedback=False`` (passive); nothing else (feedback only); ``weights=W``
    (feedforward with frozen weights); ``adaptation=FeLms()`` or ``FeRls(...)``, from `weights` or from zero.
    A list of (seconds, floor) changes the floor in mid-run, at once. The floor's motion and each noise draw from
    their own stream of `seed`: runs with the same seed see the same floor, whatever the controller does. An
    adaptation that diverges raises `UnstableAdaptation` with the sample and the cause. All `settings` are those of
    `simulate_together`.
    """
    together = simulate_together(
        twin, floor, duration_s, adaptations={"": adaptation}, seeds=[seed], **settings
    )
    return together[0][""]


def sample_seeds(draws: Sequence[np.random.Generator]) -> list[int]:
    """A seed of each generator, for the runs of `simulate_together`."""
    return [int(rng.integers(2**31)) for rng in draws]


def simulate_together(
    twin: Twin,
    floor: Floor | list[tuple[float, Floor]],
    duration_s: float | None = None,
    *,
    seeds: Sequence[int],
    adaptations: Mapping[str, FeLms | FeRls | None],
    weights: ArrayLike | None = None,
    feedback: bool = True,
    noise: bool = True,
    keep_every_s: float = 0.1,
    signals_from_s: float | None = None,
    signals: Collection[str] = SIGNALS,
    to_the_break: bool = False,
) -> list[dict[str, Run]]:
    """For each seed what `simulate` gives for each of several algorithms, on a floor and noises that are drawn once.

    Several seeds go through one kernel, with the same bits in less time. Weights and error power are kept
    every `keep_every_s`; from `signals_from_s` on `signals` are, at the full rate. `weights` are those of all runs, or
    one W for each seed. The first run that diverges ends
    them all; `to_the_break` keeps that of one seed and one algorithm up to there instead of raising.
    """
    seeds = [require_count("seed", seed, at_least=0) for seed in seeds]
    if to_the_break and (len(seeds) > 1 or len(adaptations) > 1):
        raise InputError("to_the_break keeps one run; give one seed and one algorithm")
    rate = twin.instruments.sample_rate
    every = require_count("keep_every_s times the sample rate", round(keep_every_s * rate))
    segments = _segments(twin, floor, duration_s)
    total = sum(samples for samples, _ in segments)
    if total < 1:
        raise InputError(f"duration_s is {duration_s}; give at least one sample")
    start = _start(twin, weights, len(seeds))
    for signal in signals:
        require_choice("signals", signal, SIGNALS)
    first = _first_kept(signals_from_s, total, rate)
    runs = 1 if len(seeds) == 1 else TOGETHER
    each = np.broadcast_to(start, (len(seeds), *start.shape[-2:]))
    found = []
    for at in range(0, len(seeds), runs):
        batch, sides = seeds[at : at + runs], []
        places = np.minimum(np.arange(at, at + runs), len(seeds) - 1)
        for adaptation in adaptations.values():
            law, recursion = algorithm_of(twin, adaptation)
            delay = None if adaptation is None else adaptation.path_delay
            closed = loop.loop_of(twin, feedback, each[places], recursion, delay)
            kept = KeptSignals(twin, total, every, first, runs, signals)
            sides.append((adaptation, law, closed, kept))
        until, broke_s = total, None
        try:
            _advance(twin, Sources(twin, segments, noise, batch, runs), sides, total, first, start)
        except UnstableAdaptation as error:
            if not to_the_break:
                raise
            until, broke_s = error.sample, error.sample * twin.sample_time
        pairs = list(zip(adaptations, sides, strict=True))
        found += [
            {name: kept.run(rate, closed, run, until, broke_s) for name, (*_, closed, kept) in pairs}
            for run in range(len(batch))
        ]
    return found


def _start(twin: Twin, weights: ArrayLike | None, count: int) -> np.ndarray:
    """The weights W at the start, of all runs or one for each of `count` seeds."""
    shape = (twin.actuators, twin.regressors)
    start = require_array("weights", np.zeros(shape) if weights is None else weights)
    return require_array("weights", start, shape=(count, *shape) if start.ndim == 3 else shape)


def _first_kept(signals_from_s: float | None, total: int, rate: float) -> int:
    """The sample from which on signals are kept; `total` if none are."""
    if signals_from_s is None:
        return total
    first = round(require_number("signals_from_s", signals_from_s, at_least=0.0) * rate)
    if first >= total:
        raise InputError(
            f"signals_from_s is {signals_from_s:g} but the run lasts {total / rate:g} s; give less"
        )
    return first


def _advance(twin: Twin, sources: Sources, sides: list, total: int, first: int, start: np.ndarray) -> None:
    """Run the algorithms of `sides` over the same samples, block by block, as many runs at a time as the sources are."""
    done = 0
    while done < total:
        # A block ends where the signals start.
        samples = min(BLOCK, (first if done < first else total) - done)
        floor_block, noise_block = sources.sample(samples)
        for adaptation, law, closed, kept in sides:
            room = kept.room("floor", done, samples)
            room[:] = floor_block[: len(room)]
            status, reached, stopped = loop.advance(
                floor_block,
                noise_block,
                closed,
                kept.block(done, samples),
                kept.every,
                done % kept.every,
                law,
                *closed.recursion[-2:],
                twin.instruments.force_limit,
            )
            if status != loop.STABLE:
                peak = np.abs(floor_block[:, stopped]).max()
                raise _unstable(status, done + reached, twin, adaptation, start, peak)
        done += samples


def algorithm_of(twin: Twin, adaptation) -> tuple[loop.Law, Recursion]:
    """What the kernel does, and the recursion of FeRLS at the start."""
    n = twin.regressors
    if isinstance(adaptation, FeRls):
        return loop.Law(loop.FERLS, modified=adaptation.path_delay is not None), adaptation.start(n)
    still = FeRls(1.0).start(n)
    if isinstance(adaptation, FeLms):
        numbers = (adaptation.step_size, adaptation.regularisation, adaptation.trace_copies(twin.actuators))
        return loop.Law(loop.FELMS, *numbers, adaptation.path_delay is not None), still
    if adaptation is not None:
        raise InputError(f"adaptation is {adaptation!r}; give FeLms(...), FeRls(...) or None")
    return loop.Law(loop.FROZEN), still


def _segments(twin: Twin, floor, duration_s) -> list[tuple[int, Floor]]:
    rate = twin.instruments.sample_rate
    given = floor if isinstance(floor, list) else [(duration_s, floor)]
    if not given:
        raise InputError("floor is an empty list; give (seconds, floor) pairs")
    segments = []
    for seconds, part in given:
        if part.channels != twin.sensors:
            raise InputError(
                f"floor has {pluralise(part.channels, 'channel')} but the rig has {pluralise(twin.sensors, 'floor sensor')}; give as many"
            )
        if part.sample_rate != rate:
            raise InputError(
                f"floor is sampled at {part.sample_rate:g} Hz but the rig at {rate:g} Hz; resample it first"
            )
        longest = part.acceleration.shape[1] if isinstance(part, RecordedFloor) else None
        if seconds is not None:
            samples = round(require_number("duration_s", seconds, above=0.0) * rate)
        elif longest is not None:
            samples = longest
        else:
            raise InputError("duration_s is missing; give the seconds to run")
        if longest is not None and samples > longest:
            raise InputError(
                f"floor record lasts {part.duration:g} s, shorter than the required {seconds:g} s; "
                "shorten duration_s or give a longer record"
            )
        segments.append((samples, part))
    if isinstance(floor, list) and duration_s is not None:
        raise InputError("duration_s: a list of floors has its own durations; leave it out")
    return segments


def _unstable(status: int, sample: int, twin: Twin, adaptation, weights, peak: float) -> UnstableAdaptation:
    if status == loop.INDEFINITE:
        return UnstableAdaptation(
            sample,
            "the covariance is no longer positive definite",
            "start with a smaller initial_covariance or give it a finite growth_limit",
        )
    cause = f"a command exceeds the force limit of {twin.instruments.force_limit:g} N"
    if peak > LOUDEST:  # no loop is to blame
        cause += f" while the floor accelerates by {peak:.3g} m/s^2"
        return UnstableAdaptation(sample, cause, "that is beyond 1 g: check the floor's unit", "the platform")
    if adaptation is not None:
        small = "step_size" if isinstance(adaptation, FeLms) else "initial_covariance"
        advice = f"start with a smaller {small}, better weights or a better path estimate"
        if isinstance(adaptation, FeRls):  # a start only delays what the memory lets happen
            advice += "; against strong motion of the floor at 0.5 to 1 Hz only a high-pass over it helps"
        return UnstableAdaptation(sample, cause, advice)
    if weights.any():
        advice = "nothing adapts here: give smaller weights, or a smaller skyhook gain"
        return UnstableAdaptation(sample, cause, advice, "the loop with the given weights")
    return UnstableAdaptation(sample, cause, "give the skyhook a smaller gain", "the skyhook loop")


class KeptSignals:
    """Arrays that outlive the blocks; of several runs side by side a row of channels a run."""

    def __init__(
        self, twin: Twin, total: int, every: int, first: int, runs: int, signals: Collection[str] = SIGNALS
    ):
        long = max(total - first, 0)
        self.first, self.every, self.runs, self.signals = first, every, runs, signals
        n = twin.sensors
        widths = (twin.outputs, twin.outputs, n, twin.actuators, twin.regressors, twin.actuators, n)
        # The kernel writes all of them or none: what is not wanted goes where the next block's will.
        self.long = {
            name: np.empty((long if name in signals else min(long, BLOCK), runs, width))
            for name, width in zip(SIGNALS, widths, strict=True)
        }
        self.weights = np.empty((total // every, runs, twin.actuators, twin.regressors))
        self.power = np.empty((total // every, runs))

    def block(self, done: int, samples: int) -> loop.Signals:
        """Views for the kernel to fill."""
        long = [self.room(name, done, samples) for name in SIGNALS[:-1]]
        rows = slice(done // self.every, (done + samples) // self.every)  # due in this block
        return loop.Signals(*long, self.weights[rows], self.power[rows])

    def room(self, name: str, done: int, samples: int) -> np.ndarray:
        """Where a signal of a block goes: nowhere before the first that is kept."""
        if done < self.first:
            return self.long[name][:0]
        start = done - self.first if name in self.signals else 0
        return self.long[name][start : start + samples]

    def run(self, rate: float, closed: loop.ClosedLoop, run: int, until: int, broke_s: float | None) -> Run:
        """One of the runs, its first `until` samples."""
        rows = until // self.every

        recursion = closed.recursion._replace(
            matrix=closed.recursion.matrix[run], levels=closed.recursion.levels[run]
        )
        long, signals = max(until - self.first, 0), {}
        for name, array in self.long.items():
            signals[name] = np.ascontiguousarray(array[: long if name in self.signals else 0, run]).T
        return Run(
            sample_rate=rate,
            time_s=self.every / rate * np.arange(1, rows + 1),
            weights=np.ascontiguousarray(self.weights[:rows, run]),
            error_power=np.ascontiguousarray(self.power[:rows, run]),
            final_weights=closed.weights[run].astype(float),
            covariance=recursion.covariance,
            held=recursion.held,
            broke_s=broke_s,
            **signals,
        )
