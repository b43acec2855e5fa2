"""Damping in a decoupled machine: what this notebook alone needs."""

import numpy as np

from experiments.motion.designs import SIX, Design, stage_bandwidth
from experiments.motion.intervals import Values
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Infeasible

FACTORS, SELECTIVITY = (1.05, 1.1, 1.2, 1.5), 2.0  # on the frequencies; Q of the band-passes


def stiff_bandwidths(selectivity: float, **stage) -> tuple[float, list[float]]:
    """Achievable bandwidth (Hz) of the stage by PID alone, and with active stiffness by factor, without and with band-pass.

    `stage` goes to `stage_bandwidth`; 0 where none is feasible.
    """
    reached = []
    for factor in FACTORS:
        for filtered in (None, selectivity):
            try:
                stiff = Design(Application(stiffness=factor, selectivity=filtered))
                reached.append(float(stage_bandwidth(stiff, **stage).crossing_hz.mean()))
            except Infeasible:
                reached.append(0.0)
    return float(stage_bandwidth("PID", **stage).crossing_hz.mean()), reached


def stiffness_values(alone: float, reached: list[float]) -> Values:
    """Conclusion 3.4 as the ledger has it."""
    return {"motion.conclusion-3-4.stiffness-bandwidth": float(np.mean(np.array(reached) <= 1.1 * alone))}


def stiffness(*, stage_damping: float, six: str, seed: int) -> Values:
    """The same for another stage or limit; it has no fast variant."""
    return stiffness_values(*stiff_bandwidths(SELECTIVITY, damping_ratio=stage_damping, limit=SIX[six]))
