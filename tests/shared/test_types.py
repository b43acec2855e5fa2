"""The tests' own type checker: what it refuses."""

import numpy as np
import pytest
from jaxtyping import Float64, TypeCheckError, jaxtyped

import typecheck
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
