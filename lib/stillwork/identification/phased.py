"""A machine with non-proportional damping: each mode's part of the response has its own phase."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.delays import split_delay
from stillwork.lti.discretisation import late_modes
from stillwork.lti.modal import ModalModel


@by_value
@dataclass(frozen=True)
class PhasedModel:
    r"""Modes :math:`(b_1s + b_0)/(s^2 + 2\zeta\omega s + \omega^2)` beside a rigid body and a compliance.

    Attributes
    ----------
    model : ModalModel
        All but the :math:`b_1`, of one input and one output.
    velocity : ndarray, shape (modes,)
        :math:`b_1`, m/(N s); 0 of a rigid body.
    """

    model: ModalModel
    velocity: Float64[np.ndarray, " modes"]

    def __post_init__(self):
        check_fields(self)
        if self.velocity.shape != self.model.frequencies.shape:
            raise InputError(f"velocity must hold one number per mode, {len(self.model.frequencies)}")

    @property
    def degrees(self) -> Float64[np.ndarray, " modes"]:
        """Phase of each mode's part at its resonance, from -90 to 90 degrees off a decoupled one."""
        model = self.model
        gains = model.output_shapes[0] * model.input_shapes[:, 0]
        return np.degrees(np.arctan2(self.velocity * model.frequencies * np.sign(gains), np.abs(gains)))

    @checked
    def velocity_response(
        self, moved: ModalModel, velocity: np.ndarray, omega: np.ndarray, sample_time: float, delay: float
    ) -> Complex128[np.ndarray, " frequencies"]:
        """What velocity parts add to the response of a `moved` model, held and late by a delay in samples."""
        if not sample_time:
            w, z = moved.frequencies[:, None], moved.damping[:, None]
            return velocity @ (1j * omega / (w**2 - omega**2 + 2j * z * w * omega))
        unit = replace(moved, input_shapes=np.ones_like(moved.input_shapes))
        whole, late = split_delay(delay)
        held, old = late_modes(unit, sample_time, late)
        z = np.exp(1j * omega * sample_time)
        found = np.zeros(len(omega), complex)
        for k in np.flatnonzero(velocity):
            rows = slice(2 * k, 2 * k + 2)
            (a, b), (c, d) = held.a[rows, rows]
            into = held.b[rows, :1] + old[rows, :1] / z
            found += velocity[k] * ((z - a) * into[1] + c * into[0]) / ((z - a) * (z - d) - b * c)
        return found / z**whole
