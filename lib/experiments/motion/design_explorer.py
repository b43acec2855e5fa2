"""Explorer of the stage's bandwidth: one controller and one use of the observer."""

from functools import lru_cache

import numpy as np

from experiments.motion.designs import DESIGNS, RETAINED, Design, stage_bandwidth, stage_loops
from experiments.motion.legends import LABELS
from experiments.motion.loop_functions import paint_over_masses
from experiments.motion.machines import stage, stage_mass
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Loop
from stillwork.control.pid import Pid, PidFamily


@lru_cache(maxsize=8)
def _loops(design: Design) -> list[Loop]:
    """Loops of the seven masses: they stay while the bandwidth alone moves."""
    return stage_loops(design, points=250, around=8)


def paint_design(
    bandwidth_hz: float,
    damping: float = 0.0,
    selectivity: float = 2.0,
    compensate: str = "no",
    noise_model: float = 0.03,
):
    """Explorer: S_I and S_O of the seven loops for one controller and one use of the observer."""
    used = damping > 0 or compensate == "yes"
    application = Application(compensate == "yes", damping, selectivity=selectivity) if used else None
    names = ("input_sensitivity", "output_sensitivity")
    return _paint(Design(application, noise_model), PidFamily(stage_mass())(bandwidth_hz), names)


@lru_cache(maxsize=8)
def _limit_hz(design: str) -> float:
    return stage_bandwidth(design).design_hz


def paint_published(design: str, part: float):
    """Explorer: the seven loops of a published design at a part (%) of the largest bandwidth that it allows."""
    notches = tuple(stage().frequencies[1:RETAINED]) if DESIGNS[design].notches else ()
    controller = PidFamily(stage_mass(), notches)(part / 100 * _limit_hz(design))
    return _paint(DESIGNS[design], controller, ("input_sensitivity", "output_sensitivity", "true_tracking"))


def _paint(design: Design, controller: Pid, names: tuple[str, ...]):
    """Loop functions of the seven masses, with the highest peak of each."""
    loops = _loops(design)
    figure = paint_over_masses({LABELS[name]: (loops, controller, name) for name in names})
    peaks = [max(loop.peak(controller, name).magnitude for loop in loops) for name in names]
    stable = all(loop.is_stable(controller) for loop in loops)
    for axis, peak in zip(figure.axes, peaks, strict=True):
        verdict = f"peak {20 * np.log10(peak):.1f} dB" if stable else "unstable"
        axis.set_title(f"{axis.get_title(loc='left')}: {verdict}")
    return figure
