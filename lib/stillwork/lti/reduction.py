"""Model reduction by modal truncation, with the compliance of what was left out (section 2.2)."""

from dataclasses import replace

import numpy as np

from stillwork.base.bounds import Count, Natural, Positive
from stillwork.base.checks import InputError, pluralise
from stillwork.base.validation import checked
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, interconnect


@checked
def truncate(model: ModalModel, modes: Count, compensated: Natural = 0) -> ModalModel:
    """Keep the first `modes` modes and add the compliance of the next `compensated` as feedthrough, (2.14).

    Parameters
    ----------
    model : ModalModel
    modes : int
        Retained modes, rigid-body modes included.
    compensated : int
        How many of the discarded modes the compliance T_DC (2.13) covers.

    Returns
    -------
    ModalModel
        Of `modes` modes, with the compliance of those left out.

    Raises
    ------
    InputError
        When the model has fewer modes, or a rigid-body mode would be discarded.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (2.14).

    Examples
    --------
    >>> model = lti.ModalModel([0.0, 2000.0], [0.0, 0.01], [[0.3], [0.2]], [[0.3, 0.2]], [[0.0]])
    >>> lti.truncate(model, modes=1, compensated=1).feedthrough  # 0.2 0.2 / 2000^2 m/N
    array([[1.e-08]])
    """
    if modes + compensated > len(model.frequencies):
        raise InputError(
            f"modes + compensated is {modes + compensated}; the model has {pluralise(len(model.frequencies), 'mode')}"
        )
    if modes < model.rigid_modes:
        raise InputError(f"modes is {modes}; keep at least the {model.rigid_modes} rigid-body modes")
    left_out = model.modes(slice(modes, modes + compensated))
    return replace(model.modes(slice(0, modes)), feedthrough=model.feedthrough + left_out.compliance())


@checked
def roll_off(model: ModalModel, cutoff_hz: Positive) -> StateModel:
    """Strictly proper variant: the compliance feedthrough passes a first-order low-pass at `cutoff_hz`."""
    w = 2 * np.pi * cutoff_hz
    outputs, inputs = model.feedthrough.shape
    modal = replace(model, feedthrough=np.zeros((outputs, inputs))).state_space()
    compliance = StateModel(
        -w * np.eye(inputs), w * np.eye(inputs), model.feedthrough, np.zeros((outputs, inputs))
    )
    return interconnect(
        [modal, compliance],
        np.zeros((2 * inputs, 2 * outputs)),
        np.vstack([np.eye(inputs)] * 2),
        np.hstack([np.eye(outputs)] * 2),
    )
