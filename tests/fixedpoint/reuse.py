"""Use a reader's own plant and model once, and count what had to be compiled for it."""

import numpy as np

from stillwork.base.kernels import callback
from stillwork.control import Controller, KinematicDesign, fixed_point, simulate
from stillwork.control.trajectory import sine_trajectory
from stillwork.control.transformation import RobustTransformation
from stillwork.estimation import Plant, nonlinear, nonlinear_kernels, plant
from stillwork.estimation.coordinate_filters import UnscentedKalman
from stillwork.estimation.nonlinear import NonlinearModel, unscented_filter


def use(own_model):
    """Compilations of the two kernels, callbacks found on disk, and the largest settled error."""
    own, rough = (
        Plant(own_model.cart_acceleration, own_model.cart_force, np.array(parameters))
        for parameters in ([2.0, 1.0], [1.5, 0.0])
    )
    controller = Controller(UnscentedKalman(rough), RobustTransformation(), KinematicDesign(10.0), rough)
    run = simulate(own, controller, sine_trajectory(duration=1.0))
    model = NonlinearModel(own_model.pendulum, own_model.seen, 2, 1, 1, np.array([0.01, 9.81, 0.1]))
    unscented_filter(
        model,
        np.zeros((1, 5)),
        process=[1e-3, 1e-3],
        noise=[1e-2],
        initial_mean=[0.0, 0.0],
        initial_covariance=[1.0, 1.0],
    )
    kernels = (fixed_point._closed_loop, nonlinear_kernels.model_record)
    callbacks = [
        callback(own_model.cart_acceleration, plant.SIGNATURE),
        callback(own_model.cart_force, plant.SIGNATURE),
        callback(own_model.pendulum, nonlinear.SIGNATURE),
        callback(own_model.seen, nonlinear.SIGNATURE),
    ]
    return (
        sum(sum(one.stats.cache_misses.values()) for one in kernels),
        sum(one.cache_hits for one in callbacks),
        float(np.abs(run.position_error[500:]).max()),
    )
