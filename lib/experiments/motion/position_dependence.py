"""Machines, observers, loops and gains as functions of position (sections 4.2, 5.6): the sensor or the actuator moves."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.designs import COMPENSATED, RETAINED, Design
from experiments.motion.machines import published_noise, shapes_along, stage
from experiments.motion.scan_study import along_scan
from stillwork.control.applications import compensator
from stillwork.control.bandwidth import Loop, make_loop
from stillwork.control.discrete_damping import discrete_damping_gain
from stillwork.estimation.observer import NoiseIntensities, Observer, kalman_observer
from stillwork.estimation.riccati import discrete_gain
from stillwork.estimation.robust import kalman_gains
from stillwork.estimation.time_varying import FilterGains, TimeVaryingModel, estimate
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel


def stage_grid(spacing: float = 0.05) -> Float64[np.ndarray, " masses"]:
    """Places of the masses of the stage (m); their distance is not published."""
    return spacing * np.arange(len(stage().output_shapes))


def at_place(plant: ModalModel, grid: ArrayLike, place: float, moves: str = "sensor") -> ModalModel:
    """The machine with its sensor, or its actuator, at one place (m), also between the points of the grid.

    A moving ``sensor`` is output position dependence, the force stays where it is. A moving ``actuator`` is input
    position dependence: the force acts at `place`, and the position is measured where the plant's own force acts.
    """
    shape = shapes_along(plant, grid, [place])
    ends = (plant.input_shapes, shape) if moves == "sensor" else (shape.T, plant.input_shapes.T)
    return replace(plant, input_shapes=ends[0], output_shapes=ends[1], feedthrough=np.zeros((1, 1)))


def nodes(plant: ModalModel, grid: ArrayLike, mode: int) -> Float64[np.ndarray, " nodes"]:
    """Places (m) where a mode shape is zero: a sensor there does not see it, an actuator does not move it."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(grid, plant.output_shapes[:, mode]).roots(extrapolate=False)


def observer_at(
    plant: ModalModel, grid: ArrayLike, place: float, noise_model: float | None = None
) -> Observer:
    """Stationary observer for one place: matrices, compliance and gain of (4.6) belong to it."""
    reduced = truncate(at_place(plant, grid, place), RETAINED, COMPENSATED)
    return kalman_observer(reduced, published_noise(), noise_model)


def compensator_at(plant: ModalModel, grid: ArrayLike, place: float, design: Design) -> StateModel | None:
    """Compensator of a design on the observer of one place; None without observer."""
    if design.application is None:
        return None
    return compensator(observer_at(plant, grid, place, design.noise_model), design.application)


def place_loops(
    plant: ModalModel, grid: ArrayLike, places: ArrayLike, design: Design, **response_grid
) -> list[Loop]:
    """One loop a place, with the observer of that place; `response_grid` goes to `make_loop`."""
    return [
        make_loop(at_place(plant, grid, place), compensator_at(plant, grid, place, design), **response_grid)
        for place in np.asarray(places, float).tolist()
    ]


@dataclass(frozen=True)
class GainTable:
    """Stationary filter gains on a grid of positions."""

    grid: Float64[np.ndarray, " places"]  # m, ascending
    gains: Float64[np.ndarray, "places states outputs"]

    def at(self, places: ArrayLike) -> Float64[np.ndarray, "samples states outputs"]:
        """Gains at places (m) on the grid by linear interpolation."""
        places = np.asarray(places, float)
        right = np.clip(np.searchsorted(self.grid, places), 1, len(self.grid) - 1)
        part = (places - self.grid[right - 1]) / (self.grid[right] - self.grid[right - 1])
        part = part[:, None, None]
        return (1 - part) * self.gains[right - 1] + part * self.gains[right]


def gain_table(
    a: ArrayLike, g: ArrayLike, rows: ArrayLike, grid: ArrayLike, process: ArrayLike, sensor: ArrayLike
) -> GainTable:
    """Stationary Kalman filter gains for the rows of C at every point of an ascending grid (m)."""
    gains = [discrete_gain(a, g, c, process, sensor).filter_gain for c in np.asarray(rows, float)]
    return GainTable(np.asarray(grid, float), np.array(gains))


def scheduled_gains(model: TimeVaryingModel, table: GainTable, places: ArrayLike) -> FilterGains:
    """Filter whose gain is looked up at every sample; everything else is the time-varying filter's."""
    return FilterGains(model.a, model.b, table.at(places), model.c)


def damping_along(
    plant: ModalModel, grid: ArrayLike, places: ArrayLike, increase: float | ArrayLike, sample_time: float
) -> Float64[np.ndarray, "places 1 states"]:
    """Discrete damping gains (4.3) of an actuator that moves along the structure, solved at every place."""
    models = (at_place(plant, grid, place, "actuator") for place in np.asarray(places, float).tolist())
    return np.array(
        [discrete_damping_gain(model.modes(slice(0, RETAINED)), increase, sample_time) for model in models]
    )


def damping_table(
    plant: ModalModel, grid: ArrayLike, places: ArrayLike, increase: float | ArrayLike, sample_time: float
) -> GainTable:
    """The same gains computed beforehand on a grid of places without a node, for linear interpolation."""
    return GainTable(np.asarray(places, float), damping_along(plant, grid, places, increase, sample_time))


AMPLITUDE = 0.01  # N, of the force


@dataclass(frozen=True)
class Passage:
    """True and estimated modal position of one mode while the sensor follows a trajectory."""

    time: Float64[np.ndarray, " samples"]  # s
    truth: Float64[np.ndarray, " samples"]  # m sqrt(kg)
    estimate: Float64[np.ndarray, " samples"]  # m sqrt(kg)

    def worst(self, start: float, end: float) -> float:
        """Largest estimation error between two times (s), relative to the mode's largest motion there."""
        window = (self.time >= start) & (self.time <= end)
        size = np.abs(self.truth[window]).max()
        return float(np.abs(self.truth - self.estimate)[window].max() / size)


def move(
    start: float, wait: float, speed: float, length: float, rest: float, sample_time: float
) -> np.ndarray:
    """Places (m): stand at `start` for `wait` s, move `length` m at `speed` m/s, stand for `rest` s."""
    time = np.arange(round((wait + length / speed + rest) / sample_time) + 1) * sample_time
    return start + np.clip(speed * (time - wait), 0.0, length)


def pass_node(
    plant: ModalModel,
    grid: ArrayLike,
    places: ArrayLike,
    mode: int,
    noise: NoiseIntensities,
    sample_time: float,
    phase: float = 0.0,
) -> Passage:
    """Run the time-varying Kalman filter while an unknown force excites one mode at its resonance.

    The filter models all modes of the plant and is designed for `noise`; the sensor follows `places` (m).
    """
    places = np.asarray(places, float)
    shapes = shapes_along(plant, grid, places)
    model = along_scan(plant, sample_time, shapes, noise.process / sample_time, noise.sensor / sample_time)
    time = np.arange(len(places)) * sample_time
    force = AMPLITUDE * np.sin(plant.frequencies[mode] * time + phase)
    a, b = model.a[0], model.b[0]
    states = simulate(StateModel(a, b, np.eye(len(a)), np.zeros_like(b), sample_time), force[None])
    y = np.einsum("koi,ik->ok", model.c, states)
    found = estimate(kalman_gains(model), np.zeros((1, len(places))), y)
    return Passage(time, states[2 * mode], found[2 * mode])
