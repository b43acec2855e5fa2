"""A measured structure as a stage: its shipped hammer records, and the fit with the mass of the stage."""

from dataclasses import replace

import numpy as np

from stillwork.identification.frequency_response import Identified, impact_response
from stillwork.identification.modal_fit import ModalFit
from stillwork.lti.modal import ModalModel
from workbook import paths


def measured_accelerance(padding: int = 4) -> Identified:
    """Acceleration over force of the structure (1/kg), counted positive along the force.

    The response has died out within each record, so zeros appended to it give a finer grid, not an
    interpolation.
    """
    file = paths.data("motion", "impact_frf_25k6/impact_hammer_5_hits.npz")  # see SOURCE.md beside it
    with np.load(file, allow_pickle=False) as records:
        force, response = (
            np.pad(hits, ((0, 0), (0, (padding - 1) * hits.shape[1])))
            for hits in (records["force_n"], records["accel_m_s2"])
        )
        # The accelerometer faces the hammer.
        return impact_response(force, -response, float(records["fs_hz"]))


def as_stage(fit: ModalFit, mass: float) -> tuple[ModalModel, float]:
    """The fitted structure with another total mass, and the factor on its response."""
    factor = 1 / (mass * float(fit.model.input_shapes[0, 0] * fit.model.output_shapes[0, 0]))
    model = fit.model
    shapes = {name: np.sqrt(factor) * getattr(model, name) for name in ("input_shapes", "output_shapes")}
    return replace(model, **shapes, feedthrough=factor * model.feedthrough), factor
