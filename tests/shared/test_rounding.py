import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stillwork.base.rounding import TIE, below, first_largest, in_order


@pytest.mark.parametrize("residual", [0.0, 6.7e-16, -7.8e-16, 8e-14, 1.2e-13, 9.9e-13])
def test_a_residual_within_its_bound_shows_the_bound_alone(residual):
    assert below(residual, 1e-12) == "below 1e-12"
    assert below(residual, 1e-8) == "below 1e-8"


@pytest.mark.parametrize(("residual", "text"), [(1e-12, "1.0e-12"), (-3.21e-5, "-3.2e-05")])
def test_a_residual_beyond_its_bound_shows_itself(residual, text):
    assert below(residual, 1e-12) == text


different = st.lists(st.integers(-1000, 1000), min_size=1, max_size=20)


@given(different, st.data())
def test_rounding_does_not_change_which_of_equal_values_is_largest(values, data):
    noise = data.draw(st.lists(st.floats(-1e-9, 1e-9), min_size=len(values), max_size=len(values)))
    shaken = np.array(values, dtype=float) * (1 + np.array(noise))
    assert first_largest(shaken) == values.index(max(values))


def test_a_value_larger_by_more_than_the_tie_wins():
    assert first_largest([1.0, 1.0 + 2 * TIE]) == 1
    assert first_largest([1.0, 1.0 + TIE / 2]) == 0
    assert first_largest([1.0, 1.04, 0.2], tie=0.05) == 0
    assert first_largest([-1.0, -1.0 - TIE / 2, -0.5]) == 2


parts = st.integers(-5, 5)


@given(st.lists(st.tuples(parts, parts), min_size=1, max_size=12), st.randoms(), st.integers(0, 2**32 - 1))
def test_rounding_and_a_solvers_order_do_not_change_the_order_of_complex_values(pairs, random, seed):
    exact = [complex(*pair) for pair in sorted(pairs, key=lambda pair: pair[::-1])]
    random.shuffle(pairs)
    noise = np.random.default_rng(seed).uniform(-1e-12, 1e-12, (2, len(pairs)))
    shaken = np.array([complex(*pair) for pair in pairs]) + noise[0] + 1j * noise[1]
    np.testing.assert_allclose(in_order([shaken, shaken[::-1]]), [exact, exact], atol=1e-11)
