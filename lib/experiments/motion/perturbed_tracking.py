"""Tracking under the published designs: with noise (Table 3.7), and of perturbed plants (Table 5.2)."""

from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from experiments.motion.designs import DESIGNS, stage_bandwidth, stage_compensator
from experiments.motion.machines import published_deviations, published_setpoint, stage
from experiments.motion.uncertainty import perturbed, sample_errors
from stillwork.base.validation import checked
from stillwork.control.feedforward import (
    Feedforward,
    error_loop,
    fit_feedforward,
    noise_error,
    tracking_error,
)
from stillwork.control.loops import channel, closed_loop
from stillwork.control.setpoint import Setpoint
from stillwork.lti.discretisation import zoh
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel
from stillwork.signals.moving_average import rms

MEASURED = 5  # y5, section 3.1
WARM_UP = 3000  # samples in which the noise reaches its steady state
APPLICATIONS = ("MC", "AD", "MC and AD")
# Row and column of Table 5.2, the observer's design and the design that its controller is taken from.
CASES = {"none": ("PID", "PID")}
CASES |= {name: (name, "PID") for name in APPLICATIONS}
CASES |= {f"{name}, redesigned": (name, name) for name in APPLICATIONS}

Blocks = Mapping[str, tuple[StateModel | None, StateModel]]  # compensator and controller of each case

_setpoint = cache(published_setpoint)  # every trial needs it, and the nominal stage


@cache
def _nominal() -> ModalModel:
    """The observers' model of the stage, from the force to y5."""
    return stage().at([0], [MEASURED - 1])


@cache
def published_blocks() -> Blocks:
    """The designs of Table 3.5: the largest bandwidth that each application allows on the nominal stage."""
    controllers = {name: stage_bandwidth(name).controller.state_space() for name in ("PID", *APPLICATIONS)}
    return {
        case: (stage_compensator(MEASURED, DESIGNS[observer]), controllers[controller])
        for case, (observer, controller) in CASES.items()
    }


@checked(infinite=True)
def tracking_trial(
    rng: np.random.Generator,
    blocks: Blocks,
    size: float,
    law: str = "ends",
    rigid: bool = True,
    retune: bool = True,
    sample_time: float = 1e-4,
) -> dict[str, float]:
    """Rms of the true error in the scanning phase (m) of every case, on one perturbed plant and one draw of the noise.

    With `retune` the feedforward is fitted to the perturbed plant without observer, as the data-based tuning would;
    else it keeps the gains of the nominal plant. The noise is white from sample to sample and held between them.
    """
    setpoint = _setpoint(sample_time)
    nominal = _nominal()
    plant = perturbed(nominal, sample_errors(rng, nominal, size, law, rigid))
    sizes = np.array([*published_deviations().values()])[:, None]
    noise = rng.standard_normal((3, setpoint.derivatives.shape[1])) * sizes
    if size:
        answers = _answers(plant, blocks, retune, sample_time)
    else:  # every run of a study has this plant
        key = (sample_time, *((case, *map(id, designs)) for case, designs in blocks.items()))
        if key not in _exact:
            _exact[key] = blocks, _answers(plant, blocks, retune, sample_time)
        answers = _exact[key][1]
    return {
        case: np.inf
        if answer is None
        else rms((answer.error + simulate(answer.noise, noise)[0])[setpoint.scanning])
        for case, answer in answers.items()
    }


class _Answer(NamedTuple):
    """Response of a stable loop, independent of the noise."""

    error: Float64[np.ndarray, " samples"]  # m, on the setpoint
    noise: StateModel  # sampled, from the noises to the error


# Of the exact plant, by the sample time and the designs, which are kept beside: who are gone could leave their `id`.
_exact: dict[tuple, tuple[Blocks, dict[str, _Answer | None]]] = {}


def _answers(
    plant: ModalModel, blocks: Blocks, retune: bool, sample_time: float
) -> dict[str, _Answer | None]:
    """Of every case; None where its loop is unstable."""
    setpoint, deviations = _setpoint(sample_time), list(published_deviations())
    feedforward: Feedforward | None = None
    found: dict[str, _Answer | None] = {}
    # The first case has no observer: its loop is the one that is tuned.
    for case, (block, controller) in blocks.items():
        loop = closed_loop(plant, block, controller)
        if not loop.is_stable:
            found[case] = None
            continue
        if feedforward is None:
            tuned_on = plant if retune else _nominal()
            feedforward = fit_feedforward(error_loop(closed_loop(tuned_on, None, controller)), setpoint)
        error = tracking_error(error_loop(loop), setpoint, feedforward)
        found[case] = _Answer(error, zoh(channel(loop, deviations, "e_true"), sample_time))
    return found


def noisy_scan_trial(
    rng: np.random.Generator,
    loops: dict[str, StateModel],
    setpoint: Setpoint,
    feedforward: Feedforward | Mapping[str, Feedforward],
    deviations: dict[str, float],
) -> dict[str, float]:
    """Rms of the true error in the scan (m) of several loops with modified feedforward under one noise realisation.

    The feedforward is one for all, or each loop's own.
    """
    seed = rng.integers(2**63)  # every loop meets the same noise
    samples = WARM_UP + setpoint.derivatives.shape[1]
    found = {}
    for name, loop in loops.items():
        draws = np.random.default_rng(seed)
        noise = noise_error(loop, setpoint.sample_time, samples, deviations, draws)[0, WARM_UP:]
        own = feedforward if isinstance(feedforward, Feedforward) else feedforward[name]
        error = tracking_error(error_loop(loop), setpoint, own) + noise
        found[name] = rms(error[setpoint.scanning])
    return found
