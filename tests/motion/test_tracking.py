"""Setpoints, judgement of a scan, feedforward and exact simulation, compared with brute force."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import published_setpoint, stage, stage_mass
from naive.motion import moving_windows
from notebooks.motion.disturbance_rejection import band_power, cumulative_power
from stillwork.control.feedforward import (
    Feedforward,
    error_loop,
    fit_feedforward,
    modified_feedforward,
    noise_error,
    tracking_error,
)
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import PidFamily
from stillwork.lti import StateModel, interconnect, resonance_grid, truncate
from stillwork.signals.moving_average import average_filter, moving, rms

PLANT = stage().at([0], [4])
CONTROLLER = PidFamily(stage_mass())(35.626).state_space()


def test_published_setpoint():
    """Table 3.6 and the text below it."""
    setpoint = published_setpoint(1e-4)
    assert setpoint.derivatives[0, -1] == pytest.approx(0.17, abs=1e-12)
    np.testing.assert_allclose(
        np.abs(setpoint.derivatives).max(axis=1)[1:], [1.0, 100.0, 2e4, 4e6], rtol=1e-9
    )
    assert np.allclose(setpoint.derivatives[1:4, -1], 0, atol=1e-9)
    np.testing.assert_allclose(setpoint.scan, (0.04, 0.17))
    assert setpoint.scanning.sum() == 1301


def test_moving_values_are_those_of_every_window():
    error = np.random.default_rng(0).normal(size=400) * 1e-9 + 3e-5  # on a mean that hides it from plain sums
    found = moving(error, 1e-3, 0.05)
    average, deviation = moving_windows(error, 50)
    assert np.allclose(found.average, average, rtol=1e-10, atol=0)
    assert np.allclose(found.deviation, deviation, rtol=1e-8, atol=0)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 9999), st.integers(2, 60))
def test_rms_is_average_and_deviation_combined(seed, width):
    """(1.3), Appendix B."""
    error = np.random.default_rng(seed).normal(size=80)
    found = moving(error, 1.0, float(width))
    direct = [rms(error[k : k + width]) for k in range(len(found.rms))]
    np.testing.assert_allclose(found.rms, direct, rtol=1e-9)


def test_average_filter_has_its_zeros():
    exposure = 0.01
    response = average_filter(2 * np.pi * np.array([1e-9, 100.0, 200.0, 50.0]), exposure)
    assert np.allclose(response, [1, 0, 0, 2 / np.pi], atol=1e-12)


def test_ideal_feedforward_of_a_rigid_body_is_its_mass():
    rigid = PLANT.modes([0])
    loop = error_loop(closed_loop(rigid, None, CONTROLLER))
    setpoint = published_setpoint(1e-4)
    fitted = fit_feedforward(loop, setpoint)
    assert np.allclose(fitted.gains, [0, 12.5, 0, 0], atol=1e-6)
    assert np.abs(tracking_error(loop, setpoint, fitted)).max() < 1e-11


@pytest.mark.parametrize("plant", [PLANT, truncate(PLANT, 2, 2)], ids=["all modes", "compliance"])
def test_simulation_through_python_control(plant):
    """A plant with the compliance of left out modes passes a part of the force at once."""
    loop = error_loop(closed_loop(plant, None, CONTROLLER))
    assert loop.d[:, 1].any() == plant.feedthrough.any()
    setpoint = published_setpoint(1e-4)
    # Four integrators from the snap, then r to one input and 12.5 a to the other: python-control's ZOH is exact too.
    chain = StateModel(np.eye(4, k=1), np.eye(4)[:, -1:], np.eye(4), np.zeros((4, 1)))
    feedback = np.zeros((3, 5))
    feedback[1, 0], feedback[2, 2] = 1, 12.5
    whole = interconnect([chain, loop], feedback, np.eye(3, 1), np.eye(5)[-1:])
    scale = 10.0 ** -np.arange(0, 8, 2)  # python-control does not balance: bring the chain to one size for it
    resized = StateModel(
        whole.a * np.r_[1 / scale, np.ones(len(loop.a))][None] * np.r_[scale, np.ones(len(loop.a))][:, None],
        whole.b * np.r_[scale, np.ones(len(loop.a))][:, None],
        whole.c * np.r_[1 / scale, np.ones(len(loop.a))][None],
        whole.d,
    )
    discrete = control.sample_system(resized.to_control(), 1e-4, "zoh")
    theirs = control.forced_response(discrete, inputs=setpoint.derivatives[4]).outputs
    ours = tracking_error(loop, setpoint, Feedforward(acceleration=12.5))
    assert np.abs(ours - theirs).max() < 1e-10


def test_modified_feedforward_is_a_force_that_the_observer_does_not_see():
    """(A.7): the copy of the observer cancels the observer in the loop."""
    block = stage_compensator(5, DESIGNS["MC and AD"])
    loop = closed_loop(PLANT, block, CONTROLLER)
    omega = 2 * np.pi * np.array([0.7, 30.0, 200.0, 470.0])
    extra = modified_feedforward(block, CONTROLLER).frequency_response(omega)[0]
    short = error_loop(loop).frequency_response(omega)[0]
    r, u = (channel(loop, source, "e_true").frequency_response(omega)[0, 0] for source in ("r", "u_ff"))
    assert np.allclose(u * extra[0], short[1], rtol=1e-5, atol=1e-9 * np.abs(short[1]).max())
    assert np.allclose(r + u * extra[1], short[0], rtol=1e-5, atol=1e-7)


def test_perfect_feedforward_gives_no_error_with_an_observer():
    """Appendix A: with u0 = P^-1 r the modified feedforward tracks perfectly."""
    loop = closed_loop(PLANT, stage_compensator(5, DESIGNS["MC and AD"]), CONTROLLER)
    omega = 2 * np.pi * np.array([3.0, 40.0, 300.0])
    short = error_loop(loop).frequency_response(omega)[0]
    inverse = 1 / PLANT.frequency_response(omega)[0, 0]
    assert np.abs(short[0] + short[1] * inverse).max() < 1e-7


def test_cumulative_power_is_that_of_a_long_record():
    loop = closed_loop(PLANT, stage_compensator(5, DESIGNS["MC"]), CONTROLLER)
    sample_time, noise = 1e-4, {"w": 0.01, "v": 1e-9, "d": 1e-9}
    grid = resonance_grid(np.concatenate([PLANT.poles, loop.poles]), 0.01, 5e3, 2000, 60)
    power = cumulative_power(loop, sample_time, noise, grid)
    record = noise_error(loop, sample_time, 150_000, noise, np.random.default_rng(8))[:, 5000:]
    assert np.sqrt(power.true[-1]) == pytest.approx(rms(record[0]), rel=0.05)
    # d is white and direct: what the measured error has more is above the bandwidth.
    assert np.sqrt(power.measured[-1]) == pytest.approx(rms(record[1]), rel=0.05)
    low, high = band_power(power, PLANT.frequencies[1])
    assert 0 < high and 0 < low < power.true[-1]
