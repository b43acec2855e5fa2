"""The studies behind the motion topic's open choices."""

import numpy as np
import pytest

from experiments.motion import designs
from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import published_setpoint, stage
from experiments.motion.perturbed_tracking import noisy_scan_trial
from notebooks.motion.bandwidth_table import OPEN_LOOPS, bandwidth
from notebooks.motion.tracking import ranked, tracking_loop
from notebooks.motion.two_inertia_drive import drive_figure, statements
from stillwork.control.feedforward import Feedforward
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


@pytest.mark.slow
def test_readings_that_change_the_search_change_its_limit():
    usual = bandwidth("MC", "f_bw", 1)
    assert bandwidth("MC", "f_bw", 7) == usual
    assert bandwidth("MC", "f_bw", 1, six="2") > usual
    assert bandwidth("MC", "f_bw", 1, stage_damping=0.001) < 0.7 * usual
    both = [bandwidth("MC and AD", "f_bw", 1, compensation=each) for each in designs.COMPENSATIONS]
    assert len(set(both)) == 1  # its noise model is printed
    alone = [bandwidth("MC, two constraints", "f_bw", 1, compensation=each) for each in designs.COMPENSATIONS]
    assert len(set(alone)) == 3


def test_a_scan_takes_each_loop_with_its_own_feedforward():
    loops = {case: tracking_loop(case, "printed", 0.005) for case in ("none", "MC")}
    gains = {"none": Feedforward(acceleration=12.5), "MC": Feedforward(acceleration=12.4)}
    scan = {"setpoint": published_setpoint(2e-4), "deviations": {"w": 0.01, "v": 1e-9, "d": 1e-9}}

    def trial(loops, feedforward):
        return noisy_scan_trial(np.random.default_rng(3), loops=loops, feedforward=feedforward, **scan)

    both = trial(loops, gains)
    for case, own in gains.items():
        assert both[case] == trial({case: loops[case]}, own)[case]
    assert both["MC"] > 10 * trial(loops, gains["none"])["MC"]


def test_an_order_needs_both_columns():
    values = {"mc": 4.0, "original": 3.0, "ad": 2.0, "mc-and-ad": 1.0}
    redesigned = {f"{name}-redesigned": value for name, value in values.items() if name != "original"}
    assert ranked(values | redesigned)
    assert not ranked(values | redesigned | {"mc-redesigned": 2.9})


def test_a_model_too_soft_leaves_a_peak_and_one_too_stiff_a_notch():
    reading = {"drive_damping": 0.1, "drive_weights": "angles first", "seed": 1, "lean": True}
    soft = drive_figure(stiffness_error=-0.05, **reading)
    stiff = drive_figure(stiffness_error=0.05, **reading)
    assert soft["motion.fig-3-36.residual-peak"] == 1
    assert stiff["motion.fig-3-36.residual-peak"] == 0
    exact = drive_figure(stiffness_error=1e-9, **reading)
    assert exact["motion.fig-3-36.compensation-reduces"] == 1
    assert exact["motion.fig-3-36.combination-best"] == 0  # MC alone is the rigid body then


def test_a_notch_is_as_far_from_the_rigid_body_as_a_peak():
    levels = {"no observer": [16.0, 0], "MC": [-3.0, 1], "AD": [9.0, 0], "MC and AD": [2.0, -4]}
    levels = {name: np.array(level) for name, level in levels.items()}
    assert statements(levels) == {
        "compensation-reduces": True,
        "residual-peak": False,
        "damping-reduces-less": True,
        "combination-best": False,
    }
