"""What the loop's kernel does for several runs side by side, where one run takes another order of the sums.

Channel c of run r stands at c * runs + r. For each run the numbers are added in the order in which the kernel adds
them for a single run, so that both give the same bits; the runs fill a processor's vectors, which the few channels of
one run, and its chains of sums, leave half empty. `together` is a tuple whose length tells the compiler their number.
"""

import numpy as np

from stillwork.base.kernels import inlined_kernel, kernel
from stillwork.estimation.adaptive import hold_covariance, watch_power
from stillwork.estimation.covariance_forms import TRIANGLE

COLUMNS = 4  # of the loop's matrix that a product takes at a time


@inlined_kernel
def multiply_runs(matrix, vector, product, together):
    """product = matrix' vector, four inputs at a time."""
    for i in range(len(product)):
        product[i] = 0.0
    runs = len(together)
    for j in range(0, matrix.shape[0], COLUMNS):
        for i in range(matrix.shape[1]):
            for run in range(runs):
                product[i * runs + run] += (
                    matrix[j, i] * vector[j * runs + run] + matrix[j + 1, i] * vector[(j + 1) * runs + run]
                ) + (
                    matrix[j + 2, i] * vector[(j + 2) * runs + run]
                    + matrix[j + 3, i] * vector[(j + 3) * runs + run]
                )


@inlined_kernel
def command_of(weights, regressor, damping, command, totals, together):
    """u = W psi less the damping."""
    runs = len(together)
    for i in range(weights.shape[0]):
        for run in range(runs):
            totals[run] = -damping[i * runs + run]
        for j in range(weights.shape[1] // runs):
            for run in range(runs):
                totals[run] += weights[i, j * runs + run] * regressor[j * runs + run]
        for run in range(runs):
            command[i * runs + run] = totals[run]


@inlined_kernel
def felms_updates(weights, regressor, error, step_size, regularisation, trace_copies, rates, together):
    """`felms_update` of every run."""
    runs = len(together)
    count = weights.shape[1] // runs
    for run in range(runs):
        rates[run] = 0.0
    for j in range(count):
        for run in range(runs):
            rates[run] += regressor[j * runs + run] * regressor[j * runs + run]
    for run in range(runs):
        rates[run] = step_size / (regularisation + trace_copies * rates[run])
    for i in range(weights.shape[0]):
        for j in range(count):
            for run in range(runs):
                scaled = rates[run] * error[i * runs + run]
                weights[i, j * runs + run] -= scaled * regressor[j * runs + run]


@inlined_kernel
def ferls_updates(
    weights, matrix, forgetting, levels, allowance, gain, regressor, error, total, shrink, together
):
    """`ferls_update` of every run, its limit included; returns a run that lost definiteness, or -1."""
    runs = len(together)
    count = weights.shape[1] // runs
    for run in range(runs):
        shrink[run] = forgetting
    for i in range(count):
        for run in range(runs):
            total[run] = 0.0
        for j in range(count):
            for run in range(runs):
                total[run] += matrix[i, j * runs + run] * regressor[j * runs + run]
        for run in range(runs):
            gain[i * runs + run] = total[run]
            shrink[run] += total[run] * regressor[i * runs + run]
    for run in range(runs):
        if not shrink[run] >= forgetting:
            return run
        shrink[run] = 1.0 / shrink[run]
    forget = 1.0 / forgetting
    for i in range(count):
        for run in range(runs):
            total[run] = gain[i * runs + run] * shrink[run]
        for j in range(i + 1):
            for run in range(runs):
                value = (matrix[i, j * runs + run] - total[run] * gain[j * runs + run]) * forget
                matrix[i, j * runs + run] = value
                matrix[j, i * runs + run] = value
    for i in range(count):
        for run in range(runs):
            gain[i * runs + run] *= shrink[run]
    for a in range(weights.shape[0]):
        for j in range(count):
            for run in range(runs):
                weights[a, j * runs + run] -= error[a * runs + run] * gain[j * runs + run]
    reached = False
    for i in range(count):
        for run in range(runs):
            watch_power(levels, i * runs + run, regressor[i * runs + run], forgetting, allowance)
            reached |= matrix[i, i * runs + run] > levels[0, i * runs + run]
    if reached:
        _hold_each(matrix, forgetting, levels, runs)
    return -1


@kernel
def _hold_each(matrix, forgetting, levels, runs):
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
