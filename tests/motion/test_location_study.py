import numpy as np
import pytest
from scipy import linalg

from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.ideal_feedforward import invert
from experiments.motion.machines import published_setpoint, stage, stage_mass
from experiments.motion.position_dependence import stage_grid
from notebooks.motion.twenty_nine_scans import (
    bare_error,
    feedforward_error,
    fit_to_force,
    ideal_force,
    location_loops,
    sampled_ideal_force,
    study_locations,
)
from stillwork.control.feedforward import (
    Feedforward,
    error_loop,
    fit_feedforward,
    tracking_error,
)
from stillwork.control.loops import closed_loop
from stillwork.control.pid import PidFamily

GRID = stage_grid()
APPLIED = Feedforward(acceleration=12.5, snap=1.5e-6)


@pytest.fixture(scope="module")
def setpoint():
    return published_setpoint(2e-4)


@pytest.fixture(scope="module")
def plant():
    return stage().at([0], [4])


@pytest.fixture(scope="module")
def force(plant, setpoint):
    return feedforward_error(ideal_force(invert(plant), setpoint), APPLIED)


@pytest.mark.parametrize("mass", [1, 4, 5, 7])
def test_partial_fractions_are_the_inverse(mass):
    machine = stage().at([0], [mass - 1])
    inverse = invert(machine)
    omega = 2 * np.pi * np.geomspace(0.5, 8e3, 300)
    s = 1j * omega
    ours = inverse.polynomial @ s ** np.arange(3)[:, None] + (
        inverse.residues / (s[:, None] - inverse.zeros)
    ).sum(axis=1)
    wanted = 1 / (s**2 * machine.frequency_response(omega)[0, 0])
    np.testing.assert_allclose(ours, wanted, rtol=1e-7)


def test_a_force_fed_into_the_loop_gives_the_tracking_error(plant, setpoint, force):
    controller = PidFamily(stage_mass())(35.0)
    for name in ("PID", "AD"):
        loop = closed_loop(plant, stage_compensator(5, DESIGNS[name]), controller.state_space())
        wanted = tracking_error(error_loop(loop), setpoint, APPLIED)
        loops = location_loops(stage(), GRID, [GRID[4]], {"one": (name, controller)})
        study = study_locations(loops, force, setpoint)
        np.testing.assert_allclose(study.errors["one"][0], wanted, atol=1e-7 * np.abs(wanted).max())


@pytest.mark.parametrize("mass", [1, 5, 7])
def test_the_held_ideal_force_meets_the_setpoint_at_every_sample(mass):
    """Stepped by exact steps of every mode, from rest before the move."""
    setpoint = published_setpoint(1e-4)
    machine = stage().at([0], [mass - 1])
    force = sampled_ideal_force(machine, setpoint)
    states = machine.modes(slice(0, 8)).state_space()
    # The exponential of the whole, balanced by hand: velocities over a frequency.
    scale = np.tile([1.0, 1e4], 8)
    whole = np.zeros((17, 17))
    whole[:16, :16] = states.a * scale[None, :] / scale[:, None]
    whole[:16, 16:] = states.b / scale[:, None]
    held = linalg.expm(whole * setpoint.sample_time)
    x, reached = np.zeros(16), []
    for value in force.values:
        reached.append(float(states.c[0] * scale @ x))
        x = held[:16, :16] @ x + held[:16, 16] * value
    wanted = np.concatenate([np.zeros(len(force.time) - len(setpoint.time)), setpoint.derivatives[0]])
    np.testing.assert_allclose(reached, wanted, rtol=0, atol=1e-11)  # 0.01 nm of 0.17 m


def test_gains_fitted_to_a_force_are_those_fitted_to_the_move(plant, setpoint):
    controller = PidFamily(stage_mass())(35.0)
    loop = closed_loop(plant, None, controller.state_space())
    found = fit_to_force(bare_error(controller), ideal_force(invert(plant), setpoint))
    np.testing.assert_allclose(found.gains, fit_feedforward(error_loop(loop), setpoint).gains, rtol=1e-4)
