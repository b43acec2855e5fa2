"""Platform mechanics common to both twins: force and floor motion in, platform acceleration out."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from experiments.isolation.rig import Rig
from stillwork.base.checks import InputError, require_array
from stillwork.lti.discretisation import tustin
from stillwork.lti.state_space import StateModel


@dataclass(frozen=True)
class Platform:
    """``M y + C ∫y + K ∫∫y = B f + D ∫a0 + K0 ∫∫a0``, ``a1 = H y``, with y the acceleration.

    Written in accelerations because they are what the sensors give; its realisation below has no integrator.
    """

    mass: ArrayLike  # M (coordinates, coordinates)
    damping: ArrayLike  # C, likewise
    stiffness: ArrayLike  # K, likewise
    actuation: ArrayLike  # B (coordinates, actuators)
    observation: ArrayLike  # H (outputs, coordinates)
    floor_damping: ArrayLike  # D (coordinates, sensors): force per floor velocity at the sensors
    floor_stiffness: ArrayLike  # K0, likewise: per displacement
    # (actuators, sensors): force per floor acceleration that takes the actuators' way, delay and lag included;
    # zero for a rigid body
    floor_inertia: ArrayLike

    def __post_init__(self):
        n = len(require_array("mass", self.mass, ndim=2))
        actuators = require_array("actuation", self.actuation, shape=(n, None)).shape[1]
        sensors = require_array("floor_damping", self.floor_damping, shape=(n, None)).shape[1]
        shapes = {
            "mass": (n, n),
            "damping": (n, n),
            "stiffness": (n, n),
            "actuation": (n, actuators),
            "observation": (None, n),
            "floor_damping": (n, sensors),
            "floor_stiffness": (n, sensors),
            "floor_inertia": (actuators, sensors),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, require_array(name, getattr(self, name), shape=shape))
        for name in ("mass", "stiffness"):
            matrix = getattr(self, name)
            if not np.allclose(matrix, matrix.T, rtol=1e-9) or np.linalg.eigvalsh(matrix)[0] <= 0:
                raise InputError(f"{name} is not symmetric and positive definite; give a physical matrix")
        if np.linalg.eigvalsh(self.damping + self.damping.T)[0] < 0:
            raise InputError("damping feeds energy into a motion; give a positive semidefinite matrix")

    @cached_property
    def continuous(self) -> StateModel:
        """From (f, a0) to a1."""
        inverse = np.linalg.inv(self.mass)
        n = len(inverse)
        sensors = self.floor_damping.shape[1]
        a = np.block([[-self.damping @ inverse, np.eye(n)], [-self.stiffness @ inverse, np.zeros((n, n))]])
        through = inverse @ self.actuation
        b = np.block(
            [[-self.damping @ through, self.floor_damping], [-self.stiffness @ through, self.floor_stiffness]]
        )
        c = self.observation @ np.hstack([inverse, np.zeros((n, n))])
        d = np.hstack([self.observation @ through, np.zeros((len(c), sensors))])
        return StateModel(a, b, c, d)

    def discrete(self, sample_time: float) -> StateModel:
        """The Tustin-discretised plant."""
        return tustin(self.continuous, sample_time)

    @property
    def equivalent_mass(self) -> float:
        """Inverse of the mean acceleration at a sensor per force of its own actuator, kg."""
        return float(1 / np.mean(np.diag(self.observation @ np.linalg.solve(self.mass, self.actuation))))


def plant_of_rig(rig: Rig) -> Platform:
    """The rigid body on its struts, whose feet follow the floor plate as measured by its sensors."""
    plate = rig.plate_motion
    actuators = len(rig.actuators.positions)
    return Platform(
        mass=rig.mass_matrix,
        damping=rig.damping_matrix,
        stiffness=rig.stiffness_matrix,
        actuation=rig.actuators.jacobian.T,
        observation=rig.platform_sensors.jacobian,
        floor_damping=rig.damping_matrix @ plate,
        floor_stiffness=rig.stiffness_matrix @ plate,
        floor_inertia=np.zeros((actuators, plate.shape[1])),
    )
