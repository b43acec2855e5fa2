r"""Errors of modal parameters: draws, first-order derivatives of the sampled model, and a norm bound over them.

The parameters of a mode are its frequency, damping, input shape and output shape, each with a relative error
that is the same along the whole output shape (section 5.2.3 of the observer thesis).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.validation import checked
from stillwork.estimation.robust import Derivatives, NormBound
from stillwork.estimation.time_varying import TimeVaryingModel
from stillwork.lti.modal import ModalModel

LAWS = ("ends", "uniform", "normal", "common")


@checked
def perturbed(model: ModalModel, errors: ArrayLike) -> ModalModel:
    """The model with relative errors (modes, 4) of every mode's frequency, damping, input shape and output shape."""
    factors = 1 + np.asarray(errors, float)
    there = replace(
        model,
        damping=model.damping * factors[:, 1],
        input_shapes=model.input_shapes * factors[:, 2:3],
        output_shapes=model.output_shapes * factors[:, 3],
    )
    return there.moved(model.frequencies * factors[:, 0])


def detuned(model: ModalModel, errors: ArrayLike) -> ModalModel:
    """The model with its flexible frequencies off by these relative errors."""
    off = np.zeros((len(model.frequencies), 4))
    off[model.rigid_modes :, 0] = np.asarray(errors, float)
    return perturbed(model, off)


@checked
def sample_errors(
    rng: np.random.Generator, model: ModalModel, size: float, law: str = "ends", rigid: bool = False
) -> Float64[np.ndarray, "modes 4"]:
    """Random relative errors of every modal parameter, by one of four laws that "±5 %" may mean.

    At the ``ends``, plus or minus `size`; ``uniform`` between them; ``normal`` with `size` as standard deviation; or
    ``common``: at the ends, the same for all modes. The shapes of rigid-body modes are left alone unless `rigid`: a scale and a weighing of the machine settle them.
    """
    shape = (len(model.frequencies), 4)
    draws = {
        "ends": lambda: rng.choice([-1.0, 1.0], shape),
        "uniform": lambda: rng.uniform(-1, 1, shape),
        "normal": lambda: rng.standard_normal(shape),
        "common": lambda: np.tile(rng.choice([-1.0, 1.0], 4), (len(model.frequencies), 1)),
    }
    errors = size * draws[law]()
    if not rigid:
        errors[: model.rigid_modes] = 0
    return errors


@dataclass(frozen=True)
class SampledDerivatives:
    """Derivatives of the sampled A and B by the relative errors of chosen modes, all four parameters of each."""

    modes: tuple[int, ...]
    a: Float64[np.ndarray, "parameters states states"]
    b: Float64[np.ndarray, "parameters states inputs"]

    def along(self, model: TimeVaryingModel, shapes: ArrayLike) -> Derivatives:
        """Derivatives for the filters, with input noise (G = B) and these output shapes (samples, outputs, modes)."""
        shapes = np.asarray(shapes, float)
        c = np.zeros((len(shapes), len(self.a), shapes.shape[1], model.c.shape[2]))
        for k, mode in enumerate(self.modes):
            c[:, 4 * k + 3, :, 2 * mode] = shapes[:, :, mode]
        return Derivatives(self.a, self.b, self.b, c)


@checked
def sampled_derivatives(
    model: ModalModel, sample_time: float, modes: Sequence[int] | None = None
) -> SampledDerivatives:
    """Derivatives of the zero-order-hold model in modal form 1 for chosen modes (by default all flexible ones)."""
    modes = tuple(range(model.rigid_modes, len(model.frequencies)) if modes is None else modes)
    states, inputs = 2 * len(model.frequencies), model.input_shapes.shape[1]
    a, b = np.zeros((4 * len(modes), states, states)), np.zeros((4 * len(modes), states, inputs))
    for k, mode in enumerate(modes):
        w, z, shape = model.frequencies[mode], model.damping[mode], model.input_shapes[mode]
        whole = np.zeros((2 + inputs, 2 + inputs))
        whole[0, 1], whole[1, 0], whole[1, 1], whole[1, 2:] = 1, -(w**2), -2 * z * w, shape
        directions = np.zeros((3, *whole.shape))  # by frequency, damping and input shape
        directions[0, 1, :2] = -2 * w**2, -2 * z * w
        directions[1, 1, 1] = -2 * z * w
        directions[2, 1, 2:] = shape
        place = slice(2 * mode, 2 * mode + 2)
        for number, direction in enumerate(directions):
            moved = linalg.expm_frechet(whole * sample_time, direction * sample_time, compute_expm=False)
            a[4 * k + number, place, place] = moved[:2, :2]
            b[4 * k + number, place] = moved[:2, 2:]
    return SampledDerivatives(modes, a, b)


@checked
def norm_bound(model: TimeVaryingModel, derivatives: Derivatives, size: float) -> NormBound:
    r"""Norm bound that covers, to first order, all errors up to `size` in every parameter at once.

    With one output the error is a row :math:`\sum_i\epsilon_i s_i`; the rows of E are :math:`s_i` times
    `size` and the root of the number of parameters, so that the contraction is the ball around the cube. With
    several outputs each has its own direction M and the ball grows with their number.
    """
    s, t, m = derivatives.rows(model)
    samples, outputs = model.c.shape[:2]
    count = len(np.asarray(derivatives.a))

    def gather(rows):
        # The derivative of C A by a parameter is that of A through C and that of C through A, together.
        both = rows.reshape(samples, 2, count, outputs, -1).sum(axis=1)
        return size * np.sqrt(count * outputs) * both.reshape(samples, count * outputs, -1)

    return NormBound(np.tile(np.eye(outputs), (samples, 1, 1)), gather(s), gather(m), gather(t))
