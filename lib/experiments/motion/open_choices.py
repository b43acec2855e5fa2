"""How far the published bandwidths depend on what the thesis does not print."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.designs import DAMPING, DESIGNS, Design, stage_bandwidth, stage_loops
from experiments.motion.machines import published_deviations, stage_mass
from stillwork.base.checks import InputError, require_array
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Bandwidth, PeakConstraint, maximise_bandwidth
from stillwork.control.pid import PidFamily
from stillwork.estimation.observer import NoiseIntensities


def sensor_noise_alone() -> NoiseIntensities:
    """Half the printed R: the sensor noise without the sensor reference, R = sigma_d^2."""
    sigma = published_deviations()
    return NoiseIntensities(sigma["w"] ** 2, sigma["d"] ** 2)


CHOICES = {
    "as published": {},
    "6 dB taken as 2": {"limit": 2.0},
    "R = sensor noise alone": {"noise": sensor_noise_alone},
    "grid of 2000 points": {"points": 2000, "around": 0, "low_hz": 1.0, "high_hz": 1e4, "refine": False},
    "grid of 10000 points": {"points": 10000, "around": 0, "low_hz": 1.0, "high_hz": 1e4, "refine": False},
    "damping 0.1 %": {"damping_ratio": 0.001},
}

# What the text leaves open. R is printed, so another R is a sensitivity and no reading; the coarse grids
# are errors, and Table 3.4 refutes the damping of 0.1 %.
LEGITIMATE = ("as published", "6 dB taken as 2")


@dataclass(frozen=True)
class OpenChoices:
    """One design under every choice."""

    found: dict[str, Bandwidth]

    @property
    def published(self) -> Bandwidth:
        return self.found["as published"]

    @property
    def crossing(self) -> float:
        """First 0 dB crossing for the measured mass 5 of the chapter (Hz)."""
        return float(self.published.crossing_hz[4])

    @property
    def interval(self) -> tuple[float, float]:
        """Crossings over the seven masses and the readings of 6 dB, widened by half a printed hertz."""
        crossings = np.concatenate([self.found[name].crossing_hz for name in LEGITIMATE])
        return float(crossings.min() - 0.5), float(crossings.max() + 0.5)


def open_choices(name: str) -> OpenChoices:
    """Bandwidth of a published design under each of `CHOICES`; without an observer R has no effect."""
    found = {}
    for choice, given in CHOICES.items():
        settings = dict(given)
        if "noise" in settings:
            settings["noise"] = settings["noise"]()
            if DESIGNS[name].application is None:  # no observer: R has no effect
                found[choice] = found["as published"]
                continue
        if "damping_ratio" in settings and DESIGNS[name].application is not None:
            continue  # the observer's damping target would change with it: shown for the PID designs only
        found[choice] = stage_bandwidth(name, **settings)
    return OpenChoices(found)


def first_crossing(setting: Design, position: int) -> float:
    """First crossing at one mass (Hz) of a design's largest bandwidth, searched quicker on a coarser grid; NaN: there is none."""
    loops = stage_loops(setting, points=300, around=15)
    limits = [PeakConstraint(function) for function in setting.constraints]
    try:
        family = PidFamily(stage_mass())
        found = maximise_bandwidth(loops, family, limits, 20.0, 110.0, scan=46, tolerance_hz=0.02)
    except InputError:  # no feasible bandwidth is a result here
        return np.nan
    return float(found.crossing_hz[position - 1])


def bandwidth_map(selectivity: ArrayLike, noise_model: ArrayLike) -> Float64[np.ndarray, "rows columns"]:
    """First crossings (Hz) at mass 5 of MC and AD together over (Q, Q_nu), the search of (3.47) as a map.

    NaN where nothing in the range is feasible.
    """
    rows = require_array("selectivity", selectivity, ndim=1)
    columns = require_array("noise_model", noise_model, ndim=1)
    for name, values in (("selectivity", rows), ("noise_model", columns)):
        if not len(values) or np.any(values <= 0):
            raise InputError(f"{name} must hold at least one value, all of them positive")
    uses = [Application(True, DAMPING, selectivity=float(q)) for q in rows]
    return np.array([[first_crossing(Design(used, float(size)), 5) for size in columns] for used in uses])
