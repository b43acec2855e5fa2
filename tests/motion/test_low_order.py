"""The low-order feedforward against a direct simulation of all states, normal equations and the ideal feedforward."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import published_setpoint, stage, stage_mass
from notebooks.motion.low_order_feedforward import (
    copy_poles,
    direct_loop,
    pick_poles,
)
from stillwork.control.feedforward import (
    BASIS,
    fit_feedforward,
    modified_feedforward,
    tracking_error,
)
from stillwork.control.loops import closed_loop
from stillwork.control.pid import PidFamily
from stillwork.control.setpoint import Setpoint, from_snap

PLANT = stage().at([0], [4])
CONTROLLER = PidFamily(stage_mass())(70.0).state_space()
BLOCK = stage_compensator(5, DESIGNS["MC and AD"])
LOOP = closed_loop(PLANT, BLOCK, CONTROLLER)
DIRECT = direct_loop(LOOP)
SETPOINT = published_setpoint(2e-4)
SHORT = Setpoint(1e-3, from_snap([1e3, -1e3], [0.005, 0.005], 1e-3), (0.0, 0.01), 0.01)


@pytest.fixture(scope="module")
def grown():
    return pick_poles(DIRECT, SETPOINT, copy_poles(modified_feedforward(BLOCK, CONTROLLER)), 4)


def test_without_filters_it_is_the_fit_of_the_four_gains(grown):
    fitted = fit_feedforward(DIRECT, SETPOINT)
    np.testing.assert_allclose(grown[0].gains.gains, fitted.gains, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        grown[0].error(DIRECT, SETPOINT), tracking_error(DIRECT, SETPOINT, fitted), atol=1e-13
    )


def test_error_is_that_of_an_integrated_loop(grown):
    """Every state by an adaptive integrator, from snap to error, on a short move."""
    chosen = grown[1]
    [pole] = chosen.poles
    first, second = chosen.weights
    w, gains = abs(pole), chosen.gains.gains
    n = len(DIRECT.a)

    def snap(t):
        return 1e3 if t < 0.005 else -1e3

    def slope(t, x):
        p, v, a, j = x[:4]
        z = x[4:6]
        force = gains @ [v, a, j, snap(t)] + first * z[0] + second * z[1]
        dz = [w * z[1], -w * z[0] + 2 * pole.real * z[1] + w * a]
        return np.concatenate([[v, a, j, snap(t)], dz, DIRECT.a @ x[6:] + DIRECT.b @ [p, force]])

    x, out = np.zeros(6 + n), [0.0]
    for k in range(10):
        x = integrate.solve_ivp(
            slope, (k * 1e-3 + 1e-15, (k + 1) * 1e-3 - 1e-15), x, method="LSODA", rtol=1e-10, atol=1e-16
        ).y[:, -1]
        out.append(float(DIRECT.c[0] @ x[6:] + DIRECT.d[0, 0] * x[0]))
    ours = chosen.error(DIRECT, SHORT)
    assert np.abs(DIRECT.d[0, 1]) == 0
    np.testing.assert_allclose(ours, out, atol=1e-6 * np.abs(out).max())


@pytest.mark.slow
def test_gains_are_optimal(grown):
    """No change of any single gain or weight lowers the squared error."""
    best = grown[-1]
    size = np.sum(best.error(DIRECT, SETPOINT) ** 2)
    for sign in (-1e-3, 1e-3):
        for k in range(len(best.weights)):
            weights = tuple(w * (1 + sign * (i == k)) for i, w in enumerate(best.weights))
            assert np.sum(replace(best, weights=weights).error(DIRECT, SETPOINT) ** 2) >= size
        for name in BASIS:
            gains = replace(best.gains, **{name: getattr(best.gains, name) * (1 + sign)})
            assert np.sum(replace(best, gains=gains).error(DIRECT, SETPOINT) ** 2) >= size
