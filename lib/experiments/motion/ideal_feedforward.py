r"""The force that would track a setpoint without error, and what a real feedforward leaves of it (section 4.2.5)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.lti.modal import ModalModel

# Relative error of the partial fractions above which they are refused; they leave about 1e-12.
WORST_ERROR = 1e-8
FAINT = 1e-12  # what is left of a zero's motion where it is cut off


@dataclass(frozen=True)
class Inverse:
    r"""Partial fractions of :math:`1/(s^2P(s)) = \sum_i d_is^i + \sum_j e_j/(s - z_j)`, from acceleration to force."""

    polynomial: Float64[np.ndarray, "3"]  # d, kg s^i
    zeros: Complex128[np.ndarray, " zeros"]  # z of the plant, rad/s
    residues: Complex128[np.ndarray, " zeros"]  # e, kg rad/s

    @property
    def lead(self) -> float:
        """Time (s) before the move in which the force must begin: required by zeros in the right half-plane."""
        right = self.zeros.real[self.zeros.real > 0]
        return float(-np.log(FAINT) / right.min()) if len(right) else 0.0


@checked
def invert(plant: ModalModel) -> Inverse:
    """Inverse of a machine with one rigid-body mode, one input and one position output.

    A zero on the imaginary axis is refused (its force would ring for ever), and an inverse that differentiates the
    snap.
    """
    w, z = plant.frequencies, plant.damping
    residues = plant.output_shapes[0] * plant.input_shapes[:, 0]

    def below(s):
        return s[:, None] * (s[:, None] + 2 * z * w) + w**2

    def response(s):
        return (residues / below(s)).sum(axis=1) + plant.feedthrough[0, 0]

    def slope(s):
        return -(residues * 2 * (s[:, None] + z * w) / below(s) ** 2).sum(axis=1)

    zeros = plant.state_space().zeros
    for _ in range(3):  # what the eigenvalues of the pencil left
        zeros = zeros - response(zeros) / slope(zeros)
    if np.any(np.abs(zeros.real) < 1e-9 * np.abs(zeros)):
        raise InputError("plant has a zero on the imaginary axis; give its modes some damping")
    parts = 1 / (slope(zeros) * zeros**2)
    scale = np.abs(zeros).max() if len(zeros) else w[-1]
    s = 1j * scale * np.geomspace(1e-3, 3, 200)
    wanted = 1 / (s**2 * response(s))
    rest = wanted - (parts / (s[:, None] - zeros)).sum(axis=1)
    powers = (s[:, None] / scale) ** np.arange(3) / np.abs(wanted)[:, None]
    stacked, goal = (np.concatenate([each.real, each.imag]) for each in (powers, rest / np.abs(wanted)))
    found, *_ = np.linalg.lstsq(np.asarray_chkfinite(stacked), np.asarray_chkfinite(goal), rcond=None)
    error = np.abs(stacked @ found - goal).max()
    if error > WORST_ERROR:
        raise InputError(
            f"plant has an inverse that differentiates the snap (error {error:.1e}); use fewer modes or a "
            "smoother setpoint"
        )
    return Inverse(found / scale ** np.arange(3), zeros, parts)
