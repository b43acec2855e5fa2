"""Generalised plants: a model with separate disturbances and controls, performance outputs and measurements."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.state_space import StateModel, interconnect


@by_value
@dataclass(frozen=True)
class GeneralisedPlant:
    r"""A model from (w, u) to (z, y): exogenous inputs and controls to performance and measurements.

    .. math:: \dot x = Ax + B_1w + B_2u,\; z = C_1x + D_{11}w + D_{12}u,\; y = C_2x + D_{21}w + D_{22}u

    Parameters
    ----------
    model : StateModel
        From w, then u, to z, then y.
    exogenous : int
        How many inputs w there are, references, disturbances and noises; the others are controls u.
    performance : int
        How many outputs z there are, errors and efforts to be kept small; the others are measurements y.

    Raises
    ------
    InputError
        When no control or no measurement is left, or no exogenous input or performance output.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), section 9.5.

    Examples
    --------
    A mass of 1 kg that a force w disturbs and a force u steadies; its position is what counts and what is measured.

    >>> mass = lti.StateModel([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0], [1, 0]], np.zeros((2, 2)))
    >>> plant = lti.GeneralisedPlant(mass, exogenous=1, performance=1)
    >>> lead = lti.StateModel([[-10.0]], [[1.0]], [[80.0]], [[-10.0]])  # u = -(2 s + 20) / (s + 10) y
    >>> plant.close(lead).is_stable  # from w to z
    True
    """

    model: StateModel  # from w, then u, to z, then y
    exogenous: int  # number of w
    performance: int  # number of z

    def __post_init__(self):
        check_fields(self)
        outputs, inputs = self.model.d.shape
        if not 0 < self.exogenous < inputs or not 0 < self.performance < outputs:
            raise InputError(
                f"a model with {inputs} inputs and {outputs} outputs cannot have {self.exogenous} exogenous "
                f"inputs and {self.performance} performance outputs; leave controls and measurements"
            )

    @property
    def blocks(self) -> tuple[np.ndarray, ...]:
        """A, B1, B2, C1, C2, D11, D12, D21, D22."""
        m, w, z = self.model, self.exogenous, self.performance
        d = [part for row in (m.d[:z], m.d[z:]) for part in np.split(row, [w], axis=1)]
        return m.a, m.b[:, :w], m.b[:, w:], m.c[:z], m.c[z:], *d

    @checked
    def close(self, controller: StateModel) -> StateModel:
        """The closed loop from w to z, with positive feedback u = K y.

        Parameters
        ----------
        controller : StateModel
            K, from y to u.

        Returns
        -------
        StateModel
            From w to z.

        Raises
        ------
        InputError
            When its sizes or its sample time are not the plant's, or the loop has no unique solution.

        Examples
        --------
        A mass of 1 kg on a spring of 4 N/m.

        >>> mass = lti.StateModel([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0], [1, 0]], np.zeros((2, 2)))
        >>> spring = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[-4.0]])
        >>> np.abs(lti.GeneralisedPlant(mass, exogenous=1, performance=1).close(spring).poles).round(6)  # rad/s
        array([2., 2.])
        """
        (outputs, inputs), w, z = self.model.d.shape, self.exogenous, self.performance
        if controller.d.shape != (inputs - w, outputs - z):
            raise InputError(
                f"controller has shape {controller.d.shape}; give {inputs - w} outputs and {outputs - z} inputs"
            )
        feedback = np.zeros((inputs + outputs - z, outputs + inputs - w))  # (z, y, u) to (w, u, y)
        feedback[w:inputs, outputs:], feedback[inputs:, z:outputs] = np.eye(inputs - w), np.eye(outputs - z)
        external, read = np.eye(len(feedback), w), np.eye(z, feedback.shape[1])
        return interconnect([self.model, controller], feedback, external, read)


@checked
def with_feedthrough(
    controller: StateModel, feedthrough: Float64[np.ndarray, "measurements controls"]
) -> StateModel:
    """The controller of a plant with D22 that acts as the given one does on the plant without: K (I + D22 K)^-1."""
    turned = np.eye(feedthrough.shape[1]) + controller.d @ feedthrough
    c, d = np.linalg.solve(turned, controller.c), np.linalg.solve(turned, controller.d)
    b = controller.b
    return StateModel(
        controller.a - b @ feedthrough @ c, b - b @ feedthrough @ d, c, d, controller.sample_time
    )
