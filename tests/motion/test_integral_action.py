"""Theorems on integral action, the small-gain check and the high-pass alternative."""

import numpy as np
import pytest

from experiments.motion.designs import DESIGNS, RETAINED, stage_compensator, stage_observer
from experiments.motion.loop_conditions import static_gain
from experiments.motion.machines import stage, stage_mass
from notebooks.motion.compensation_and_damping import small_gain, without_compliance
from stillwork.control.applications import Application, compensator
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import PidFamily

PLANT = stage().at([0], [4])
CONTROLLER = PidFamily(stage_mass())(35.626)


def vanish(block, row):
    """Which static gains, from force and from output, are rounding beside the largest over frequency: (3.12), (3.13), (3.38), (3.39)."""
    largest = np.abs(block.frequency_response(np.abs(block.poles))[row]).max(axis=1)
    return np.abs(static_gain(block)[row]) <= 1e-9 * largest


@pytest.mark.parametrize("position", [1, 3, 7])
def test_noise_model_keeps_the_integral_action(position):
    """Theorems 3.2.3 and 3.2.4."""
    plain, mended = (
        compensator(stage_observer(position, noise_model=q), Application(compensate=True))
        for q in (None, 0.03)
    )
    assert not vanish(plain, 1)[0]
    assert vanish(mended, 1).all()
    high_pass = compensator(stage_observer(position), Application(compensate=True, high_pass_hz=1.0))
    assert vanish(high_pass, 1).all()


def test_damping_keeps_the_integral_action():
    """Theorem 3.3.1."""
    assert vanish(stage_compensator(5, DESIGNS["AD"]), 0)[1]


def test_a_constant_force_leaves_an_error_only_where_the_integrator_is_lost():
    for name, noise_model, expected in (("lost", None, False), ("kept", 0.03, True)):
        block = compensator(stage_observer(5, noise_model=noise_model), Application(compensate=True))
        loop = closed_loop(PLANT, block, CONTROLLER.state_space())
        force = channel(loop, "w", "e_true")
        gain = np.abs(force.frequency_response([1e-5])[0, 0, 0]) / np.abs(
            force.frequency_response([30.0])[0, 0, 0]
        )
        assert (gain < 1e-5) == expected, name


def test_small_gain_loop_is_the_whole_loop_opened_at_the_unknown_modes():
    """(3.45): closing H11 around S gives back the force of the complete loop."""
    observer = stage_observer(5, noise_model=0.03)
    application = Application(compensate=True, damping=0.035)
    omega = 2 * np.pi * np.array([5.0, 60.0, 470.0, 1800.0, 2400.0])
    nominal = compensator(without_compliance(observer), application)
    t_dc = float(observer.model.feedthrough[0, 0])
    found = small_gain(omega, PLANT, RETAINED, t_dc, nominal, CONTROLLER.state_space())
    whole = closed_loop(PLANT, compensator(observer, application), CONTROLLER.state_space())
    known = closed_loop(PLANT.modes(slice(0, RETAINED)), nominal, CONTROLLER.state_space())
    opened = channel(known, "u_ff", "f").frequency_response(omega)[0, 0]
    closed = opened / (1 - found)
    # u_ff reaches f through u, and f + nothing else drives the unknown modes.
    np.testing.assert_allclose(closed, channel(whole, "u_ff", "f").frequency_response(omega)[0, 0], rtol=1e-5)
