"""A sensor at a node of a mode: what passing it, and staying there, does to the estimate (section 4.2.1)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.position_dependence import require_seen
from experiments.motion.positions import shapes_along
from experiments.motion.scan_study import along_scan
from stillwork.base.checks import InputError, require_array, require_count, require_number
from stillwork.estimation.observer import NoiseIntensities
from stillwork.estimation.robust import kalman_gains
from stillwork.estimation.time_varying import estimate
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel

AMPLITUDE = 0.01  # N, of the force


@dataclass(frozen=True)
class Passage:
    """True and estimated modal position of one mode while the sensor follows a trajectory."""

    time: Float64[np.ndarray, " samples"]  # s
    places: Float64[np.ndarray, " samples"]  # m
    truth: Float64[np.ndarray, " samples"]  # m sqrt(kg)
    estimate: Float64[np.ndarray, " samples"]  # m sqrt(kg)

    def worst(self, start: float, end: float) -> float:
        """Largest estimation error between two times (s), relative to the mode's largest motion there."""
        window = (self.time >= start) & (self.time <= end)
        if not window.any():
            raise InputError(f"start and end are {start:g} and {end:g} s; no sample lies between them")
        size = np.abs(self.truth[window]).max()
        return float(np.abs(self.truth - self.estimate)[window].max() / size)


def move(start: float, wait: float, speed: float, length: float, rest: float, step: float) -> np.ndarray:
    """Places (m): stand at `start` for `wait` s, move `length` m at `speed` m/s, stand for `rest` s."""
    for name, value in (("speed", speed), ("length", length), ("step", step)):
        require_number(name, value, above=0.0)
    time = np.arange(round((wait + length / speed + rest) / step) + 1) * step
    return start + np.clip(speed * (time - wait), 0.0, length)


def pass_node(
    plant: ModalModel,
    grid: ArrayLike,
    places: ArrayLike,
    mode: int,
    noise: NoiseIntensities,
    step: float,
    phase: float = 0.0,
) -> Passage:
    """Run the time-varying Kalman filter while a force that it does not know excites one mode at its resonance.

    The filter knows all modes of the plant and is designed for `noise`; the sensor follows `places` (m).
    """
    places = require_array("places", places, ndim=1)
    if require_count("mode", mode, at_least=plant.rigid_modes) >= len(plant.frequencies):
        raise InputError(f"mode is {mode}; the plant has modes 0 to {len(plant.frequencies) - 1}")
    require_seen(plant, grid, places, range(plant.rigid_modes))
    model = along_scan(
        plant, step, shapes_along(plant, grid, places), noise.process / step, noise.sensor / step
    )
    time = np.arange(len(places)) * step
    force = AMPLITUDE * np.sin(plant.frequencies[mode] * time + phase)
    a, b = model.a[0], model.b[0]
    states = simulate(StateModel(a, b, np.eye(len(a)), np.zeros_like(b), step), force[None])
    y = np.einsum("koi,ik->ok", model.c, states)
    found = estimate(kalman_gains(model), np.zeros((1, len(places))), y)
    return Passage(time, places, states[2 * mode], found[2 * mode])
