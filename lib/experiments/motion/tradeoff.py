"""H2 against H-infinity: the sensitivity weight of Fig. 5.6, and verified points on the trade-off of Fig. 5.7.

The mixed matrix inequalities (`matrix_inequalities.mixed_lmi`) use one Lyapunov matrix for both norms, take a solver
seconds a point and often fail. Here the weighted error is one more output of the H2 problem instead, with an emphasis
that moves along the front; what counts are the norms of the loops.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from stillwork.base.checks import InputError, require_array, require_number
from stillwork.control.bandwidth import SIX_DB
from stillwork.control.pid import series
from stillwork.estimation.generalised_plant import GeneralisedPlant
from stillwork.estimation.h2 import Synthesis, h2_riccati
from stillwork.lti.norms import h2_norm, hinf_norm
from stillwork.lti.state_space import StateModel, interconnect


def sensitivity_weight(corner_hz: float, floor: float = 0.02) -> StateModel:
    """Weight with slope -3 below the corner and the inverse of 6 dB above: 1 over a wanted sensitivity.

    Below `floor` of the corner it stays constant: a pure integrator would make every norm infinite.
    """
    w = 2 * np.pi * require_number("corner_hz", corner_hz, above=0.0)
    floor = require_number("floor", floor, above=0.0, below=1.0)
    slope = StateModel(
        np.array([[-floor * w]]), np.array([[w * (1 - floor)]]), np.array([[1.0]]), np.array([[1.0]])
    )
    whole = series([slope] * 3)
    return StateModel(whole.a, whole.b, whole.c / SIX_DB, whole.d / SIX_DB)


def weighted_peak(loop: StateModel, weight: StateModel) -> float:
    """H-infinity norm of the weighted transfer from r to e_true, the first input and output of `loop`.

    The other inputs stay out: no observer makes the sensor noise d smaller than the weight at low frequencies
    wants, since the loop must follow what it measures.
    """
    chain = series([loop.select([0], [0]), weight])
    return hinf_norm(chain).magnitude


def tipping_corner(loop: StateModel) -> float:
    """Corner (1 to 60 Hz) of the weight at which this loop just keeps a weighted peak of 1."""

    def excess(corner_hz: float) -> float:
        return weighted_peak(loop, sensitivity_weight(corner_hz)) - 1

    if excess(1.0) * excess(60.0) > 0:
        raise InputError("the loop keeps or breaks the weight at every corner from 1 to 60 Hz")
    return float(optimize.brentq(excess, 1.0, 60.0, xtol=1e-9))


def emphasised(plant: GeneralisedPlant, weight: StateModel, emphasis: float) -> GeneralisedPlant:
    """The plant with `emphasis` times the weighted error as a second performance output."""
    if plant.performance != 1:
        raise InputError(f"plant has {plant.performance} performance outputs; the trade-off is for one")
    outputs, inputs = plant.model.d.shape
    feedback, external = np.zeros((inputs + 1, outputs + 1)), np.eye(inputs + 1, inputs)
    feedback[inputs, 0] = 1
    read = np.zeros((outputs + 1, outputs + 1))
    read[0, 0], read[1, outputs] = 1, emphasis
    read[2:, 1:outputs] = np.eye(outputs - 1)
    model = interconnect([plant.model, weight], feedback, external, read)
    return GeneralisedPlant(model, plant.exogenous, 2)


@dataclass(frozen=True)
class FrontPoint:
    """One verified loop on the trade-off."""

    emphasis: float
    synthesis: Synthesis
    h2: float  # of the loop as posed
    weighted_peak: float  # H-infinity norm of the weighted error


def front(
    plant: GeneralisedPlant,
    weight: StateModel,
    emphases: ArrayLike,
    effort: float | ArrayLike,
    noise: float | ArrayLike,
) -> list[FrontPoint]:
    """Loops that trade the H2 norm for the weighted peak; every norm is taken on the loop itself."""
    points = []
    for emphasis in require_array("emphases", emphases, ndim=1):
        found = h2_riccati(emphasised(plant, weight, float(emphasis)), effort, noise)
        loop = plant.close(found.observer)
        points.append(FrontPoint(float(emphasis), found, h2_norm(loop), weighted_peak(loop, weight)))
    return points
