"""Simulations that the convergence analysis is compared with."""

import numpy as np

from experiments.fixedpoint.published import INTEGRATION
from stillwork.control.fixed_point import Controller, simulate
from stillwork.control.trajectory import Trajectory
from stillwork.estimation.plant import Plant


def at_rest(samples: int, sample_time: float) -> Trajectory:
    """A nominal motion that stands still at zero."""
    return Trajectory(sample_time, *np.zeros((3, samples)))


def remaining_motion(plant: Plant, controller: Controller, kick: float, sample_time: float) -> float:
    """Largest velocity in the last of 8 s at rest after a kick (m/s), over the kick; infinite when it diverged."""
    still = at_rest(round(8 / sample_time), sample_time)
    run = simulate(plant, controller, still, start=(0.0, kick), integration=INTEGRATION)
    if run.diverged_at is not None:
        return np.inf
    return float(np.abs(run.velocity[round(7 / sample_time) :]).max() / kick)
