"""The toolbox's linear algebra beside python-control's, in one run: `make bench`, or `python benchmarks/python_control.py`.

Where slycot is on its path python-control uses it by itself. It is in no environment here (GPL, 45 MB, and it would change what
pages compute by python-control): `pip install --target build/slycot --no-deps slycot==0.7.1`, and the run is made twice.
"""

import os
import subprocess
import sys
from importlib.util import find_spec

import control as ct
import numpy as np

from benchmarks.timing import ROOT, in_turn, machine, ratio
from stillwork import lti


def stage(modes: int) -> lti.ModalModel:
    rng = np.random.default_rng(1)
    shapes = rng.uniform(0.3, 1, (2, modes))
    return lti.ModalModel(
        2 * np.pi * np.sort(rng.uniform(20, 900, modes)),
        np.full(modes, 0.01),
        shapes[0][:, None],
        shapes[1][None],
        [[0.0]],
    )


def main() -> None:
    ours = stage(6).state_space()
    theirs = ours.to_control()
    held, held_theirs = lti.zoh(ours, 1e-4), lti.zoh(ours, 1e-4).to_control()
    omega, record = 2 * np.pi * np.geomspace(1, 2000, 500), np.random.default_rng(2).normal(size=20_000)
    norm = lti.hinf_norm(ours).magnitude
    rows = {
        "response, 12 states, 500 frequencies": (
            lambda: lti.StateModel(ours.a, ours.b, ours.c, ours.d).frequency_response(omega),
            lambda: theirs(1j * omega),
        ),
        "simulation, 12 states, 20,000 samples": (
            lambda: lti.simulate(held, record[None]),
            lambda: ct.forced_response(held_theirs, inputs=record),
        ),
        "H-infinity norm, 12 states": (
            lambda: lti.hinf_norm(ours).magnitude,
            lambda: ct.system_norm(theirs, "inf"),
        ),
        "zero-order hold, 12 states": (
            lambda: lti.zoh(ours, 1e-4),
            lambda: ct.sample_system(theirs, 1e-4, "zoh"),
        ),
    }
    print(machine("scipy", "control"), "with slycot" if find_spec("slycot") else "without slycot", flush=True)
    for name, (one, other) in rows.items():
        times = in_turn({"stillwork": one, "python-control": other}, 9)
        print(
            f"{name:40s} {1e3 * np.median(times['stillwork']):9.3f} ms, python-control takes {ratio(times):7.1f} times as long"
        )
    print(
        f"{'H-infinity norms differ by':40s} {abs(ct.system_norm(theirs, 'inf') / norm - 1):.1e} of their size"
    )


if __name__ == "__main__":
    main()
    folder = ROOT / "build/slycot"
    if folder.is_dir() and not find_spec("slycot"):
        path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
        subprocess.run([sys.executable, __file__], env=os.environ | {"PYTHONPATH": path}, check=True)
