"""The simulations that the convergence analysis is held against, and what they hold."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.fixedpoint import Noise, published_controllers
from experiments.fixedpoint.convergence_study import at_rest
from experiments.fixedpoint.published import KALMAN, LOW_PASS, WINDOW
from notebooks.fixedpoint.fixed_point import cycles_over_gain, divergence_by_noise, response_noise
from stillwork.control import FlowTransformation, simulate

SAMPLE_TIME = 1e-3


def test_cycles_are_predicted_and_found_together(exact, approximate):
    window = published_controllers(approximate)[WINDOW]
    predicted, simulated = cycles_over_gain(exact, window, [0.2, 1.1], 3.0, SAMPLE_TIME)
    assert np.isnan(predicted[0]).all()  # 0.2 / 3 is within the stable range
    assert simulated[0][1] < 1e-2
    assert predicted[1] == pytest.approx(simulated[1], rel=5e-3)
    assert predicted[1][0] == pytest.approx(40, abs=0.5)


def test_noise_starves_the_kalman_loop_of_six(exact, approximate):
    kalman = published_controllers(approximate)[KALMAN]
    six = replace(kalman, transformation=FlowTransformation())
    assert divergence_by_noise(exact, six, [1e-6, 1e-4], 2, 0) == [0.0, 1.0]
    assert divergence_by_noise(exact, kalman, [1e-4], 2, 0) == [0.0]


def test_response_noise_is_proportional_to_the_noise(exact, approximate):
    """The low pass with (8) is as good as linear at rest; the first second does not count."""
    controller = published_controllers(approximate)[LOW_PASS]
    small, large = (response_noise(exact, controller, s, 4) for s in (1e-6, 1e-5))
    assert large == pytest.approx(10 * small, rel=1e-3)
    noise = Noise("gaussian", 1e-5).sample(np.random.default_rng(4), 6000)
    run = simulate(exact, controller, at_rest(6000, SAMPLE_TIME), noise, integration="semi-implicit")
    assert large == pytest.approx((run.acceleration_estimate - run.desired)[1000:].std())
