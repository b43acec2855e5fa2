"""A measured structure as a stage: its hammer records, and the fit with the mass of the stage."""

from dataclasses import replace

import numpy as np

from stillwork.base import paths
from stillwork.base.checks import require_number
from stillwork.identification.frequency_response import Identified, impact_response
from stillwork.identification.modal_fit import ModalFit
from stillwork.lti.modal import ModalModel


def hammer_records() -> dict[str, np.ndarray]:
    """The shipped records: ``force_n`` and ``accel_m_s2`` (hits, samples) and ``fs_hz``; see SOURCE.md beside them."""
    file = paths.data("motion", "impact_frf_25k6/impact_hammer_5_hits.npz")
    with np.load(file, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive}


def measured_accelerance(padding: int = 4) -> Identified:
    """Acceleration over force of the structure (1/kg), counted positive along the force.

    The response has died out within each record, so zeros appended to it give a finer grid, not an
    interpolation.
    """
    records = hammer_records()
    force, response = (
        np.pad(records[name], ((0, 0), (0, (padding - 1) * records[name].shape[1])))
        for name in ("force_n", "accel_m_s2")
    )
    return impact_response(force, -response, float(records["fs_hz"]))  # the accelerometer faces the hammer


def as_stage(fit: ModalFit, mass: float) -> tuple[ModalModel, float]:
    """The fitted structure with another total mass, and the factor on its response."""
    require_number("mass", mass, above=0.0)
    factor = 1 / (mass * float(fit.model.input_shapes[0, 0] * fit.model.output_shapes[0, 0]))
    root = np.sqrt(factor)
    model = fit.model
    shapes = {name: root * getattr(model, name) for name in ("input_shapes", "output_shapes")}
    return replace(model, **shapes, feedthrough=factor * model.feedthrough), factor
