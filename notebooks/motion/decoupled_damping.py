"""Damping in a decoupled machine: what this notebook alone needs."""

from collections.abc import Mapping

import numpy as np
from scipy import linalg

from experiments.motion.decoupling_schemes import Settings, off_diagonal_peak, sample_beam, scheme_gain
from experiments.motion.designs import SIX, Design, stage_bandwidth
from experiments.motion.intervals import Values
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Infeasible
from stillwork.control.decoupling import decouple, decoupled_plant
from stillwork.lti.state_space import StateModel


def minimal_order(gain: StateModel) -> int:
    """Order of a minimal realisation of a stable model, by the rank of its Hankel operator."""
    rate = np.abs(gain.poles).max()
    a = gain.a / rate
    # Of unit size: the rank is judged against rounding.
    b, c = (matrix / np.linalg.norm(matrix) for matrix in (gain.b, gain.c))
    reach = linalg.solve_continuous_lyapunov(a, -b @ b.T)
    seen = linalg.solve_continuous_lyapunov(a.T, -c.T @ c)
    hankel = np.sqrt(np.maximum(linalg.eigvals(reach @ seen).real, 0))
    return int(np.count_nonzero(hankel > 1e-6 * hankel.max()))


def kept_out_trial(rng: np.random.Generator, settings: Settings) -> Mapping[str, np.ndarray]:
    """Over-actuation on one machine when the actuators decouple the first or the second flexible mode too.

    ``peaks``, shape (decoupled mode, damped mode): the largest off-diagonal entry around each damped mode over the
    undamped one.
    """
    machine = sample_beam(rng)
    rigid = machine.rigid_modes
    plant = machine.at(range(rigid + 1), range(rigid))
    gain = scheme_gain("over-actuation", plant, settings)
    damped = range(rigid, rigid + settings.damped)
    peaks = []
    for mode in damped:
        decoupling = decouple(plant, (*range(rigid), mode))
        system, bare = (decoupled_plant(plant, decoupling, part * gain) for part in (1, 0))
        frequencies = plant.frequencies[list(damped)]
        peaks.append([off_diagonal_peak(system, w) / off_diagonal_peak(bare, w) for w in frequencies])
    return {"peaks": np.array(peaks)}


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
