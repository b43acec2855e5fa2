import numpy as np
import pytest
from scipy import linalg, signal

from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import published_setpoint, stage, stage_mass
from experiments.motion.position_dependence import stage_grid
from notebooks.motion.twenty_nine_scans import (
    feedforward_error,
    location_loops,
    sampled_ideal_force,
    stage_error,
    study_locations,
)
from stillwork.control.feedforward import Feedforward, error_loop, fit_feedforward
from stillwork.control.loops import channel, closed_loop
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
    return feedforward_error(sampled_ideal_force(plant, setpoint), APPLIED)


def test_a_missing_force_moves_the_loop_as_scipy_steps_it(plant, setpoint, force):
    controller = PidFamily(stage_mass())(35.0)
    for name in ("PID", "AD"):
        loop = closed_loop(plant, stage_compensator(5, DESIGNS[name]), controller.state_space())
        model = channel(loop, "w", "e_true")
        balanced, (scale, _) = linalg.matrix_balance(model.a, permute=False, separate=True)
        held = signal.cont2discrete(
            (balanced, model.b / scale[:, None], model.c * scale, model.d), setpoint.sample_time
        )
        wanted = -signal.dlsim(held, force.values)[1][len(force.time) - len(setpoint.time) :, 0]
        loops = location_loops(stage(), GRID, [GRID[4]], {"one": (name, controller)})
        study = study_locations(loops, force, setpoint)
        np.testing.assert_allclose(study.errors["one"][0], wanted, atol=1e-6 * np.abs(wanted).max())


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


def test_gains_fitted_to_a_held_force_make_up_for_half_a_sample(plant, setpoint):
    """A held force acts half a sample late, so a part of the mass goes to the jerk, h/2, and to the snap, h^2/12."""
    controller, late = PidFamily(stage_mass())(35.0), setpoint.sample_time / 2
    error, ideal = stage_error(setpoint, controller), sampled_ideal_force(plant, setpoint)
    gains, *_ = np.linalg.lstsq(ideal.derivatives.T, ideal.values - error.values, rcond=None)
    moved = fit_feedforward(error_loop(closed_loop(plant, None, controller.state_space())), setpoint).gains
    moved = moved + stage_mass() * np.array([0, 0, late, late**2 / 3])
    np.testing.assert_allclose(gains, moved, rtol=1e-3)
