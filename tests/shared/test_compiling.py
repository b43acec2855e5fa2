"""Kernels are compiled for all that a stream meets when it is made, and by the command ``compile`` for whole records.

No kernel takes on another signature later; its machine code may lie on disk already. In processes of their own.
"""

import subprocess
import sys

import pytest

SPECIALISED = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from stillwork import estimation
from stillwork.__main__ import main

def specialised():
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("stillwork.")]
    kernels = {each for module in modules for each in vars(module).values() if isinstance(each, Dispatcher)}
    return {(kernel.__name__, signature) for kernel in kernels for signature in kernel.overloads}

"""
STREAMS = """
rng = np.random.default_rng(1)
X, y = rng.standard_normal((2000, 3)), rng.standard_normal(2000)
X[300:600] = X[300]
X[900:1000] = np.nan
frozen = X.copy()
frozen.flags.writeable = False
makers = {
    "RLS": lambda: estimation.RecursiveLeastSquares(forgetting=0.99),
    "RLS, P": lambda: estimation.RecursiveLeastSquares(forgetting=0.99, initial_covariance=1.0),
    "RLS, window": lambda: estimation.RecursiveLeastSquares(window=50),
    "LMS": estimation.LeastMeanSquares,
    "min-max": lambda: estimation.MinMaxRegressor(0.3, forgetting=0.99),
    "min-max, known": lambda: estimation.MinMaxRegressor([0.3, 0.0, 0.1], "sample"),
    "FeLMS": lambda: estimation.AdaptationStepper(estimation.FeLms(0.1), np.zeros((2, 3))),
    "FeRLS": lambda: estimation.AdaptationStepper(estimation.FeRls(1.0), np.zeros((2, 3), order="F")),
    "FeRLS, UD": lambda: estimation.AdaptationStepper(estimation.FeRls(1.0, form="UD"), np.zeros((1, 3))),
    "FeRLS, float32": lambda: estimation.AdaptationStepper(
        estimation.FeRls(1.0, 0.999, dtype="float32"), np.zeros((1, 3))
    ),
}
for name, make in makers.items():
    made = make()
    before = specialised()
    assert before
    for k in range(2000):
        if hasattr(made, "partial_fit"):
            table = (frozen, X, np.asfortranarray(X[k : k + 2])[::2])[k % 3]
            made.partial_fit(table[k : k + 1] if k % 3 < 2 else table, y[k : k + 1])
        else:
            row = np.nan_to_num(X[k])
            made.update(row, made.weights @ row - y[k])
    assert specialised() == before, (name, specialised() - before)
"""
RECORDS = """
assert main(["compile"]) == 0
rng = np.random.default_rng(1)
X, psi, signal = rng.standard_normal((2000, 5)), rng.standard_normal((9, 2000)), rng.standard_normal(2000)
calls = {
    "FeRLS": lambda: estimation.identify(estimation.FeRls(1e-2, 0.999), psi, rng.standard_normal((6, 2000))),
    "FeRLS, single": lambda: estimation.identify(
        estimation.FeRls(1e-2, 0.99, dtype="float32"), psi, rng.standard_normal((6, 2000))
    ),
    "FeLMS": lambda: estimation.adapt(estimation.FeLms(), psi, signal[None]),
    "RLS": lambda: estimation.RecursiveLeastSquares(forgetting=0.99).fit(X, signal),
    "RLS, window": lambda: estimation.RecursiveLeastSquares(window=100).fit(X, signal),
    "min-max": lambda: estimation.MinMaxRegressor([0.1, 0.0, 0.1, 0.2, 0.3], forgetting=0.99).fit(X, signal),
    "LMS": lambda: estimation.LeastMeanSquares().fit(X, signal),
    "track": lambda: estimation.track(X.T, signal, 0.99, bound=0.3),
}
before = specialised()
for name, call in calls.items():
    call()
    assert specialised() == before, (name, specialised() - before)
"""


@pytest.mark.slow
@pytest.mark.parametrize("later", [STREAMS, RECORDS], ids=["streams", "records"])
def test_nothing_is_compiled_later(later):
    done = subprocess.run([sys.executable, "-c", SPECIALISED + later], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
