"""A floor direction that falls silent and comes back, in a twin's closed loop."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from experiments.isolation.floors import ShapedFloor
from experiments.isolation.simulation import simulate
from experiments.isolation.twin import Twin
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.estimation.online import UnstableAdaptation


@dataclass(frozen=True)
class ErrorRecord:
    """Filtered error of one closed-loop run, to its end or to where it broke."""

    time_s: Float64[np.ndarray, "kept"]  # end of each interval
    error: Float64[np.ndarray, "kept"]  # filtered error, root mean square over the interval, N
    broke_s: float | None  # when the adaptation was stopped as unstable

    def peak(self, from_s: float) -> float:
        """Largest error from a moment on over the mean of the ten seconds before it; infinite if it broke."""
        if self.broke_s is not None:
            return float("inf")
        before = (self.time_s > from_s - 10) & (self.time_s <= from_s)
        return float(self.error[self.time_s > from_s].max() / self.error[before].mean())


def run_to_the_end(
    twin: Twin, stages: list[tuple[float, ShapedFloor]], adaptation: FeLms | FeRls, seed: int
) -> ErrorRecord:
    """Run stages of (seconds, floor) as `simulate` does; an unstable run is kept up to where it broke."""
    settings = {"adaptation": adaptation, "seed": seed, "keep_every_s": 0.02}
    try:
        run, broke_s = simulate(twin, stages, **settings), None
    except UnstableAdaptation as error:
        broke_s = error.sample * twin.sample_time
        cut, left = [], broke_s - twin.sample_time
        for seconds, floor in stages:
            if left > 0:
                cut.append((min(seconds, left), floor))
            left -= seconds
        run = simulate(twin, cut, **settings)
    return ErrorRecord(run.time_s, np.sqrt(run.error_power), broke_s)
