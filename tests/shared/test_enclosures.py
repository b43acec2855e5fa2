"""Proven bounds: no enclosure misses the norm by 70 digits, and what cannot be known is not called proven."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from naive.precise import judged_norm, sample_model
from stillwork import lti
from stillwork.base.checks import InputError
from stillwork.lti.enclosures import enclose_hinf_norm, is_proven_stable


@pytest.mark.parametrize("seeds", [range(12), pytest.param(range(12, 60), marks=pytest.mark.slow)])
def test_an_enclosure_holds_the_norm_by_seventy_digits(seeds):
    for seed in seeds:
        kind, model = sample_model(np.random.default_rng(seed))
        found, norm = enclose_hinf_norm(model), judged_norm(model)
        assert found.proven and found.low <= norm * (1 + 1e-12) and norm <= found.high, (seed, kind)
        assert found.high <= found.low * (1 + 1e-6), (seed, kind)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-200, 200), st.floats(-100, 100))
def test_an_enclosure_scales_with_units_and_forgets_the_order_of_states(seed, size, rate):
    rng = np.random.default_rng(seed)
    modes = lti.ModalModel(
        np.sort(10 ** rng.uniform(0, 3, 2)),
        10 ** rng.uniform(-5, -1, 2),
        rng.normal(size=(2, 1)),
        rng.normal(size=(1, 2)),
        np.zeros((1, 1)),
    )
    model = modes.state_space()
    found = enclose_hinf_norm(model)
    unit, speed = 2.0 ** round(size), 2.0 ** round(rate)
    order = rng.permutation(4)
    other = lti.StateModel(
        speed * model.a[np.ix_(order, order)], speed * model.b[order], unit * model.c[:, order], model.d
    )
    moved = enclose_hinf_norm(other)
    assert moved.low / unit <= found.high and found.low <= moved.high / unit
    assert moved.proven and moved.high <= moved.low * (1 + 1e-7)


@pytest.mark.parametrize("sample_time", [0.0, 1e-3])
@pytest.mark.parametrize("distance", [1e-12, 1e-200])
def test_stability_is_proven_to_the_last_digit(sample_time, distance):
    """A pole a rounding away from the boundary; at 1e-200 from the axis in continuous time, too."""
    distance = 2.0**-52 if sample_time and distance < 2.0**-52 else 2.0 ** np.floor(np.log2(distance))
    for sign in (-1, 1):
        pole = 1.0 + sign * distance if sample_time else sign * distance
        for poles in ([pole], [pole, -0.5]):
            size = len(poles)
            model = lti.StateModel(
                np.diag(poles), np.ones((size, 1)), np.ones((1, size)), np.zeros((1, 1)), sample_time
            )
            assert is_proven_stable(model) is (sign < 0)
            found = enclose_hinf_norm(model)
            assert found.proven and (found.low == np.inf) is (sign > 0)
            if sign < 0:
                assert found.low <= 1 / distance * (1 + 4 * distance) + 2.0 and found.high >= 1 / distance


@pytest.mark.parametrize("sample_time", [0.0, 1.0])
def test_a_pole_on_the_boundary_is_no_stable_one(sample_time):
    for angle in (0.0, 0.5, 1.0):  # in continuous time 0, and two pairs on the axis
        turn = np.array([[0.0, 1.0], [-1.0, 0.0]]) if sample_time else np.array([[0.0, angle], [-angle, 0.0]])
        model = lti.StateModel(turn, np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), sample_time)
        assert is_proven_stable(model) is not True
        assert not (enclose_hinf_norm(model).high < np.inf)


def test_what_is_constant_and_what_passes_nothing():
    gain = lti.state_space.constant(np.diag([3.0, 4.0]))
    found = enclose_hinf_norm(gain)
    assert found.low <= 4.0 <= found.high <= 4.0 * (1 + 1e-7) and found.proven
    lag = lti.StateModel(-np.eye(1), np.zeros((1, 1)), np.eye(1), np.zeros((1, 1)))
    assert (enclose_hinf_norm(lag).low, enclose_hinf_norm(lag).high) == (0.0, 0.0)


def test_decibels_are_rounded_outwards():
    found = lti.Enclosure(1.9952, 1.9953, True).in_db()
    assert 10 ** (found.low / 20) < 1.9952 and 10 ** (found.high / 20) > 1.9953
    assert "not proven" in str(replace(found, proven=False)) and "not" not in str(found)


def test_more_signals_than_it_takes_are_refused():
    with pytest.raises(InputError, match="model"):
        enclose_hinf_norm(lti.StateModel(-np.eye(4), np.eye(4), np.eye(4), np.zeros((4, 4))))
