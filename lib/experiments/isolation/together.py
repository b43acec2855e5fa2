"""FeRLS of several runs side by side in the loop's kernel: one P a lane, in the triangle's form."""

import numpy as np

from experiments.isolation.lanes import at_most, put, runs_of, same, take
from stillwork.base.kernels import kernel, pasted_kernel
from stillwork.estimation.adaptive import hold_covariance
from stillwork.estimation.covariance_forms import TRIANGLE


@pasted_kernel
def ferls_updates(weights, matrix, forgetting, levels, allowance, gain, regressor, error, together):
    """`ferls_update` of every run; returns the leverage, and whether `hold_each` has nothing to do."""
    runs = runs_of(together)
    count = weights.shape[1] // runs
    leverage = same(forgetting, together)
    for i in range(count):
        total = same(0.0, together)
        for j in range(count):
            total += take(matrix, (i, j), together) * take(regressor, j, together)
        put(gain, i, total, together)
        leverage += total * take(regressor, i, together)
    if not at_most(forgetting, leverage):
        return leverage, True
    shrink = 1.0 / leverage
    forget = 1.0 / forgetting
    for i in range(count):
        scaled = take(gain, i, together) * shrink
        for j in range(i + 1):
            value = (take(matrix, (i, j), together) - scaled * take(gain, j, together)) * forget
            put(matrix, (i, j), value, together)
            put(matrix, (j, i), value, together)
    for i in range(count):
        put(gain, i, take(gain, i, together) * shrink, together)
    for a in range(weights.shape[0]):
        scaled = take(error, a, together)
        for j in range(count):
            step = scaled * take(gain, j, together)
            put(weights, (a, j), take(weights, (a, j), together) - step, together)
    within = True
    for i in range(count):
        value = take(regressor, i, together)
        power = forgetting * take(levels, (1, i), together) + value * value
        put(levels, (1, i), power, together)
        put(levels, (2, i), forgetting * take(levels, (2, i), together), together)
        if not at_most(take(levels, (0, i), together) * power, allowance):
            for at in range(i * runs, (i + 1) * runs):
                if levels[0, at] * levels[1, at] > allowance:
                    levels[0, at] = allowance / levels[1, at]
        within &= at_most(take(matrix, (i, i), together), take(levels, (0, i), together))
    return leverage, within


@kernel
def first_below(forgetting, gain, regressor, runs):
    """The run whose leverage fell below the forgetting, or is no number."""
    for run in range(runs):
        leverage = forgetting
        for at in range(run, len(gain), runs):
            leverage += gain[at] * regressor[at]
        if not leverage >= forgetting:
            return run
    return -1


@kernel
def hold_each(matrix, forgetting, levels, runs):
    """`hold_covariance` of every run, by copies: it is rare."""
    count = len(matrix)
    one, limits, work = np.empty((count, count)), np.empty((3, count)), np.empty(count)
    # In loops: slices would triple the time to compile.
    for run in range(runs):
        for i in range(count):
            for row in range(count):
                one[row, i] = matrix[row, i * runs + run]
            for row in range(len(limits)):
                limits[row, i] = levels[row, i * runs + run]
        hold_covariance(TRIANGLE, one, forgetting, limits, work, work, 0)
        for i in range(count):
            for row in range(count):
                matrix[row, i * runs + run] = one[row, i]
            for row in range(len(limits)):
                levels[row, i * runs + run] = limits[row, i]
