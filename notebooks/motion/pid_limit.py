"""The limit of a PID controller: what notebook 05 alone needs, with its appendix."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from experiments.motion.designs import DESIGNS, stage_bandwidth, stage_loops
from experiments.motion.machines import stage, stage_mass
from stillwork.control.bandwidth import Bandwidth, Loop, PeakConstraint, maximise_bandwidth
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import Pid, PidFamily
from stillwork.lti.modal import ModalModel
from stillwork.lti.norms import hinf_norm
from workbook import figures


def beyond_the_bound(
    loops: Sequence[Loop], controller: Pid, limit: float, resonances: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Where peaks of the input sensitivity exceed the limit (Hz), and whether all lie within 1 % of a resonance (rad/s)."""
    peaks = [loop.peak(controller, "input_sensitivity") for loop in loops]
    beyond = np.array([each.omega for each in peaks if each.magnitude > limit])
    near = np.abs(beyond[:, None] / resonances - 1).min(axis=1) < 0.01
    return beyond / (2 * np.pi), bool(len(near) and near.all())


def appendix(
    page, *, plant: ModalModel, loops: Sequence[Loop], best: Bandwidth, limit: float, stage_damping: float
) -> None:
    """What this notebook judges beside its answer: Remark 3.3.1, peaks without a grid, and what a coarse grid misses."""
    page.text("## By mass")
    page.show("resonances (Hz)", np.round(plant.frequencies[1:] / (2 * np.pi), 1))
    page.show("first 0 dB crossing per mass (Hz)", np.round(best.crossing_hz, 2))
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
    _of_grids(page, loops, best, stage_damping)


def _of_grids(page, loops: Sequence[Loop], best: Bandwidth, stage_damping: float) -> None:
    page.text("""
## Peaks without a grid

The Hamiltonian matrix of the closed loop gives the same peaks without a frequency grid. A coarse logarithmic grid can miss a
lightly damped peak and overstate the bandwidth.
""")
    controller = best.controller.state_space()
    exact = [
        hinf_norm(channel(closed_loop(loop.plant, None, controller), "u_ff", "u")).magnitude for loop in loops
    ]
    refined = [loop.peak(best.controller, "input_sensitivity").magnitude for loop in loops]
    apart = np.max(np.abs(np.array(refined) / exact - 1))
    page.show(f"largest relative difference of the peaks below 1e-6: {bool(apart < 1e-6)}")
    sizes = [200, 300, 500, 700, 1000, 1500, 2000, 3000, 5000, 7000, 10000]
    grid = {"around": 0, "low_hz": 1.0, "high_hz": 1e4, "refine": False}
    coarse = [stage_bandwidth("PID", damping_ratio=stage_damping, points=n, **grid).design_hz for n in sizes]
    figure, axis = figures.new(1, 1, height=2.8)
    axis.semilogx(sizes, coarse, "o-", label="logarithmic grid, 1 Hz to 10 kHz")
    axis.axhline(best.design_hz, color=figures.BLACK, linestyle=":", linewidth=1, label="refined peaks")
    axis.set_xlabel("grid points")
    axis.set_ylabel("largest design parameter (Hz)")
    axis.legend()
    page.save("grid-trap", figure)
