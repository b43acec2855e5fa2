"""A run of the adaptive loop: what the plant meets, and the record of every coordinate."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import Positive, within
from stillwork.base.checks import InputError, require_array, require_number
from stillwork.base.validation import by_value, checked
from stillwork.control.adaptation_loop import (
    COLUMNS,
    EXACT,
    NO_INERTIA,
    NOT_DEFINITE,
    NOT_FINITE,
    RUNNING,
    TOO_FAR,
    Course,
    Law,
    first_state,
    run_mechanism,
    run_one_coordinate,
)
from stillwork.control.mechanism import Mechanism
from stillwork.control.trajectory import Trajectory
from stillwork.estimation.plant import Plant

CAUSES = {
    TOO_FAR: "a coordinate left its bound",
    NOT_FINITE: "the commanded force is not finite",
    NOT_DEFINITE: "the filter's covariance is no longer positive definite",
    NO_INERTIA: "the inertia of a model is not positive definite",
}


@by_value
@dataclass(frozen=True)
class ControlledRun:
    """One coordinate of a simulated run; all arrays of shape (samples,), NaN after a divergence.

    For an angle read rad for m and N m for N.
    """

    trajectory: Trajectory
    position: Float64[np.ndarray, " samples"]  # m, true
    velocity: Float64[np.ndarray, " samples"]  # m/s, true
    acceleration: Float64[np.ndarray, " samples"]  # m/s^2, true, as the coming step begins
    measured: Float64[np.ndarray, " samples"]  # m; what stands for a lost sample, NaN where a filter predicts
    position_estimate: Float64[np.ndarray, " samples"]  # m
    velocity_estimate: Float64[np.ndarray, " samples"]  # m/s
    acceleration_estimate: Float64[np.ndarray, " samples"]  # m/s^2
    desired: Float64[np.ndarray, " samples"]  # m/s^2, (1)
    deformed: Float64[np.ndarray, " samples"]  # m/s^2, (6) or (8)
    force: Float64[np.ndarray, " samples"]  # N
    diverged_at: float | None = None  # s
    cause: str = ""  # of the divergence

    @property
    def time(self) -> Float64[np.ndarray, " samples"]:
        """s."""
        return self.trajectory.time

    @property
    def position_error(self) -> Float64[np.ndarray, " samples"]:
        """Nominal minus true position, m."""
        return self.trajectory.position - self.position

    @property
    def velocity_error(self) -> Float64[np.ndarray, " samples"]:
        """Nominal minus true velocity, m/s."""
        return self.trajectory.velocity - self.velocity


@checked
def ending(status: int, time: float, bounds: str = "") -> dict[str, Any]:
    """When a run diverged, in s, and why, with the bounds that it left; empty if it did not."""
    if status == RUNNING:
        return {}
    if status not in CAUSES:
        raise InputError(f"status is {status}; give {RUNNING} or one of {', '.join(map(str, CAUSES))}")
    return {"diverged_at": float(time), "cause": CAUSES[status] + (bounds if status == TOO_FAR else "")}


def require_noise(noise: ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray:
    """Noise of this shape, zero where none is given; NaN is a lost sample, and the first one is needed."""
    if not (isinstance(shape, tuple) and shape and shape[-1]):
        raise InputError(f"shape is {shape!r}; give a tuple of sizes, the last one of samples, at least 1")
    if noise is None:
        return np.zeros(shape)
    noise = require_array("noise", noise, shape=shape, missing=True)
    if np.isnan(noise[..., 0]).any():
        raise InputError("noise is NaN at the first sample; start with one that was measured")
    return np.ascontiguousarray(noise)


@checked
def require_disturbance(disturbance: ArrayLike | None, shape: tuple[int, ...]) -> np.ndarray:
    """A disturbance of this shape, zero where none is given."""
    if disturbance is None:
        return np.zeros(shape)
    return np.ascontiguousarray(require_array("disturbance", disturbance, shape=shape))


@checked
def plants_along(
    parameters: np.ndarray, change: tuple[float, ArrayLike] | None, sample_time: Positive
) -> tuple[np.ndarray, int]:
    """Parameters of a plant before and after a change, a row each, and the first sample after it."""
    if change is None:
        return np.array([parameters, parameters]), 0
    after = require_array("change", change[1], shape=parameters.shape)
    begins = require_number("change", change[0], at_least=0.0)
    return np.array([parameters, after]), round(begins / sample_time)


def joint_start(trajectories: list[Trajectory], count: int, start: ArrayLike | None) -> np.ndarray:
    """Where `count` coordinates with one trajectory each start, shape (2, coordinates)."""
    alike = {(trajectory.sample_time, len(trajectory.position)) for trajectory in trajectories}
    if len(trajectories) != count or len(alike) != 1:
        raise InputError(
            f"trajectories holds {len(trajectories)}; give one for each of {count} coordinates, of one length and sample time"
        )
    begin = np.array([[each.position[0], each.velocity[0]] for each in trajectories]).T
    return require_array("start", begin if start is None else start, shape=(2, count))


@checked
def make_course(
    plant: Plant | Mechanism,
    trajectories: list[Trajectory],
    noise: np.ndarray,
    disturbance: np.ndarray,
    change: tuple[float, ArrayLike] | None,
    bound: Annotated[float, within(above=1)],
) -> Course:
    """What a plant meets on one trajectory for each coordinate: with exact motion, and no encoder."""
    count = getattr(plant, "coordinates", 1)
    sample_time = trajectories[0].sample_time
    nominal = np.array([[each.position, each.velocity, each.acceleration] for each in trajectories])
    limits = bound * np.maximum(1.0, np.abs(nominal[:, :2]).max(axis=2))
    plants, changed = plants_along(np.asarray(plant.parameters), change, sample_time)
    none = np.zeros(count)
    return Course(sample_time, nominal, noise, none, none, disturbance, plants, changed, EXACT, limits)


def close_loop(
    filters: tuple,
    law: Law,
    model: Plant | Mechanism,
    plant: Plant | Mechanism,
    course: Course,
    start: np.ndarray,
    trajectories: list[Trajectory],
) -> tuple[list[ControlledRun], np.ndarray]:
    """Run of every coordinate, and the history of the parameters that an adaptive law estimates.

    filters: packed side by side, and what a filter of one coordinate believes of it.
    start: (2, coordinates).
    """
    count, samples = course.noise.shape
    numbers = np.asarray(model.parameters)
    record = np.full((count, COLUMNS, samples), np.nan)
    history = np.full((len(numbers) if len(law.feedback) else 0, samples), np.nan)
    state = first_state(start, course.nominal[:, 2, 0], law, numbers)
    device, believed = filters
    if isinstance(plant, Plant):
        device = device._replace(**{name: getattr(device, name)[0] for name in device._fields[1:]})
        parts = *model.compiled, plant.compiled[0]
        done, status = run_one_coordinate(device, *believed, law, *parts, course, state, record[0])
    else:
        parts = *model.compiled[:2], *plant.compiled[:2]
        done, status = run_mechanism(device, *believed, law, *parts, course, state, record, history)
    pairs = ", ".join(f"{place:g} in position and {speed:g} in velocity" for place, speed in course.limits)
    ended = ending(status, done * course.sample_time, f" of {pairs}")
    return [
        ControlledRun(*each, **ended) for each in zip(trajectories, *record.swapaxes(0, 1), strict=True)
    ], history
