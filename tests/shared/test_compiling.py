"""The command ``compile``: afterwards no call compiles anything, however long its record."""

import os
import subprocess
import sys

import pytest

LATER = """
import numpy as np
from numba.core.event import install_recorder
from stillwork import estimation as e

rng = np.random.default_rng(1)
X, psi, signal = rng.standard_normal((20_000, 5)), rng.standard_normal((9, 20_000)), rng.standard_normal(20_000)
calls = {
    "FeRLS": lambda: e.identify(e.FeRls(1e-2, 0.999), psi, rng.standard_normal((6, 20_000))),
    "FeRLS, single": lambda: e.identify(e.FeRls(1e-2, 0.99, dtype="float32"), psi, rng.standard_normal((6, 20_000))),
    "FeLMS": lambda: e.adapt(e.FeLms(), psi, signal[None]),
    "RLS": lambda: e.RecursiveLeastSquares(forgetting=0.99).fit(X, signal),
    "RLS, window": lambda: e.RecursiveLeastSquares(window=100).fit(X, signal),
    "min-max": lambda: e.MinMaxRegressor([0.1, 0.0, 0.1, 0.2, 0.3], forgetting=0.99).fit(X, signal),
    "LMS": lambda: e.LeastMeanSquares().fit(X, signal),
    "track": lambda: e.track(X.T, signal, 0.99, bound=0.3),
}
for name, call in calls.items():
    with install_recorder("numba:compile") as compiled:
        call()
    assert not compiled.buffer, (name, [each[1].data for each in compiled.buffer][:1])
"""


@pytest.mark.slow
def test_after_it_nothing_is_compiled(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    for command in (["-m", "stillwork", "compile"], ["-c", LATER]):
        done = subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
