"""The low-order feedforward against a direct simulation of all states, normal equations and the ideal feedforward."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from experiments.motion.designs import DESIGNS, stage_compensator
from experiments.motion.machines import published_setpoint, stage, stage_mass
from experiments.motion.uncertainty import perturbed, sample_errors
from notebooks.motion.low_order_feedforward import (
    copy_poles,
    direct_loop,
    filters,
    fit_low_order,
    paint_low_order,
    perturbed_trial,
    pick_poles,
)
from stillwork.base.checks import InputError
from stillwork.control.feedforward import (
    BASIS,
    error_loop,
    fit_feedforward,
    modified_feedforward,
    tracking_error,
)
from stillwork.control.loops import closed_loop
from stillwork.control.pid import PidFamily
from stillwork.control.setpoint import Setpoint, from_snap
from stillwork.lti import StateModel
from stillwork.signals.moving_average import rms

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
def test_the_small_error_of_two_states_with_damping_alone_is_that_of_an_integrated_loop():
    """The published move up to the first 20 ms of the scan by a stiff integrator, segment by segment."""
    block = stage_compensator(5, DESIGNS["AD"])
    loop = direct_loop(closed_loop(PLANT, block, CONTROLLER))
    chosen = pick_poles(loop, SETPOINT, copy_poles(modified_feedforward(block, CONTROLLER)), 2)[1]
    [pole], w, n = chosen.poles, abs(chosen.poles[0]), len(loop.a)

    matrix = np.zeros((n + 6, n + 6))  # setpoint and derivatives, filter, loop
    matrix[[0, 1, 2], [1, 2, 3]] = 1
    matrix[4:6, 4:6], matrix[5, 2] = [[0, w], [-w, 2 * pole.real]], w
    force = np.zeros(n + 6)
    force[1:4], force[4:6] = chosen.gains.gains[:3], chosen.weights
    matrix[6:, 6:] = loop.a
    matrix[6:] += np.outer(loop.b[:, 1], force)
    matrix[6:, 0] += loop.b[:, 0]
    push = np.r_[0, 0, 0, 1, 0, 0, loop.b[:, 1] * chosen.gains.snap]
    seen = np.r_[loop.d[0, 0], np.zeros(5), loop.c[0]]

    snaps, edges = SETPOINT.derivatives[4], [0]
    last = round(0.06 / SETPOINT.sample_time)
    edges += [*(k for k in np.flatnonzero(np.diff(snaps)) + 1 if k < last), last]
    x, errors = np.zeros(n + 6), []
    for start, end in itertools.pairwise(edges):
        times = SETPOINT.time[start : end + 1]
        x = integrate.solve_ivp(
            lambda t, y, s=snaps[start]: matrix @ y + push * s,
            (times[0], times[-1]),
            x,
            method="LSODA",
            rtol=1e-9,
            atol=1e-15,
            t_eval=times,
        ).y
        errors += (seen @ x[:, :-1]).tolist()
        x = x[:, -1]
    ours = chosen.error(loop, SETPOINT)[: len(errors)]
    window = SETPOINT.scanning[: len(errors)]
    np.testing.assert_allclose(ours, errors, atol=1e-11)
    assert rms(np.array(errors)[window]) == pytest.approx(rms(ours[window]), rel=0.02)
    assert rms(ours[window]) < 5e-10


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


@pytest.mark.slow
def test_every_state_lowers_the_error_of_the_move_and_the_first_pick_is_the_best_one(grown):
    errors = [rms(each.error(DIRECT, SETPOINT)) for each in grown]
    assert [each.order for each in grown] == [0, 2, 4]
    assert np.all(np.diff(errors) < 0)
    candidates = copy_poles(modified_feedforward(BLOCK, CONTROLLER))
    alone = [
        rms(fit_low_order(DIRECT, SETPOINT, (pole,)).error(DIRECT, SETPOINT))
        for pole in candidates
        if pole.imag > 0
    ]
    assert errors[1] == pytest.approx(min(alone), rel=1e-6)


def test_two_states_do_what_the_observer_copy_does(grown):
    copy = tracking_error(error_loop(LOOP), SETPOINT, fit_feedforward(error_loop(LOOP), SETPOINT))
    window = SETPOINT.scanning
    assert rms(grown[1].error(DIRECT, SETPOINT)[window]) < rms(copy[window])
    assert len(modified_feedforward(BLOCK, CONTROLLER).a) == 18


@pytest.mark.parametrize("pole", [-300.0 + 0.0j, -50.0 + 400.0j])
def test_filters_have_their_poles_and_pass_with_gain_one(pole):
    for each in filters(pole):
        assert np.abs(each.poles - pole).min() < 1e-9 * abs(pole)
    still = filters(pole)[0]
    assert abs(still.frequency_response(np.array([1e-6]))[0, 0, 0]) == pytest.approx(1, rel=1e-9)


def test_perturbed_trial_without_errors_is_the_nominal_case(grown):
    found = perturbed_trial(
        np.random.default_rng(1), PLANT, BLOCK, CONTROLLER, SETPOINT, grown[0].gains, {"two": grown[1]}, 0.0
    )
    nominal = rms(grown[1].error(DIRECT, SETPOINT)[SETPOINT.scanning])
    assert found["two, kept"] == pytest.approx(nominal, rel=1e-9)
    assert found["two, tuned"] == pytest.approx(nominal, rel=1e-3)
    copy = tracking_error(error_loop(LOOP), SETPOINT, grown[0].gains)
    assert found["observer copy, kept"] == pytest.approx(rms(copy[SETPOINT.scanning]), rel=1e-6)
    assert found["observer copy, tuned"] < found["observer copy, kept"]


def test_perturbed_trial_tunes_on_the_plant_that_it_meets(grown):
    settings = {"plant": PLANT, "compensator": BLOCK, "controller": CONTROLLER, "setpoint": SETPOINT}
    original = fit_feedforward(error_loop(LOOP), SETPOINT)
    found = perturbed_trial(
        np.random.default_rng(1), **settings, copied=original, candidates={"two": grown[1]}, size=0.05
    )
    plant = perturbed(PLANT, sample_errors(np.random.default_rng(1), PLANT, 0.05))
    met = direct_loop(closed_loop(plant, BLOCK, CONTROLLER))
    tuned = fit_low_order(met, SETPOINT, grown[1].poles)
    for key, feedforward in (("two, kept", grown[1]), ("two, tuned", tuned)):
        expected = rms(feedforward.error(met, SETPOINT)[SETPOINT.scanning])
        assert found[key] == pytest.approx(expected, rel=1e-6)
    assert np.sum(tuned.error(met, SETPOINT) ** 2) < np.sum(grown[1].error(met, SETPOINT) ** 2)


@pytest.mark.slow
def test_explorer_shows_the_states_it_has():
    assert paint_low_order("MC and AD", 5, 100.0).axes[0].get_title(loc="left").startswith("4 states")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: fit_low_order(StateModel(DIRECT.a, DIRECT.b[:, :1], DIRECT.c, DIRECT.d[:, :1]), SETPOINT),
            r"^loop\b",
        ),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
