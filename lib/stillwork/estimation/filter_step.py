"""One sample through any filter: what a filter hands to the kernels, and the one kernel that knows them all."""

from typing import NamedTuple

import numpy as np

from stillwork.base.kernels import borrowing_kernel
from stillwork.estimation.extended import plant_extended_step
from stillwork.estimation.low_pass import low_pass_step
from stillwork.estimation.unscented import plant_unscented_step
from stillwork.estimation.windows import moving_window_step, savitzky_golay_step

OPERATIONS = 400  # of a sample in the unscented filter, which takes most
WINDOW, LOW_PASS, UNSCENTED, EXTENDED, SAVITZKY_GOLAY = range(5)


class Packed(NamedTuple):
    """A filter as the kernels take it: which one, its numbers, and a workspace that starts at zero."""

    kind: int
    options: np.ndarray  # float64, one axis
    process: np.ndarray  # Q, two axes; empty where there is none
    noise: np.ndarray  # R
    work: np.ndarray  # three axes


@borrowing_kernel
def filter_step(device, acceleration, plant, sample_time, measured, force, estimate):
    """Advance one filter by one sample; `estimate` (position, velocity, acceleration) is read and written."""
    kind, options, process, noise, work = device
    if kind == WINDOW:
        moving_window_step(options, work, sample_time, measured, estimate)
        return True
    if kind == LOW_PASS:
        low_pass_step(options, work, sample_time, measured, estimate)
        return True
    if kind == SAVITZKY_GOLAY:
        savitzky_golay_step(options, work, sample_time, measured, estimate)
        return True
    if kind == UNSCENTED:
        return plant_unscented_step(
            options, process, noise, work, acceleration, plant, sample_time, measured, force, estimate
        )
    return plant_extended_step(
        options, process, noise, work, acceleration, plant, sample_time, measured, force, estimate
    )
