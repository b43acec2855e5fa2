"""Norms and synthesis beside named peers, measured in one run: `make bench`.

Processor time, medians over repeats in turn, as in `motion.py`. The peers are python-control's norms and, where slycot is
installed, its `h2syn`; without it a textbook synthesis by scipy's Riccati solver. Every peer
must give the same number first. No test asserts a time.
"""

import os
import sys
import warnings
from pathlib import Path

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "lib"), str(ROOT)]

import control  # noqa: E402
import numpy as np  # noqa: E402
from scipy import linalg  # noqa: E402

from benchmarks.timing import in_turn, machine, ratio  # noqa: E402
from stillwork.estimation import h2_riccati  # noqa: E402
from stillwork.lti import GeneralisedPlant, StateModel, h2_norm, hinf_norm  # noqa: E402

STATES = 16


def main() -> None:
    warnings.simplefilter("ignore")  # python-control without slycot warns at every call
    print(
        f"{machine('control')}, slycot: {'yes' if has_slycot() else 'no'}; one thread; processor time, median\n"
    )
    rng = np.random.default_rng(1)
    plant = generalised(rng)
    loop = plant.close(h2_riccati(plant).controller)
    peer_loop = loop.to_control()
    pairs = {
        "h2_norm, beside control.norm": (lambda: h2_norm(loop), lambda: control.norm(peer_loop, 2)),
        "hinf_norm, beside control.norm": (
            lambda: hinf_norm(loop).magnitude,
            lambda: control.norm(peer_loop, "inf"),
        ),
        f"h2_riccati, beside {'control.h2syn' if has_slycot() else 'scipy'}": (
            lambda: h2_riccati(plant).norm,
            lambda: peer_h2(plant),
        ),
    }
    for name, (ours, theirs) in pairs.items():
        np.testing.assert_allclose(ours(), theirs(), rtol=2e-3)
        times = in_turn({"ours": ours, "peer": theirs}, 7)
        mine = 1e3 * np.median(times["ours"])
        print(f"  {name:50s} {mine:9.3f} ms   peer over ours {ratio(times):8.3g}")


def has_slycot() -> bool:
    return control.exception.slycot_check()


def generalised(rng: np.random.Generator) -> GeneralisedPlant:
    """A random plant with two controls and two measurements, each with a cost and a noise of its own."""
    a = rng.normal(size=(STATES, STATES)) / np.sqrt(STATES)
    a -= (0.2 + np.linalg.eigvals(a).real.max()) * np.eye(
        STATES
    )  # of unstable ones the peer's norm is far off
    b, c = rng.normal(size=(STATES, 6)), rng.normal(size=(6, STATES))
    b[:, 2:4], c[2:4] = 0.0, 0.0
    d = np.zeros((6, 6))
    d[2:4, 4:], d[4:, 2:4] = np.eye(2), np.eye(2)
    return GeneralisedPlant(StateModel(a, b, c, d), exogenous=4, performance=4)


def peer_h2(plant: GeneralisedPlant) -> float:
    a, b1, b2, c1, c2, *_ = plant.blocks
    if has_slycot():
        return control.norm(
            plant.close(from_control(control.h2syn(plant.model.to_control(), 2, 2))).to_control(), 2
        )
    x = linalg.solve_continuous_are(a, b2, c1.T @ c1, np.eye(2))
    y = linalg.solve_continuous_are(a.T, c2.T, b1 @ b1.T, np.eye(2))
    f, gain = -b2.T @ x, y @ c2.T
    controller = StateModel(a + b2 @ f - gain @ c2, gain, f, np.zeros((2, 2)))
    return control.norm(plant.close(controller).to_control(), 2)


def from_control(system) -> StateModel:
    return StateModel(*(np.asarray(each, float) for each in (system.A, system.B, system.C, system.D)))


if __name__ == "__main__":
    main()
