"""Beside SLICOT, by python-control in a process of its own: with slycot on its path python-control uses other algorithms.

The library never needs it (GPL, 45 MB). `pip install --target build/slycot --no-deps slycot==0.7.1` brings it for these tests.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from stillwork import lti
from workbook import paths

FOLDER = paths.root() / "build/slycot"
THEIRS = """
import json, sys
import control as ct
assert ct.slycot_check()
for line in sys.stdin:
    system = ct.ss(*json.loads(line))
    kept = system.minreal(1e-8)
    print(json.dumps({
        "zeros": [[each.real, each.imag] for each in system.zeros()],
        "norm": ct.system_norm(system, "inf", method="slycot"),
        "two": ct.system_norm(ct.ss(system.A, system.B, system.C, 0 * system.D), 2, method="slycot"),
        "states": kept.nstates,
    }), flush=True)
"""


def drawn(seed: int) -> lti.StateModel:
    """A stable model of any shape, with a state that the inputs do not reach in every second one."""
    rng = np.random.default_rng(seed)
    n, m, p = (int(each) for each in rng.integers([2, 1, 1], [9, 4, 4]))
    a = rng.normal(size=(n, n))
    b, c = rng.normal(size=(n, m)), rng.normal(size=(p, n))
    if seed % 2:
        a[-1, :-1], b[-1] = 0.0, 0.0
        turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
        a, b, c = turn @ a @ turn.T, turn @ b, c @ turn.T
    a -= (np.linalg.eigvals(a).real.max() + rng.uniform(0.05, 1)) * np.eye(n)
    return lti.StateModel(a, b, c, rng.normal(size=(p, m)))


@pytest.mark.slow
@pytest.mark.skipif(not FOLDER.is_dir(), reason="build/slycot is not there")
def test_zeros_norms_and_minimal_models_are_those_of_slicot():
    models = [drawn(seed) for seed in range(60)]
    lines = "\n".join(json.dumps([getattr(each, name).tolist() for name in "abcd"]) for each in models)
    path = os.pathsep.join([str(FOLDER), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, "-c", THEIRS],
        input=lines,
        capture_output=True,
        text=True,
        timeout=120,  # sb10ad of SLICOT hangs for some plants
        env=os.environ | {"PYTHONPATH": path},
        check=True,
    )
    for model, line in zip(models, run.stdout.splitlines(), strict=True):
        theirs = json.loads(line)
        assert lti.hinf_norm(model).magnitude == pytest.approx(theirs["norm"], rel=1e-6)
        proper = lti.StateModel(model.a, model.b, model.c, 0 * model.d)
        assert lti.h2_norm(proper) == pytest.approx(theirs["two"], rel=1e-8)
        assert len(lti.minimal_realisation(model).model.a) == theirs["states"]
        ours, theirs = model.zeros, np.array([complex(*each) for each in theirs["zeros"]])
        for zero in theirs:
            assert np.abs(ours - zero).min() < 1e-6 * max(1.0, abs(zero))
        if len(ours) > len(theirs):  # SLICOT passes one over: there the pencil loses rank nevertheless
            assert max(lost_rank(model, zero) for zero in ours) < 1e-12


def lost_rank(model: lti.StateModel, zero: complex) -> float:
    """The singular value of the pencil at a zero that is not zero elsewhere."""
    n, (p, m) = len(model.a), model.d.shape
    pencil = np.block([[model.a - zero * np.eye(n), model.b], [model.c, model.d]])
    return float(np.linalg.svd(pencil, compute_uv=False)[n + min(p, m) - 1])
