"""Linear time-invariant models: modal and state-space form, exact discretisation, fast responses, norms."""

from stillwork.lti.discretisation import zoh, zoh_modes
from stillwork.lti.modal import ModalModel, from_state_space, modal_model
from stillwork.lti.norms import h2_norm, hinf_norm
from stillwork.lti.peaks import Peak, refine_peak, resonance_grid
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel, from_control, interconnect

__all__ = [
    "ModalModel",
    "Peak",
    "StateModel",
    "from_control",
    "from_state_space",
    "h2_norm",
    "hinf_norm",
    "interconnect",
    "modal_model",
    "refine_peak",
    "resonance_grid",
    "simulate",
    "zoh",
    "zoh_modes",
]
