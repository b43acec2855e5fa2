"""The formulas of `costs` against a count: the kernels run uncompiled on numbers that count their products."""

import json
import os
import subprocess
import sys

import pytest

from notebooks.worstcase.time_updates import multiplications, slope

COUNT = """
import json, sys
import numpy as np
UPDATES, UNKNOWNS = json.loads(sys.argv[1])
count = 0

class Number(float):
    def _made(value):
        return value if value is NotImplemented else Number(value)
    def _counted(self, other):
        global count
        count += 1
    def __mul__(self, other): self._counted(other); return Number(float(self) * float(other))
    def __truediv__(self, other): self._counted(other); return Number(float(self) / float(other))
    def __rtruediv__(self, other): self._counted(other); return Number(float(other) / float(self))
    __rmul__ = __mul__
    def __add__(self, other): return Number(float(self) + float(other))
    def __sub__(self, other): return Number(float(self) - float(other))
    def __rsub__(self, other): return Number(float(other) - float(self))
    def __neg__(self): return Number(-float(self))
    __radd__ = __add__

def numbers(array):
    out = np.empty(np.shape(array), dtype=object)
    for index in np.ndindex(out.shape):
        out[index] = Number(array[index])
    return out

class Numpy:
    inf, int64 = np.inf, np.int64
    copysign, hypot = staticmethod(np.copysign), staticmethod(np.hypot)
    def zeros(self, shape, dtype=None): return np.zeros(shape, dtype) if dtype else numbers(np.zeros(shape))
    def sqrt(self, value):
        global count
        count += 1
        return Number(np.sqrt(float(value)))
    def dot(self, a, b):
        global count
        count += a.shape[0] * a.shape[1] * b.shape[1]
        return numbers(np.dot(a.astype(float), b.astype(float)))

from notebooks.worstcase import time_updates as steps
from stillwork.base.algebra import factorise, minus_row, solve_backward
from stillwork.estimation import secular
from stillwork.estimation.covariance_forms import update_covariance
for module in (steps, secular):
    module.np = Numpy()

def least_squares(rows, outputs, weight, covariance, estimate):
    gain = numbers(np.zeros(len(estimate)))
    covariance = Typed(covariance)
    for row, output in zip(rows, outputs):
        error = minus_row(output, row[None], 0, estimate)
        share = error * update_covariance(covariance, row, weight, gain)[1]
        for i in range(len(estimate)):
            estimate[i] += gain[i] * share

def ridge(rows, outputs, penalty, weight, information, correlation, estimate):
    square, (pivots, half, work) = numbers(np.zeros(information.shape)), numbers(np.zeros((3, len(estimate))))
    for row, output in zip(rows, outputs):
        minus_row(output, row[None], 0, estimate)
        steps._accumulate_row(row, output, weight, information, correlation)
        factorise(information, penalty, correlation, square, pivots, half, work)
        solve_backward(square, pivots, half, estimate)

class Typed:
    # an array of numbers that count; its type makes them
    dtype = type("dtype", (), {"type": Number})
    def __init__(self, array): self.array = array
    def __getitem__(self, key): return self.array[key]
    def __setitem__(self, key, value): self.array[key] = value
    shape = property(lambda self: self.array.shape)
    def __len__(self): return len(self.array)

def counted(update, n):
    # Products and evaluations of a step.
    global count
    rng = np.random.default_rng(0)
    samples = 6 * n
    rows = rng.normal(size=(samples, n))
    outputs = rows @ rng.normal(size=n) + 0.3 * rng.normal(size=samples)
    out = [numbers(np.zeros((samples, n)))] + [numbers(np.zeros(samples)) for _ in range(3)]
    weight, bounds = Number(0.95), numbers(np.full(samples, 0.5))
    square, column = numbers(np.zeros((n, n))), [numbers(np.zeros(n)) for _ in range(3)]
    scalars = numbers(np.array([np.inf, 0.0, 0.0]))
    rows, outputs = numbers(rows), numbers(outputs)
    factored = [square, column[0], scalars, column[1], numbers(np.zeros((n, n))), column[2]]
    state = {
        "least squares": [numbers(1e4 * np.eye(n)), column[0]],
        "ridge": [square, column[0], column[1]],
        "exact": factored,
        "approximate": factored,
        "fast": [column[2], numbers(np.eye(n)), column[0], scalars, column[1]],
    }[update]
    run = {
        "least squares": lambda r, y, b, o: least_squares(r, y, weight, *state),
        "ridge": lambda r, y, b, o: ridge(r, y, Number(1.0), weight, *state),
        "exact": lambda r, y, b, o: steps.run_sums(r, y, b, weight, 0, *state, *o),
        "approximate": lambda r, y, b, o: steps.run_sums(r, y, b, weight, 2, *state, *o),
        "fast": lambda r, y, b, o: steps.run_fast(r, y, b, weight, *state, *o),
    }[update]
    half = samples // 2
    run(rows[:half], outputs[:half], bounds[:half], [a[:half] for a in out])
    count = 0
    run(rows[half:], outputs[half:], bounds[half:], [a[half:] for a in out])
    return count / half, float(sum(float(v) for v in out[3][half:])) / half

print(json.dumps([[counted(update, n) for n in UNKNOWNS] for update in UPDATES]))
"""

ACCURACY = {"least squares": 0.01, "ridge": 0.01, "approximate": 0.01, "exact": 0.02, "fast": 0.1}
UNKNOWNS = [4, 12]


@pytest.fixture(scope="module")
def counts():
    """Products and evaluations of a step by update and unknowns, of one process for all."""
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    wanted = json.dumps([list(ACCURACY), UNKNOWNS])
    done = subprocess.run(
        [sys.executable, "-c", COUNT, wanted], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return dict(zip(ACCURACY, json.loads(done.stdout), strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("place", range(len(UNKNOWNS)))
@pytest.mark.parametrize("update", ACCURACY)
def test_formulas_agree_with_a_count(update, place, counts):
    counted, evaluations = counts[update][place]
    formula = multiplications(update, UNKNOWNS[place], evaluations)
    assert formula == pytest.approx(counted, rel=ACCURACY[update])


def test_slope_of_a_power_law():
    assert slope([5, 10, 40], [2 * 5**2.5, 2 * 10**2.5, 2 * 40**2.5]) == pytest.approx(2.5)
