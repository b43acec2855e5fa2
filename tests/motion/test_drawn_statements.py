"""What notebooks 01 to 15 judge on drawn lines, and the functions that their open choices vary."""

import numpy as np
import pytest

from experiments.motion.designs import DESIGNS, PRINTED_HZ, design_controller, stage_bandwidth
from experiments.motion.machines import loaded_modes, stage
from experiments.motion.pictures import depth, turning_points
from motion.test_choices import open_loop_gain
from notebooks.motion.active_damping import rigid_poles_after_placement
from notebooks.motion.bandwidth_table import LOOPS, WAYS, agreeing
from notebooks.motion.measurement_compensation import soft_sensed_loop
from stillwork.base.checks import InputError
from stillwork.lti import truncate
from workbook import figures
from workbook.claims import load_entries

PRINTED = [37.0, 43.0, 46.0, 59.0, 65.0, 72.0, 77.0, 83.0, 73.0]


def test_peaks_and_dips_of_a_line_are_found_and_ripples_are_not():
    x = np.linspace(1, 10, 9001)
    line = 20 * np.exp(-((x - 3) ** 2) / 0.01) - 15 * np.exp(-((x - 7) ** 2) / 0.01) + 0.01 * np.sin(40 * x)
    assert turning_points(x, line, "peaks") == pytest.approx([3.0], abs=2e-3)
    assert turning_points(x, line, "dips") == pytest.approx([7.0], abs=2e-3)


def test_the_depth_of_a_notch_is_below_the_lower_side():
    _, axis = figures.new()
    x = np.linspace(50, 150, 2001)
    axis.plot(x, 0.1 * x - 30 * np.exp(-(((x - 100) / 1.0) ** 2)), label="notch")
    assert depth(axis, "notch", 100.0) == pytest.approx(30 + 9 - 10, abs=0.01)
    assert depth(axis, "notch", 75.0) < 0  # a slope is no notch


def test_a_controller_is_at_our_limit_or_at_the_printed_bandwidth():
    entries = load_entries("motion")
    assert PRINTED_HZ["MC"] == entries["motion.bandwidth.mc"].published
    assert set(PRINTED_HZ) == set(DESIGNS)
    own, printed = design_controller("PID"), design_controller("PID", "printed")
    assert own == stage_bandwidth("PID").controller
    # (3.1): the gain at the design bandwidth goes with its square, and the two are otherwise alike.
    slower, omega = stage_bandwidth("PID").design_hz / 37.0, np.array([20 * np.pi])
    scaled = np.abs(printed.frequency_response(omega)) * slower**2
    assert np.abs(own.frequency_response(slower * omega)) == pytest.approx(scaled, rel=1e-9)
    deep = design_controller("PID with notches", "printed").frequency_response(stage().frequencies[1:2])
    assert np.abs(deep) < 0.02 * np.abs(printed.frequency_response(stage().frequencies[1:2]))
    with pytest.raises(InputError, match=r"^redesign\b"):
        design_controller("PID", "guessed")


@pytest.mark.slow
def test_six_of_nine_bandwidths_agree_where_hertz_are_cut_off():
    """By the gain of the open loop from the closed loop's states: above 1 at the printed hertz, below 1 one hertz on."""
    from notebooks.motion.bandwidth_table import BANDWIDTHS

    names = [*BANDWIDTHS.values(), "MC, two constraints"]
    inside = [
        open_loop_gain(name, "P C_eq", 3, hertz)[0] >= 1 > open_loop_gain(name, "P C_eq", 3, hertz + 1)[0]
        for name, hertz in zip(names, PRINTED, strict=True)
    ]
    found = agreeing(PRINTED, cut_off=True)
    assert WAYS[0] == ("6 dB", "noise model")
    assert found[LOOPS.index("P C_eq"), 2, 0].tolist() == inside
    assert sum(inside) == found.sum(axis=-1).max() == 6


def test_a_soft_sensor_at_its_own_place_measures_that_place():
    loop = soft_sensed_loop(5, 5)
    seen = loop.at(design_controller("PID")).equivalent_plant
    np.testing.assert_allclose(seen, loop.plant_response, rtol=1e-7)


def test_placement_leaves_the_rigid_body_where_it_was():
    found = rigid_poles_after_placement(truncate(stage().at([0], [4]), 4, 3), 0.035, machines=5)
    assert found.shape == (5,)
    assert np.all(np.abs(found) < 1e-6)


@pytest.mark.parametrize("sharing", ["linear", "smooth"])
def test_a_mass_between_two_places_is_all_there(sharing):
    masses = [loaded_modes(place, sharing)[0] for place in (2.0, 2.3, 2.5)]
    assert [np.trace(each) for each in masses] == pytest.approx([5 * 1.6 + 1.0] * 3)
    assert masses[0][1, 1] == pytest.approx(2.6)
    assert masses[2][1, 1] == pytest.approx(masses[2][2, 2]) == pytest.approx(2.1)
