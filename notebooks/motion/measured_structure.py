"""Explorer of the measured structure (notebook 13)."""

from functools import cache

import numpy as np

from experiments.motion.machines import as_stage, measured_accelerance, published_noise, stage_mass
from experiments.motion.pictures import paint_bode
from stillwork.control.applications import Application
from stillwork.control.machine_loops import observed_loops
from stillwork.control.pid import PidFamily
from stillwork.identification.modal_fit import identify_modes
from stillwork.lti.modal import ModalModel, mirrored


@cache
def _fitted_structure() -> ModalModel:
    fit = identify_modes(measured_accelerance(1), (100.0, 3100.0))
    return as_stage(fit, stage_mass())[0]


def paint_structure(damping: float, noise_model: float):
    """Explorer: the mirrored sensor of the measured structure, bare and with MC and AD."""
    machine = [mirrored(_fitted_structure())]
    application = Application(compensate=True, damping=damping, selectivity=2.0)
    bare = observed_loops(machine, None, 5, published_noise(), None)[0]
    used = observed_loops(machine, application, 5, published_noise(), noise_model)[0]
    controller = PidFamily(stage_mass())(45.0)
    omega = used.omega[(used.omega > 2 * np.pi * 100) & (used.omega < 2 * np.pi * 3000)]
    curves = {
        "plant": (omega, bare.at(controller, omega).equivalent_plant),
        "with MC and AD": (omega, used.at(controller, omega).equivalent_plant),
    }
    return paint_bode(curves, "magnitude (dB re 1 m/N)", height=3.2)[0]
