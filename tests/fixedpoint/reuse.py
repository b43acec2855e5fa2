"""Use a reader's own plant and model once, and count what had to be compiled for it."""

import numpy as np

from stillwork.control import Controller, KinematicDesign, adaptation_loop, simulate
from stillwork.control.trajectory import sine_trajectory
from stillwork.control.transformation import RobustTransformation
from stillwork.estimation import Plant
from stillwork.estimation.coordinate_filters import UnscentedKalman


def use(own_model):
    """Compilations of the kernel, and the largest settled error."""
    own, rough = (
        Plant(own_model.cart_acceleration, own_model.cart_force, np.array(parameters))
        for parameters in ([2.0, 1.0], [1.5, 0.0])
    )
    controller = Controller(UnscentedKalman(rough), RobustTransformation(), KinematicDesign(10.0), rough)
    run = simulate(own, controller, sine_trajectory(duration=1.0))
    compiled = sum(adaptation_loop.run_one_coordinate.stats.cache_misses.values())
    return compiled, float(np.abs(run.position_error[500:]).max())
