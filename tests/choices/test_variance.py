"""Shares of variance against closed forms and against sums written out."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from choices.toy_work import FIRST, TOTAL
from workbook.choices.variance import SEED, variance_shares


def grid(*sizes):
    return list(itertools.product(*map(range, sizes)))


def toy(design):
    return np.array([[a + 2 * b + a * b] for a, b, *_ in design], float)


def test_all_combinations_give_the_closed_form():
    shares = variance_shares(toy(grid(3, 2)), grid(3, 2), {"a": 3, "b": 2}, False)
    assert shares.first == pytest.approx(FIRST)
    assert shares.total == pytest.approx(TOTAL)


SIZES = {"a": 3, "b": 2, "c": 4, "d": 3, "e": 2}


@pytest.mark.parametrize("points", [40, 64, 100])
def test_a_sample_without_noise_gives_the_closed_form(points):
    rng = np.random.default_rng(3)
    design = [grid(*SIZES.values())[k] for k in rng.permutation(144)[:points]]
    shares = variance_shares(toy(design), design, SIZES, False)
    others = dict.fromkeys("cde", 0.0)
    assert shares.first == pytest.approx(FIRST | others, abs=1e-9)
    assert shares.total == pytest.approx(TOTAL | others, abs=1e-9)


def test_seeds_are_an_axis_of_their_own():
    """Seeds that add -1, 0, 1 have 2/3 of variance beside the 47/12 of the toy: 8/55 of both together."""
    design = grid(3, 2)
    shares = variance_shares(toy(design) + np.array([-1, 0, 1]), design, {"a": 3, "b": 2}, True)
    assert shares.first == pytest.approx({"a": 18 / 55, "b": 27 / 55, SEED: 8 / 55})
    assert shares.total == pytest.approx({"a": 20 / 55, "b": 29 / 55, SEED: 8 / 55})


def test_a_noisy_sample_comes_close_and_blames_the_seeds():
    """Noise of 47/12, as much as the axes: 256 points with 4 seeds leave an uncertainty of about 0.05 in a share."""
    rng = np.random.default_rng(4)
    whole = grid(3, 2, 4, 3, 4)
    design = [whole[k] for k in rng.permutation(len(whole))[:256]]
    values = toy(design) + rng.normal(scale=np.sqrt(47 / 12), size=(256, 4))
    shares = variance_shares(values, design, {"a": 3, "b": 2, "c": 4, "d": 3, "e": 4}, True)
    assert shares.total[SEED] == pytest.approx(0.5, abs=0.05)
    assert shares.first["b"] == pytest.approx(27 / 94, abs=0.05)
    assert shares.first["a"] == pytest.approx(18 / 94, abs=0.05)
    assert max(shares.total[name] for name in "cde") < 0.02


def test_a_joint_effect_alone_is_found_in_a_sample():
    rng = np.random.default_rng(5)
    whole = grid(2, 2, 4, 3, 4)
    design = [whole[k] for k in rng.permutation(len(whole))[:64]]
    values = np.array([[float((a + b) % 2)] for a, b, *_ in design])
    shares = variance_shares(values, design, {"a": 2, "b": 2, "c": 4, "d": 3, "e": 4}, False)
    assert shares.total == pytest.approx({"a": 1, "b": 1, "c": 0, "d": 0, "e": 0}, abs=1e-9)
    assert shares.first["a"] == pytest.approx(0, abs=1e-9)


numbers = st.floats(-100, 100, allow_subnormal=False)


@given(arrays(float, (12, 2), elements=numbers), st.booleans())
def test_first_order_is_at_most_total_and_the_shares_add_up(values, seeded):
    shares = variance_shares(values, grid(3, 4), {"a": 3, "b": 4}, seeded)
    assume(shares is not None)
    for name, first in shares.first.items():
        assert -1e-12 <= first <= shares.total[name] <= 1 + 1e-9
    assert sum(shares.first.values()) <= 1 + 1e-9
    if seeded:
        assert sum(shares.total.values()) >= 1 - 1e-9


@pytest.mark.slow
@settings(derandomize=True)
@given(arrays(float, (30, 2), elements=numbers), st.permutations(["a", "b", "c"]), st.integers(0, 99))
def test_the_order_of_the_axes_does_not_matter_in_a_sample(values, order, seed):
    sizes = {"a": 3, "b": 4, "c": 5}
    whole = grid(3, 4, 5)
    design = [whole[k] for k in np.random.default_rng(seed).permutation(60)[:30]]
    permuted = [tuple(point["abc".index(name)] for name in order) for point in design]
    one = variance_shares(values, design, sizes, True)
    other = variance_shares(values, permuted, {name: sizes[name] for name in order}, True)
    assert (one is None) == (other is None)
    assume(one is not None)
    for name in (*sizes, SEED):
        assert other.first[name] == pytest.approx(one.first[name], abs=1e-6)
        assert other.total[name] == pytest.approx(one.total[name], abs=1e-6)
        assert 0 <= one.first[name] <= one.total[name] + 1e-12 <= 1 + 1e-6


@pytest.mark.parametrize(
    "values", [np.ones((6, 1)), np.full((6, 1), np.nan), 5 + 1e-7 * np.arange(6.0).reshape(6, 1)]
)
def test_where_nothing_varies_there_are_no_shares(values):
    assert variance_shares(values, grid(3, 2), {"a": 3, "b": 2}, False) is None
