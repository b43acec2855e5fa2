r"""Scans of uncertain plants for the comparison of observers, section 5.4.3 of the observer thesis.

One controller and one feedforward move every plant along the setpoint while the sensor slides along the
structure; what is recorded is the input, the measurement and the true states.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from experiments.motion.machines import (
    published_deviations,
    published_setpoint,
    shapes_along,
    stage,
    stage_mass,
)
from stillwork.control.pid import PidFamily
from stillwork.control.setpoint import Setpoint
from stillwork.estimation.riccati import discrete_gain
from stillwork.estimation.time_varying import TimeVaryingModel
from stillwork.lti.discretisation import zoh, zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


@dataclass(frozen=True)
class Scan:
    """What all plants of a study share."""

    nominal: ModalModel  # with one output a grid point
    shapes: Float64[np.ndarray, "samples modes"]  # nominal output shape at every sample
    setpoint: Setpoint
    controller: StateModel  # sampled
    mass: float  # kg, of the acceleration feedforward
    deviations: tuple[float, float, float]  # of w (N), v (m) and d (m), each sample anew

    @property
    def sample_time(self) -> float:
        """Sample time, s."""
        return self.setpoint.sample_time


def published_scan(spacing: float = 0.05, bandwidth_hz: float = 30.0, sample_time: float = 1e-4) -> Scan:
    """Section 5.4.3: the first three modes of the stage on the setpoint of Fig. 3.32.

    Not published, and set here: the masses stand `spacing` metres apart, the move is centred on them, the
    controller is (3.1) at `bandwidth_hz`, the sample time is `sample_time`.
    """
    plant = stage().modes(slice(0, 3))
    setpoint = published_setpoint(sample_time)
    grid = spacing * np.arange(len(plant.output_shapes))
    position = setpoint.derivatives[0]
    start = (grid[-1] - position[-1]) / 2
    return Scan(
        plant,
        shapes_along(plant, grid, start + position),
        setpoint,
        zoh(PidFamily(stage_mass())(bandwidth_hz).state_space(), sample_time),
        stage_mass(),
        tuple(published_deviations().values()),
    )


def along_scan(
    machine: ModalModel,
    sample_time: float,
    shapes: Float64[np.ndarray, "samples modes"],
    process: float,
    sensor: float,
) -> TimeVaryingModel:
    """A sampled machine under a moving sensor, started from the stationary covariance at the first place.

    `process` and `sensor` are the variances of w (N^2) and of the measurement (m^2).
    """
    sampled, c = zoh_modes(machine, sample_time), output_rows(shapes)
    q, r = np.array([[process]]), np.array([[sensor]])
    start = discrete_gain(sampled.a, sampled.b, c[0], q, r)
    initial = start.covariance - start.filter_gain @ c[0] @ start.covariance
    return TimeVaryingModel(sampled.a, sampled.b, sampled.b, c, q, r, (initial + initial.T) / 2)


def output_rows(shapes: Float64[np.ndarray, "samples modes"]) -> Float64[np.ndarray, "samples 1 states"]:
    """C at every sample for modal states of form 1 and a position sensor."""
    c = np.zeros((len(shapes), 1, 2 * shapes.shape[1]))
    c[:, 0, ::2] = shapes
    return c


def contiguous(*arrays) -> tuple[np.ndarray, ...]:
    """Arrays as kernels take them."""
    return tuple(np.ascontiguousarray(array) for array in arrays)


def rms(signals: np.ndarray) -> np.ndarray | float:
    """Root mean square along the last axis."""
    return np.sqrt(np.mean(signals**2, axis=-1))
