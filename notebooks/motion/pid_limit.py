"""The limit of a PID controller: what notebook 05 alone needs, with its appendix."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from experiments.motion.designs import DESIGNS, stage_loops
from experiments.motion.machines import stage, stage_mass
from stillwork.control.bandwidth import Bandwidth, Loop, PeakConstraint, maximise_bandwidth
from stillwork.control.pid import Pid, PidFamily
from stillwork.lti.modal import ModalModel


def beyond_the_bound(
    loops: Sequence[Loop], controller: Pid, limit: float, resonances: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Where peaks of the input sensitivity exceed the limit (Hz), and whether all lie within 1 % of a resonance (rad/s)."""
    peaks = [loop.peak(controller, "input_sensitivity") for loop in loops]
    beyond = np.array([each.omega for each in peaks if each.magnitude > limit])
    near = np.abs(beyond[:, None] / resonances - 1).min(axis=1) < 0.01
    return beyond / (2 * np.pi), bool(len(near) and near.all())


def appendix(page, *, plant: ModalModel, best: Bandwidth, limit: float, stage_damping: float) -> None:
    """What this notebook judges beside its answer: Remark 3.3.1."""
    page.text("""
## Less stiffness, less damping

By Remark 3.3.1 less stiffness or damping limits the bandwidth more. The largest $f_{bw}$ (Hz):
""")
    weaker = {f"damping {share:g} times": stage(share * stage_damping) for share in (0.5, 0.2)}
    weaker |= {f"frequencies {share:g} times": plant.moved(share * plant.frequencies) for share in (0.9, 0.8)}
    family, constraint = PidFamily(stage_mass()), [PeakConstraint("input_sensitivity", limit)]
    lower = {
        name: maximise_bandwidth(stage_loops(DESIGNS["PID"], plant=each), family, constraint).design_hz
        for name, each in weaker.items()
    }
    page.show(pd.Series(lower).round(1))
    page.check("motion.remark-3-3-1.lower", float(np.mean(np.array([*lower.values()]) < best.design_hz)))
