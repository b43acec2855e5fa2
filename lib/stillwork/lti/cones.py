"""Small convex programs: a linear cost under linear matrix inequalities and second-order cones, by Clarabel."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.extras import require_package

# The usual words for what Clarabel calls them.
SOLVED = {"Solved": "optimal", "AlmostSolved": "optimal_inaccurate"}


def minimise(
    costs: ArrayLike, parts: Callable[[np.ndarray], Sequence[np.ndarray]]
) -> tuple[np.ndarray | None, str]:
    """The x of least `costs` @ x for which every part lies in its cone, and the solver's status; None where there is none.

    `parts` is affine in x. Of a vector the first entry is at least the length of the others, of a symmetric matrix no
    eigenvalue is negative.
    """
    from scipy import sparse

    clarabel = require_package("clarabel")
    costs = np.asarray(costs, float)
    fixed = parts(np.zeros(len(costs)))
    right = np.concatenate([_entries(part) for part in fixed])
    columns = [np.concatenate([_entries(part) for part in parts(unit)]) for unit in np.eye(len(costs))]
    rows = sparse.csc_matrix(
        right[:, None] - np.transpose(columns)
    )  # Clarabel's form: right - rows @ x in the cones
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    nothing = sparse.csc_matrix((len(costs), len(costs)))  # of quadratic costs
    cones = [_cone(clarabel, part) for part in fixed]
    found = clarabel.DefaultSolver(nothing, costs, rows, right, cones, settings).solve()
    status = str(found.status)
    return (np.array(found.x) if status in SOLVED else None), SOLVED.get(status, status)


def _entries(part: np.ndarray) -> np.ndarray:
    """Clarabel's order: a matrix by the columns of its upper triangle, what stands twice times the root of two."""
    if part.ndim < 2:
        return part
    row, column = np.tril_indices(len(part))
    return part[row, column] * np.where(row == column, 1.0, np.sqrt(2.0))


def _cone(clarabel, part: np.ndarray):
    if part.ndim == 2:
        return clarabel.PSDTriangleConeT(len(part))
    return clarabel.SecondOrderConeT(len(part)) if len(part) > 1 else clarabel.NonnegativeConeT(1)
