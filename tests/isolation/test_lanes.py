import numpy as np
import pytest
from numba.core.errors import TypingError

from experiments.isolation.lanes import at_most, lanes
from stillwork.base.kernels import kernel, pasted_kernel

RUNS, CHANNELS = 8, 3


@pasted_kernel
def blend_one(first, second, out, limit):
    """Every operation once; returns the channel at which a run exceeds the limit, or -1."""
    for c in range(len(second)):
        total = 0.5
        total += first[1, c] * second[c]
        total -= 3.0 / second[c]
        total *= 1.5
        out[c] = -total + (total - 2.0 * first[0, c])
        if not at_most(total, limit):
            return c
    return -1


@kernel
def blend(first, second, out, limit, together):
    second, out = lanes((second, out), together)
    return blend_one(lanes(first, together), second, out, limit)


def arrays(seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal((2, CHANNELS * RUNS)), rng.uniform(1, 2, CHANNELS * RUNS)


def test_every_lane_gives_what_a_run_alone_gives_to_the_last_bit():
    first, second = arrays()
    found = np.zeros(CHANNELS * RUNS)
    assert blend(first, second, found, 1e9, (0,) * RUNS) == -1
    for run in range(RUNS):
        alone = np.zeros(CHANNELS)
        one = np.ascontiguousarray(first[:, run::RUNS])
        assert blend(one, np.ascontiguousarray(second[run::RUNS]), alone, 1e9, None) == -1
        np.testing.assert_array_equal(found[run::RUNS], alone)
    total = 1.5 * (0.5 + first[1] * second - 3.0 / second)
    np.testing.assert_array_equal(found, -total + (total - 2.0 * first[0]))


@pytest.mark.parametrize("bad", [1e3, np.nan])
def test_one_lane_beyond_a_limit_is_noticed(bad):
    first, second = arrays()
    first[1, RUNS + 5] = bad
    assert blend(first, second, np.zeros(CHANNELS * RUNS), 100.0, (0,) * RUNS) == 1


@pytest.mark.parametrize("changed", [lambda a: a.astype(np.float32), lambda a: np.repeat(a, 2)[::2]])
def test_lanes_of_other_memory_are_refused(changed):
    first, second = arrays()
    with pytest.raises(TypingError, match="float64"):
        blend(first, changed(second), np.zeros(CHANNELS * RUNS), 1e9, (0,) * RUNS)


@pytest.mark.parametrize("runs", [1, 2, 4])
def test_any_power_of_two(runs):
    first, second = (each[..., : CHANNELS * runs].copy() for each in arrays(4))
    found = np.zeros(CHANNELS * runs)
    assert blend(first, second, found, 1e9, (0,) * runs) == -1
    total = 1.5 * (0.5 + first[1] * second - 3.0 / second)
    np.testing.assert_array_equal(found, -total + (total - 2.0 * first[0]))


def test_a_vector_that_would_be_padded_is_refused():
    first, second = (each[..., : CHANNELS * 3].copy() for each in arrays())
    with pytest.raises(TypingError, match="power"):
        blend(first, second, np.zeros(CHANNELS * 3), 1e9, (0,) * 3)
