"""The min-max problem handed to a general convex solver: the oracle for Theorem 1."""

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.checks import require_array, require_number


def solve_cone_program(matrix: ArrayLike, target: ArrayLike, bound: float) -> tuple[np.ndarray, float]:
    """Minimise |A x - b| + eta |x| (2) as a second-order cone program, by cvxpy and Clarabel: the estimate and its cost.

    It shares no code and no formula with `min_max_solve`. Compare costs, not estimates: near the minimum
    the cost is flat, and a solver that is right to 1e-8 in cost is right to 1e-4 in x.
    """
    import cvxpy

    matrix = require_array("matrix", matrix, ndim=2)
    target = require_array("target", target, shape=matrix.shape[:1])
    bound = require_number("bound", bound, at_least=0.0)
    unknown = cvxpy.Variable(matrix.shape[1])
    cost = cvxpy.norm(matrix @ unknown - target, 2) + bound * cvxpy.norm(unknown, 2)
    cvxpy.Problem(cvxpy.Minimize(cost)).solve(solver=cvxpy.CLARABEL)
    estimate = np.asarray(unknown.value, dtype=float)
    return estimate, float(np.linalg.norm(matrix @ estimate - target) + bound * np.linalg.norm(estimate))
