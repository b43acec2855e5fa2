"""What was asked for is what comes: each answer is compared with its question by other means, in any unit.

One line of a table for each function whose answer shall have a property that was asked for.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import linalg

from stillwork import control, estimation, lti
from stillwork.base.checks import InputError
from stillwork.control.feedback import band_pass, fed_back, place, stiffness_gain
from stillwork.control.kinematics import KinematicDesign
from stillwork.estimation.hinfinity import hinfinity_gains, smallest_level
from stillwork.estimation.time_varying import TimeVaryingModel


def machine(rng, unit, inputs=3):
    """A translation, a rotation and two flexible modes; forces in `unit` N, lengths in `unit` m."""
    frequencies = np.array([0.0, 0.0, *np.sort(rng.uniform(300.0, 3000.0, 2))])
    assume(frequencies[3] > 1.1 * frequencies[2])
    shapes = rng.uniform(0.2, 1.0, (4, inputs)) * rng.choice([-1.0, 1.0], (4, inputs))
    seen = rng.uniform(0.2, 1.0, (3, 4)) * rng.choice([-1.0, 1.0], (3, 4))
    assume(max(np.linalg.cond(shapes[:3]), np.linalg.cond(seen[:, :3])) < 100)
    damping = np.array([0.0, 0.0, *rng.uniform(1e-3, 0.02, 2)])
    return lti.ModalModel(frequencies, damping, shapes * unit, seen / unit, np.zeros((3, inputs)))


def the_damping_of_one_mode_grows_as_asked(rng, unit):
    mode = machine(rng, unit, inputs=1).modes([3])
    increase = rng.uniform(0.01, 0.3)
    found = fed_back(mode, control.damping_gain(mode, increase))
    return found.damping, mode.damping + increase, 1e-9


def the_damping_of_all_modes_grows_as_asked(rng, unit):
    model = machine(rng, unit, inputs=1).modes([0, 2, 3])  # one rigid-body mode, for one input
    increase = rng.uniform(0.01, 0.3, 2)
    found = fed_back(model, control.damping_gain(model, increase, "pole placement"))
    return found.damping[1:], model.damping[1:] + increase, 1e-6


def a_resonance_moves_by_the_factor(rng, unit):
    mode, factor = machine(rng, unit, inputs=1).modes([2]), rng.uniform(0.5, 2.0)
    return fed_back(mode, stiffness_gain(mode, factor)).frequencies, factor * mode.frequencies, 1e-9


def poles_lie_where_they_were_asked_for(rng, unit):
    model = lti.StateModel(
        rng.standard_normal((3, 3)), unit * rng.standard_normal((3, 1)), np.eye(3)[:1], np.zeros((1, 1))
    )
    reach = np.hstack([model.b, model.a @ model.b, model.a @ model.a @ model.b])
    assume(np.linalg.cond(reach) < 1e3)
    wanted = np.array([-1.0 - rng.random(), *(-2.0 + np.array([1j, -1j]) * rng.uniform(0.5, 3.0))])
    found = np.linalg.eigvals(model.a + model.b @ place(model, wanted))
    return np.sort_complex(found), np.sort_complex(wanted), 1e-7


def rigid_modes_are_told_apart_from_each_other_and_from_those_named(rng, unit):
    model = machine(rng, unit)
    found = control.decouple(model)
    products = [model.input_shapes[:3] @ found.actuation, (found.sensing @ model.output_shapes[:, :3]).T]
    return np.array(products), np.array([np.eye(3)[:, :2]] * 2), 1e-9


def what_is_left_out_leaves_its_compliance(rng, unit):
    model = machine(rng, unit)
    short, omega = lti.truncate(model, modes=2, compensated=2), np.array([1e-3])
    return short.frequency_response(omega), model.frequency_response(omega), 1e-9


def a_band_pass_passes_its_middle_and_half_the_power_at_its_edges(rng, unit):
    omega, selectivity = rng.uniform(1.0, 100.0) * unit, rng.uniform(0.5, 20.0)
    edges = omega * (np.sqrt(1 + 1 / (4 * selectivity**2)) + np.array([-1, 1]) / (2 * selectivity))
    found = band_pass(omega, selectivity).frequency_response(np.array([omega, *edges]))[0, 0]
    return found, np.array([1.0, 0.5 + 0.5j, 0.5 - 0.5j]), 1e-9


def an_error_decays_with_the_exponent_that_was_asked_for(rng, unit):
    exponent, order, integrals = rng.uniform(0.5, 20.0) * unit, *map(int, rng.integers([1, 0], 3))
    gains = KinematicDesign(exponent, integrals=integrals, order=order).gains
    polynomial = np.append(gains, 1.0)[::-1] / exponent ** np.arange(len(gains) + 1)
    return polynomial, np.poly(-np.ones(len(gains))), 1e-9


def a_filter_keeps_the_smallest_level_and_none_below(rng, unit):
    turn = linalg.expm(np.array([[0.0, 0.3], [-0.3, -0.1]]))
    c, eye = np.broadcast_to(rng.standard_normal((1, 2)), (30, 1, 2)), np.eye(2)
    model = TimeVaryingModel(
        turn, np.zeros((2, 1)), eye, c / unit, 0.1 * eye * unit**2, np.eye(1), eye * unit**2
    )
    wanted = rng.standard_normal((1, 2)) / unit
    level = smallest_level(model, wanted, 1e-6)
    hinfinity_gains(model, wanted, level)
    with pytest.raises(InputError, match="level"):
        hinfinity_gains(model, wanted, level / (1 + 2e-6))
    return level, level, 0.0


ASKED = {
    each.__name__: each
    for each in (
        the_damping_of_one_mode_grows_as_asked,
        the_damping_of_all_modes_grows_as_asked,
        a_resonance_moves_by_the_factor,
        poles_lie_where_they_were_asked_for,
        rigid_modes_are_told_apart_from_each_other_and_from_those_named,
        what_is_left_out_leaves_its_compliance,
        a_band_pass_passes_its_middle_and_half_the_power_at_its_edges,
        an_error_decays_with_the_exponent_that_was_asked_for,
        a_filter_keeps_the_smallest_level_and_none_below,
    )
}
SEEDS, UNITS = st.integers(0, 2**32 - 1), st.sampled_from([1e-9, 1e-3, 1.0, 1e3, 1e9])


@pytest.mark.parametrize("name", ASKED)
@settings(max_examples=25)
@given(seed=SEEDS, unit=UNITS)
def test_the_answer_is_what_was_asked_for(name, seed, unit):
    found, wanted, tolerance = ASKED[name](np.random.default_rng(seed), unit)
    assert np.shape(found) == np.shape(wanted)
    assert np.abs(found - wanted).max() <= tolerance * np.abs(wanted).max()


def squares_of_a_move(rng, unit):
    """The sum of squared errors of a move, of the gains of feedforward."""
    plant = lti.ModalModel(
        np.array([0.0, rng.uniform(300.0, 900.0)]),
        np.array([0.0, 0.02]),
        np.array([[0.3], [0.2]]),
        np.array([[0.3, rng.choice([-0.2, 0.2])]]) / unit,
        np.zeros((1, 1)),
    )
    loop = control.closed_loop(plant, None, control.PidFamily(11.0 * unit)(10.0).state_space())
    assume(loop.is_stable)
    loop = control.error_loop(loop)
    limits = np.array([1e4, 100.0, 2.0, 0.1]) / unit
    move = control.point_to_point(*limits, cruise=0.02, settling=0.005, sample_time=1e-3)
    best = control.fit_feedforward(loop, move)

    def squares(gains):
        tried = control.Feedforward(*map(float, gains))
        return np.sum(control.tracking_error(loop, move, tried) ** 2)

    return np.array(best.gains), squares


def norm_of_a_loop(rng, unit):
    """The H2 norm of a loop, of the output row of its controller."""
    n = 3
    a = rng.standard_normal((n, n)) - np.eye(n)
    b = np.hstack([rng.standard_normal((n, 1)), np.zeros((n, 1)), rng.standard_normal((n, 1))])
    c = np.vstack([rng.standard_normal((1, n)) / unit, np.zeros((1, n)), rng.standard_normal((1, n)) / unit])
    d = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5 / unit], [0.0, 0.3 / unit, 0.0]])
    plant = lti.GeneralisedPlant(lti.StateModel(a, b, c, d), exogenous=2, performance=2)
    controller = estimation.h2_riccati(plant).controller
    assert plant.close(controller).is_stable

    def norm(row):
        loop = plant.close(replace(controller, c=row[None, :]))
        return lti.h2_norm(loop) if loop.is_stable else np.inf

    return controller.c[0], norm


@pytest.mark.parametrize("problem", [squares_of_a_move, norm_of_a_loop])
@settings(max_examples=10)
@given(seed=SEEDS, unit=UNITS)
def test_nothing_near_the_optimum_is_better(problem, seed, unit):
    rng = np.random.default_rng(seed)
    best, cost = problem(rng, unit)
    least = cost(best)
    for size in (1e-4, 1e-2):
        for _ in range(4):
            other = best * (1 + size * rng.standard_normal(best.shape))
            assert cost(other) >= least * (1 - 1e-9)
