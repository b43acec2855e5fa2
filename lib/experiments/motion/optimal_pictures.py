"""Figures of the optimal observer."""

from collections.abc import Mapping
from functools import cache

import numpy as np

from experiments.motion.designs import DAMPING
from experiments.motion.machines import published_noise, stage, stage_mass
from experiments.motion.observer_problem import ObserverProblem
from experiments.motion.tradeoff import emphasised, sensitivity_weight, tipping_corner
from stillwork.control.loops import INPUTS, closed_loop
from stillwork.control.pid import PidFamily
from stillwork.estimation.generalised_plant import GeneralisedPlant
from stillwork.estimation.h2 import h2_riccati
from stillwork.estimation.observer import kalman_observer
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel
from stillwork.workbook import figures


def regularisation(problem: ObserverProblem, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Cost of the controls and noise of the measurements, both `size` in units of the loop.

    A metre of compensation costs like a metre of error, a velocity like the position it belongs to; a force
    is weighed against the controller's gain at the frequency where its phase lead is largest.
    """
    flexible = problem.plant.frequencies[problem.plant.rigid_modes :]
    effort = size * np.concatenate([[1.0], 1 / flexible])
    crossing = 3 * problem.controller.differentiator  # omega_bw of Table 3.3
    force = abs(problem.controller.frequency_response(np.array([crossing]))[0])
    reference = 2 * np.pi * problem.corners_hz[0]
    return effort, size * np.array([force, 1.0]) / np.sqrt(reference)


COLOURS = {"no observer": figures.GREY, "Kalman": figures.RED, "optimal": figures.GREEN}


def paint_responses(
    problem: ObserverProblem, observers: Mapping[str, StateModel], weight: StateModel | None = None
):
    """Sensitivity from r to e_true and equivalent controller from y to f of several observers."""
    omega = 2 * np.pi * np.geomspace(0.1, 2000, 1500)
    hertz = omega / (2 * np.pi)
    figure, (left, right) = figures.new(1, 2, height=3.2)
    for name, observer in observers.items():
        loop = closed_loop(
            problem.plant, problem.compensator(observer), problem.controller.state_space()
        ).frequency_response(omega)
        style = {"label": name, "color": COLOURS.get(name, figures.BLUE)}
        # Opened at the plant, f = C_y y: from d (added to y alone) the loop gives f = -C_y d / (1 + P C_y).
        to_force, to_output = loop[3, INPUTS.index("d")], loop[0, INPUTS.index("d")]
        left.semilogx(hertz, 20 * np.log10(np.abs(loop[0, INPUTS.index("r")])), **style)
        right.semilogx(hertz, 20 * np.log10(np.abs(to_force / (1 - to_output))), **style)
    if weight is not None:
        bound = 1 / np.abs(weight.frequency_response(omega)[0, 0])
        left.semilogx(hertz, 20 * np.log10(bound), color=figures.BLACK, linewidth=0.8, label="1 / $W_{sens}$")
    left.set_ylabel("$r$ to $e_{true}$ (dB)")
    right.set_ylabel("equivalent controller (dB re 1 N/m)")
    figures.label((left, right), "frequency (Hz)")
    left.legend()
    return figure


def published_problem() -> ObserverProblem:
    """The generalised plant at the published settings, scaled to the length of the move."""
    plant = truncate(stage().at([0], [4]), 4, 0)
    scales = (0.01 / 0.17, 1e-9 / 0.17, 1e-9 / 0.17)
    return ObserverProblem(plant, PidFamily(stage_mass())(83.0), DAMPING, 2.0, scales)


@cache
def _compared() -> tuple[ObserverProblem, GeneralisedPlant, StateModel, StateModel]:
    """The published problem, its generalised plant, the Kalman observer and the weight that it just keeps."""
    problem = published_problem()
    generalised = problem.generalised()
    kalman = problem.read(kalman_observer(problem.plant, published_noise(), 1e3))
    return problem, generalised, kalman, sensitivity_weight(tipping_corner(generalised.close(kalman)))


def paint_emphasis(emphasis: float):
    """Explorer: the loop on the front at one emphasis, beside the Kalman loop."""
    problem, generalised, kalman, weight = _compared()
    found = h2_riccati(emphasised(generalised, weight, emphasis), *regularisation(problem, 0.01))
    return paint_responses(problem, {"Kalman": kalman, f"emphasis {emphasis:.2g}": found.observer}, weight)
