"""Wrong values for every public function, each of which has a good call: a result, or an error that says what is wrong; nothing else.

In a process of their own, as a stranger calls: here the tests' type checker would answer first.
"""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

TESTS = Path(__file__).parents[1]


@pytest.mark.slow
def test_wrong_values_end_in_documented_errors():
    done = subprocess.run([sys.executable, "-W", "ignore", __file__], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def _nonsense(*_, **__) -> str:
    """A user's function that returns something unexpected; its exceptions would be its own."""
    return "nonsense"


ODD = (
    None, "text", "", "2020-01-01", b"x", True, float("nan"), float("inf"), -float("inf"), 0, -1, 1, 0.5, 3.7, 1e300,
    -1e300, 1e-300, 5e-324, 1e160, 10**400, -(10**400), 10**12, 1j, [], [[]], [[1], [1, 2]], ["1", "2"], [None], {},
    {"a": 1}, (), object(), np.float32(1.5), np.int64(3), np.array(2.0), np.array(np.nan), np.datetime64("2020-01-01"),
    np.zeros((0, 3)), np.zeros((2, 0)), np.zeros((2, 2, 2)), np.array(["a"]), np.array([None]), _nonsense,
)  # fmt: skip


def spoiled(value, how: int):
    """An array with a hole, of another size, shape or scale; a number of another scale; else an odd value."""
    odd = ODD[how % len(ODD)]
    if isinstance(value, np.ndarray) and value.size and value.dtype.kind in "fc" and how % 2:
        holed = value.copy()
        holed.flat[how % value.size] = (np.nan, np.inf, 0.0, -1.0, 1e300)[how % 5]
        changes = (
            holed,
            value.T,
            value[None],
            value.ravel(),
            np.atleast_1d(value)[..., :0],
            value[:-1] if value.ndim else holed,
        )
        return (*changes, value * 1e-300, value * 1e160, -value, np.zeros_like(value), value + 1j)[
            how // 2 % 11
        ]
    if type(value) is float and how % 2:
        return value * (-1.0, 1e-300, 1e-30, 1e3, 1e30, 1e300)[how // 2 % 6]
    if type(value) is int and how % 2:
        return (-5, -1, 0, 1, 3, 50)[how // 2 % 6]
    return odd


def try_wrong_values() -> None:
    from calls import CATALOGUE, missing
    from stillwork.base.checks import InputError
    from stillwork.estimation.online import UnstableAdaptation

    assert not missing(), missing()
    calls = {name: call for name, call in CATALOGUE.items() if call[1]}

    @settings(
        max_examples=1000,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.sampled_from(sorted(calls)), st.integers(0, 99), st.integers(0, 10**6))
    def ends_well(name, place, how):
        function, good = calls[name]
        key = list(good)[place % len(good)]
        try:
            function(**good | {key: spoiled(good[key], how)})
        except (InputError, FileNotFoundError, UnstableAdaptation) as error:
            assert str(error)

    ends_well()


if __name__ == "__main__":
    sys.path.append(str(TESTS))
    try_wrong_values()
