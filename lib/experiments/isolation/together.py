"""FeRLS of several runs side by side in the loop's kernel: one P a lane, in the triangle's form."""

import numpy as np

from experiments.isolation.lanes import at_most
from stillwork.base.kernels import kernel, pasted_kernel
from stillwork.estimation.adaptive import hold_triangle, step_weights
from stillwork.estimation.covariance_forms import update_covariance


@pasted_kernel
def ferls_updates(weights, matrix, forgetting, levels, each, allowance, gain, regressor, error):
    """`ferls_update` of every run, `each` being the same memory as `levels`, run by run.

    Returns the leverage, and whether `hold_each` has nothing to do.
    """
    leverage, shrink = update_covariance(matrix, regressor, forgetting, gain)
    step_weights(weights, gain, shrink, error)
    runs, within = each.shape[1] // levels.shape[1], True
    for i in range(len(gain)):
        power = forgetting * levels[1, i] + regressor[i] * regressor[i]
        levels[1, i] = power
        levels[2, i] *= forgetting
        if not at_most(levels[0, i] * power, allowance):
            for at in range(i * runs, (i + 1) * runs):
                if each[0, at] * each[1, at] > allowance:
                    each[0, at] = allowance / each[1, at]
        within &= at_most(matrix[i, i], levels[0, i])
    return leverage, within


@kernel
def hold_each(matrix, forgetting, levels, runs):
    """`hold_triangle` of every run, by copies: it is rare."""
    count = len(matrix)
    one, limits, work = np.empty((count, count)), np.empty((4, count)), np.empty(count)
    # In loops: slices would triple the time to compile.
    for run in range(runs):
        for i in range(count):
            for row in range(count):
                one[row, i] = matrix[row, i * runs + run]
            for row in range(len(limits)):
                limits[row, i] = levels[row, i * runs + run]
        hold_triangle(one, forgetting, limits, work)
        for i in range(count):
            for row in range(count):
                matrix[row, i * runs + run] = one[row, i]
            for row in range(len(limits)):
                levels[row, i * runs + run] = limits[row, i]
