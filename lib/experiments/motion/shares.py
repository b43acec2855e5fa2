"""How often something holds over independent runs."""

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.checks import require_array
from stillwork.workbook.studies import proportion_interval


def share(holds: ArrayLike) -> tuple[float, tuple[float, float]]:
    """Share of what holds, with Wilson's interval over the runs (first axis).

    Parts of a run are not independent: they make its share, and the runs alone are counted.
    """
    holds = require_array("holds", np.asarray(holds, float))
    runs = len(holds)
    return float(holds.mean()), proportion_interval(int(np.floor(holds.mean() * runs + 1e-9)), runs)
