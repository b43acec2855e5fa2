"""Machines, observers, loops and gains as functions of position (sections 4.2, 5.6): the sensor or the actuator moves."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.motion.designs import COMPENSATED, RETAINED, Design
from experiments.motion.machines import published_noise, shapes_along, stage
from stillwork.control.applications import compensator
from stillwork.estimation.observer import Observer, kalman_observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
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
