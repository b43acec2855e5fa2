"""The studies behind the motion topic's open choices."""

import numpy as np
import pytest

from experiments.motion import designs
from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import stage
from notebooks.motion.bandwidth_table import OPEN_LOOPS, bandwidth
from stillwork.control.loops import channel, closed_loop


def open_loop_gain(name: str, open_loop: str, mass: int, hertz) -> np.ndarray:
    """Magnitude of an open loop, from a sensitivity of the closed loop's states, or from plant and controller."""
    plant = stage().at([0], [mass - 1])
    controller = designs.limit(name, "6 dB", "noise model", 0.005)[1].controller.state_space()
    omega = 2 * np.pi * np.atleast_1d(hertz)
    if open_loop == "P C_fb":
        return np.abs(plant.frequency_response(omega) * controller.frequency_response(omega))[0, 0]
    loop = closed_loop(plant, stage_compensator(mass, DESIGNS[name]), controller)
    source, target = ("u_ff", "u") if open_loop == "P_eq C_fb" else ("v", "e_true")
    return np.abs(1 / channel(loop, source, target).frequency_response(omega)[0, 0] - 1)


@pytest.mark.slow
@pytest.mark.parametrize("open_loop", OPEN_LOOPS)
def test_a_bandwidth_is_the_first_crossing_of_the_loop_that_it_is_read_from(open_loop):
    hertz = bandwidth("MC and AD", open_loop, 3)
    assert open_loop_gain("MC and AD", open_loop, 3, hertz) == pytest.approx(1, abs=1e-9)
    assert np.all(open_loop_gain("MC and AD", open_loop, 3, np.geomspace(1, 0.999 * hertz, 200)) > 1)
