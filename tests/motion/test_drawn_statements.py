"""What notebooks 01 to 15 judge on drawn lines, and the functions that their open choices vary."""

import numpy as np
import pytest

from experiments.motion import designs
from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import loaded_modes, stage
from experiments.motion.pictures import turning_points
from notebooks.motion.bandwidth_table import OPEN_LOOPS, bandwidth
from stillwork.control.loops import channel, closed_loop

PRINTED = [37.0, 43.0, 46.0, 59.0, 65.0, 72.0, 77.0, 83.0, 73.0]


def test_peaks_and_dips_of_a_line_are_found_and_ripples_are_not():
    x = np.linspace(1, 10, 9001)
    line = 20 * np.exp(-((x - 3) ** 2) / 0.01) - 15 * np.exp(-((x - 7) ** 2) / 0.01) + 0.01 * np.sin(40 * x)
    assert turning_points(x, line, "peaks") == pytest.approx([3.0], abs=2e-3)
    assert turning_points(x, line, "dips") == pytest.approx([7.0], abs=2e-3)


@pytest.mark.parametrize("sharing", ["linear", "smooth"])
def test_a_mass_between_two_places_is_all_there(sharing):
    masses = [loaded_modes(place, sharing)[0] for place in (2.0, 2.3, 2.5)]
    assert [np.trace(each) for each in masses] == pytest.approx([5 * 1.6 + 1.0] * 3)
    assert masses[0][1, 1] == pytest.approx(2.6)
    assert masses[2][1, 1] == pytest.approx(masses[2][2, 2]) == pytest.approx(2.1)


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
