"""Static decoupling of the rigid-body modes, and the effect of state feedback on it (section 4.3)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from stillwork.base.checks import InputError, pluralise
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.estimation.observer import Observer
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, block_matrix, constant, interconnect

# Above this condition of mode shapes at actuators or sensors, a decoupling loses half of the digits.
WORST_CONDITION = 1e8
# What such an inverse times its shapes may differ from the unit matrix: rounding times that condition, with a margin.
ROUNDING = 1e-6


@by_value
@dataclass(frozen=True)
class Decoupling:
    r"""Matrices of :math:`f = \Gamma u,\; q = \Upsilon y`, one u and one q a rigid-body mode (Fig. 4.12)."""

    actuation: Float64[np.ndarray, "inputs axes"]  # Gamma
    sensing: Float64[np.ndarray, "axes outputs"]  # Upsilon

    def __post_init__(self):
        check_fields(self)

    @checked
    def apply(self, model: ModalModel) -> ModalModel:
        r"""The modal model from u to q; its shapes of the flexible modes are Theta and Psi of (4.13).

        On the rigid-body modes they are unit matrices if actuators and sensors are where the design assumes, and
        set to them exactly: their rounding would grow as 1/s^2. Elsewhere they are the remaining decoupling.

        Parameters
        ----------
        model : ModalModel
            The machine, from its actuators to its sensors.

        Returns
        -------
        ModalModel
            As many inputs and outputs as modes that are decoupled.

        Raises
        ------
        InputError
            When its number of actuators or sensors differs.

        Examples
        --------
        >>> shapes = np.array([[0.3, 0.3], [0.5, -0.5]])  # translation and rotation, at two actuators
        >>> beam = lti.ModalModel([0.0, 0.0], [0.0, 0.0], shapes, shapes.T, np.zeros((2, 2)))
        >>> control.decouple(beam).apply(beam).input_shapes
        array([[1., 0.],
               [0., 1.]])
        """
        outputs, inputs = model.feedthrough.shape
        if (outputs, inputs) != (self.sensing.shape[1], len(self.actuation)):
            raise InputError(
                f"model has {pluralise(inputs, 'input')} and {pluralise(outputs, 'output')}; this decoupling is for {len(self.actuation)} "
                f"and {self.sensing.shape[1]}"
            )
        rigid = model.rigid_modes
        input_shapes, output_shapes = model.input_shapes @ self.actuation, self.sensing @ model.output_shapes
        for block in (input_shapes[:rigid], output_shapes[:, :rigid]):
            if np.abs(block - np.eye(rigid)).max() < ROUNDING:
                block[...] = np.eye(rigid)
        feedthrough = self.sensing @ model.feedthrough @ self.actuation
        return replace(model, input_shapes=input_shapes, output_shapes=output_shapes, feedthrough=feedthrough)


@checked
def decouple(
    model: ModalModel, actuated: Sequence[int] | None = None, sensed: Sequence[int] | None = None
) -> Decoupling:
    r"""Decoupling of the rigid-body modes, (4.12), and of flexible modes from them.

    :math:`\Phi_a\Gamma` is the unit matrix on the rigid-body modes and zero on the other modes that are kept
    apart; :math:`\Upsilon\Phi_s` likewise. With more actuators or sensors than such modes, the matrices of
    least norm.

    Parameters
    ----------
    model : ModalModel
    actuated, sensed : sequence of int, optional
        Modes that inputs and outputs separate, counted from 0, the rigid-body modes among them; by
        default the first ones, as many as there are actuators and sensors.

    Returns
    -------
    Decoupling
        The matrices Gamma and Upsilon before the actuators and behind the sensors.

    Raises
    ------
    InputError
        When there are fewer actuators or sensors than modes to separate, or their places do not separate these
        modes.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), section 4.3.

    Examples
    --------
    >>> shapes = np.array([[0.3, 0.3], [0.5, -0.5]])  # translation and rotation, at two actuators
    >>> beam = lti.ModalModel([0.0, 0.0], [0.0, 0.0], shapes, shapes.T, np.zeros((2, 2)))
    >>> np.allclose(shapes @ control.decouple(beam).actuation, np.eye(2))
    True
    """
    rigid, modes = model.rigid_modes, len(model.frequencies)
    if not rigid:
        raise InputError("model has no rigid-body modes; there is nothing to decouple")
    sides = (
        ("actuated", actuated, model.input_shapes.T, "actuators"),
        ("sensed", sensed, model.output_shapes, "sensors"),
    )
    inverses = []
    for name, wanted, shapes, what in sides:
        chosen = range(min(modes, max(len(shapes), rigid))) if wanted is None else sorted(set(wanted))
        if list(chosen[:rigid]) != list(range(rigid)) or chosen[-1] >= modes:
            raise InputError(
                f"{name} is {list(chosen)}; name the {rigid} rigid-body modes and others up to {modes - 1}"
            )
        if len(shapes) < len(chosen):
            raise InputError(
                f"model has {pluralise(len(shapes), what[:-1])}, too few to separate {len(chosen)} modes; add {what}"
            )
        inverses.append(_inverse(shapes[:, list(chosen)], what)[:rigid])
    return Decoupling(np.ascontiguousarray(inverses[0].T), inverses[1])


def _inverse(shapes: Float64[np.ndarray, "places modes"], what: str) -> Float64[np.ndarray, "modes places"]:
    """Pseudo-inverse of mode shapes that are independent at these places."""
    if np.linalg.cond(shapes) > WORST_CONDITION:
        raise InputError(
            f"the {what} do not separate {shapes.shape[1]} modes; move one that shares a place or sits on a node"
        )
    return np.linalg.pinv(shapes)


@checked
def decoupled_plant(
    plant: ModalModel,
    decoupling: Decoupling,
    gain: Float64[np.ndarray, "inputs states"] | StateModel,
    observer: Observer | None = None,
) -> StateModel:
    r"""The decoupled plant, u to q, under the force :math:`f_d = K(s)\hat x`; :math:`f = \Gamma u + f_d`.

    The gain acts on the modal states of form 1 of the first modes; those left out get no feedback. The observer takes
    f and y, as in Fig. 4.12; by default the estimates are perfect.
    """
    machine, seen = plant.state_space(), decoupling.apply(plant).state_space()
    (outputs, inputs), axes = machine.d.shape, len(decoupling.sensing)
    known = len(machine.a) if observer is None else len(observer.a)
    # What is read off the states: they themselves for K(s), the forces at once for a constant K.
    if isinstance(gain, StateModel):
        force, (forces, states), selected = gain, gain.d.shape, np.eye(gain.d.shape[1])
    else:
        force, (forces, states), selected = constant(np.eye(inputs)), gain.shape, gain
    if forces != inputs or states > known:
        raise InputError(
            f"gain goes from {pluralise(states, 'state')} to {pluralise(forces, 'force')}; the plant takes {pluralise(inputs, 'force')} and "
            f"{known} states are known"
        )
    read = len(selected)
    rows = np.zeros((read, known))
    rows[:, :states] = selected
    b = np.hstack([machine.b, seen.b])  # of f_d and of u
    both = np.hstack([decoupling.sensing @ machine.d, seen.d])
    if observer is None:
        c, d = np.vstack([seen.c, rows]), np.vstack([both, np.zeros((read, inputs + axes))])
        models = [StateModel(machine.a, b, c, d), force]
        taken, given = (inputs, axes, read), (axes, read, inputs)  # f_d, u | rows; q, rows | f_d
        feedback = block_matrix(taken, given, (0, 0, 1), (0, 0, 0), (0, 1, 0))
        external = block_matrix(taken, (axes,), (0,), (1,), (0,))
    else:
        own = np.hstack([machine.d, machine.d @ decoupling.actuation])
        c, d = np.vstack([seen.c, machine.c]), np.vstack([both, own])
        models = [StateModel(machine.a, b, c, d), observer.estimator(rows), force]
        # f_d, u | f, y | rows; q, y | rows | f_d
        taken, given = (inputs, axes, inputs, outputs, read), (axes, outputs, read, inputs)
        nothing, f_d, y, estimates = (0, 0, 0, 0), (0, 0, 0, 1), (0, 1, 0, 0), (0, 0, 1, 0)
        feedback = block_matrix(taken, given, f_d, nothing, f_d, y, estimates)
        external = block_matrix(taken, (axes,), (0,), (1,), (decoupling.actuation,), (0,), (0,))
    return interconnect(models, feedback, external, np.eye(axes, feedback.shape[1]))
