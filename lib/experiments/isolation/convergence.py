"""Initial convergence: time constants and final values as in Table 1."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.isolation.floors import ShapedFloor
from experiments.isolation.simulation import simulate, simulate_together
from experiments.isolation.twin import Twin
from stillwork.base.checks import require_array, require_number
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.mean_adaptation import Steady
from workbook.palette import BLACK, GREEN

ALGORITHMS = ("FeLMS", "FeRLS")
STYLES = {"FeLMS": "--", "FeRLS": "-"}
COLOURS = {"FeLMS": GREEN, "FeRLS": BLACK}  # as in Figs. 7 and 8
SHARE = 0.63  # half width of the band around the final value, Table 1
FINAL_SHARE = 0.1  # of a run, at its end, whose mean is the final value


@dataclass(frozen=True)
class Course:
    """Weights and quadratic filtered error over a run of one algorithm."""

    time_s: Float64[np.ndarray, " kept"]
    weights: Float64[np.ndarray, "kept parameters"]  # those of the first actuator
    error_power: Float64[np.ndarray, " kept"]  # quadratic filtered error, mean over each interval, N^2

    @property
    def final(self) -> Float64[np.ndarray, " parameters"]:
        """Final values: means over the last tenth of the run."""
        return self.weights[-self._tail :].mean(axis=0)

    @property
    def deviation(self) -> Float64[np.ndarray, " parameters"]:
        """Standard deviation over the last tenth of the run."""
        return self.weights[-self._tail :].std(axis=0)

    @property
    def final_error(self) -> float:
        """Quadratic filtered error over the last tenth of the run, N^2."""
        return float(self.error_power[-self._tail :].mean())

    @property
    def _tail(self) -> int:
        return max(round(FINAL_SHARE * len(self.time_s)), 1)


def settling_times(
    time_s: ArrayLike, traces: ArrayLike, final: ArrayLike, share: float = SHARE
) -> Float64[np.ndarray, " parameters"]:
    """Time after which each trace stays within 63 % of its final value, as the caption of Table 1 has it.

    It is the first kept time from which on no value is further from the final one than `share` of it. Noise is not
    smoothed away: a trace whose noise exceeds the band of a small final value never settles, and gets the end. A
    share of 0.63 is the caption to the letter; 0.37 would be the time constant of a first-order course from zero, 2.2
    times longer.
    """
    time_s = require_array("time_s", time_s, ndim=1)
    traces = require_array("traces", traces, shape=(len(time_s), None))
    final = require_array("final", final, shape=(traces.shape[1],))
    outside = np.abs(traces - final) > share * np.abs(final)
    # First kept time from which on all are inside; the end of the trace when the last one is outside.
    inside_from = np.where(outside.any(axis=0), len(time_s) - np.argmax(outside[::-1], axis=0), 0)
    return time_s[np.minimum(inside_from, len(time_s) - 1)]


def algorithms(
    steady: Steady,
    *,
    step_size: float,
    trace: str,
    memory_s: float,
    initial_covariance: float,
    sample_time: float,
) -> dict[str, FeLms | FeRls]:
    """The two algorithms with the settings of Section 5.1.1.

    `trace` is the reading of eq. (18), ``regressors`` or ``literal``; P(-1) is diagonal with `initial_covariance`
    times the steady diagonal.
    """
    require_number("memory_s", memory_s, above=0.0)
    require_number("initial_covariance", initial_covariance, above=0.0)
    forgetting = float(np.exp(-sample_time / memory_s))
    inverse = np.diag(np.linalg.inv(steady.correlation))
    return {
        "FeLMS": FeLms(step_size=step_size, trace=trace),
        "FeRLS": FeRls(initial_covariance * (1 - forgetting) * inverse, forgetting),
    }


def converge(
    twin: Twin,
    floor: ShapedFloor,
    adaptations: Mapping[str, FeLms | FeRls],
    duration_s: float,
    seeds: Sequence[int],
) -> list[dict[str, Course]]:
    """For each seed the course of each of several algorithms from zero weights, on one floor; kept every 0.1 s."""
    runs = simulate_together(twin, floor, duration_s, seeds=seeds, adaptations=adaptations)
    return [
        {
            name: Course(run.time_s, np.ascontiguousarray(run.weights[:, 0]), run.error_power)
            for name, run in each.items()
        }
        for each in runs
    ]


@dataclass(frozen=True)
class Starts:
    """What FeRLS does in the first seconds from P(-1) = I / epsilon."""

    epsilon: Float64[np.ndarray, " starts"]
    # largest command, N; that of the last sample before it where the run was stopped
    peak_command: Float64[np.ndarray, " starts"]
    stopped_s: Float64[np.ndarray, " starts"]  # when it was stopped as unstable; NaN where it went on


def try_starts(
    twin: Twin, floor: ShapedFloor, epsilons: ArrayLike, forgetting: float, duration_s: float, seed: int
) -> Starts:
    """Start FeRLS from zero weights and P(-1) = I / epsilon for several epsilon (squared units of the regressors)."""
    epsilons = require_array("epsilons", epsilons, ndim=1)
    options = {"signals_from_s": 0.0, "signals": ["command"], "to_the_break": True}
    peaks, stops = [], []
    for epsilon in epsilons:
        start = 1 / require_number("epsilons", epsilon, above=0.0)
        adaptation = FeRls(start, forgetting, growth_limit=np.inf)
        run = simulate(twin, floor, duration_s, adaptation=adaptation, seed=seed, **options)
        peaks.append(np.abs(run.command).max())
        stops.append(np.nan if run.broke_s is None else run.broke_s)
    return Starts(epsilons, np.array(peaks), np.array(stops))
