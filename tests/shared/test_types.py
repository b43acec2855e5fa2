"""The tests' own type checker: what it refuses, and from which call of a function on it trusts."""

import numpy as np
import pytest
from jaxtyping import Float64, TypeCheckError, jaxtyped

import typecheck
from stillwork.base.validation import checked
from stillwork.estimation.triangle_kernels import least_share


@jaxtyped(typechecker=typecheck.check)
def doubled(values: Float64[np.ndarray, " n"], times: float = 2.0) -> Float64[np.ndarray, " n"]:
    return values if times < 0 else times * values if times else times * values[1:]


def test_arguments_results_and_sizes_are_checked():
    assert doubled(np.ones(3), 2)[0] == 2.0  # an int serves as a float
    for arguments in ((np.ones((3, 3)),), ([1.0],), (np.ones(3), "2"), (np.ones(3), 0.0)):
        with pytest.raises(TypeCheckError):
            doubled(*arguments)


def test_the_toolbox_is_checked():
    with pytest.raises(TypeCheckError):
        least_share("3")


def test_a_function_is_trusted_after_its_first_calls_and_checked_again_in_the_next_test():
    for _ in range(2):
        typecheck.begin_again()
        with pytest.raises(TypeCheckError):
            doubled([1.0])
        for _ in range(typecheck.FIRST):
            doubled(np.ones(3))
        assert doubled([1.0], -1.0) == [1.0]


def test_the_front_door_still_reads_the_annotations_of_a_trusted_function():
    """It opens at its own first call, which may come after those that the library made itself."""
    typecheck.begin_again()
    for _ in range(typecheck.FIRST):
        doubled(np.ones(3))
    assert checked(doubled)([1.0], 2).tolist() == [2.0]
