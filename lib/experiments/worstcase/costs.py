"""What an update costs: multiplications, divisions and roots, counted from the loops of the kernels."""

import numpy as np

from stillwork.base.checks import require_choice, require_count

# Evaluations that each root of the rank-one eigenproblem takes on average, counted over random updates.
ROOT_EVALUATIONS = 3.4

COUNTED = ("least squares", "ridge", "approximate", "exact", "fast")


def multiplications(update: str, unknowns: int, evaluations: float = 1.0) -> float:
    """Multiplications, divisions and square roots of one update, one of `COUNTED`.

    `evaluations` are those of the secular function: from `Track.evaluations` (exact, fast), or the number of
    fixed-point iterations (approximate).
    """
    require_choice("update", update, COUNTED)
    n = require_count("unknowns", unknowns)
    accumulate = n * (n + 1) + 4 * n
    factorise = n * (n - 1) * (n - 2) / 6 + 3 * n * (n - 1) / 2 + n
    forward = n * (n - 1) / 2
    backward = forward + n
    squares = forward + 5 * n
    if update == "least squares":
        return 2.0 * n**2 + 5 * n + 3
    if update == "ridge":
        return accumulate + factorise + backward
    if update == "approximate":
        gain = forward + backward + 3 * n + 1
        return accumulate + 2 + gain + evaluations * (squares + 4 + factorise + backward)
    if update == "exact":
        trial = factorise + 2 * backward + squares + forward + 2 * n + 30
        return accumulate + 2 + evaluations * trial + forward + backward + 2 * n
    roots = n * (3 * n + ROOT_EVALUATIONS * (3 * n + 15))
    return n**3 + 8 * n**2 + 15 * n + roots + evaluations * (7 * n + 30)


def slope(sizes, costs) -> float:
    """Exponent of growth: least-squares slope of log cost over log size."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])
