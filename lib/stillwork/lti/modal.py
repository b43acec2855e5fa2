"""Modal models: decoupled modes, from mass and stiffness matrices, to and from state space."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.bounds import Matrix, NonNegative, Vector, one_of
from stillwork.base.checks import InputError, pluralise, require_array
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.modal_form import AGREES, fields_of_modes
from stillwork.lti.state_space import StateModel


@by_value
@dataclass(frozen=True)
class ModalModel:
    r"""Decoupled modes :math:`\ddot\eta_i + 2\zeta_i\omega_i\dot\eta_i + \omega_i^2\eta_i = \phi_{ai}^T f`.

    The output is :math:`y = \sum_i \phi_{si}\eta_i + D f`, or its velocity counterpart with
    :math:`\dot\eta_i`. A rigid-body mode has zero frequency and zero damping.

    Parameters
    ----------
    frequencies : array_like, shape (modes,)
        omega_i, rad/s, ascending; zero for a rigid-body mode.
    damping : array_like, shape (modes,)
        zeta_i, each in [0, 1).
    input_shapes : array_like, shape (modes, inputs)
        phi_a, mass-normalised.
    output_shapes : array_like, shape (outputs, modes)
        phi_s, mass-normalised.
    feedthrough : array_like, shape (outputs, inputs)
        D, the compliance of the modes left out.
    measures : str
        "position" or "velocity".
    drag : float
        1/s, viscous friction over mass of the rigid body: :math:`\ddot\eta + c\dot\eta = \phi_a^T f`.

    Raises
    ------
    InputError
        When sizes do not fit, frequencies do not ascend, a damping is not in [0, 1) or the drag negative.

    References
    ----------
    Gawronski, Advanced Structural Dynamics and Active Control of Structures (2004), chapter 2.

    Examples
    --------
    >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    >>> stage.rigid_modes, stage.state_space().a.shape
    (1, (4, 4))
    """

    frequencies: Float64[np.ndarray, " modes"]  # omega_i, rad/s, ascending
    damping: Float64[np.ndarray, " modes"]  # zeta_i
    input_shapes: Float64[np.ndarray, "modes inputs"]  # phi_a, mass-normalised
    output_shapes: Float64[np.ndarray, "outputs modes"]  # phi_s
    feedthrough: Float64[np.ndarray, "outputs inputs"]  # compliance T_DC
    measures: Annotated[str, one_of(("position", "velocity"))] = "position"
    drag: NonNegative = 0.0  # c, 1/s: rate at which the rigid body loses its speed

    def __post_init__(self):
        check_fields(self)
        n = len(self.frequencies)
        if self.input_shapes.shape[0] != n or self.output_shapes.shape[1] != n or self.damping.shape != (n,):
            raise InputError(
                f"shapes and damping do not fit {pluralise(n, 'frequency')}; give one of each per mode"
            )
        if not self.feedthrough.size:
            raise InputError(
                f"feedthrough has shape {self.feedthrough.shape}; give at least one input and one output"
            )
        if np.any(self.frequencies < 0) or np.any(np.diff(self.frequencies) < 0):
            raise InputError("frequencies must be ascending and not negative, in rad/s")
        if np.any(self.damping < 0) or np.any(self.damping >= 1):
            raise InputError("damping must be at least 0 and below 1 (ratio to critical)")
        if np.any(self.damping[self.frequencies == 0] != 0):
            raise InputError("damping of a mode of zero frequency must be 0: its ratio has no meaning")

    @classmethod
    def converted(cls, name: str, system) -> "ModalModel":
        """A system of another library as this one, where it has such modes.

        Parameters
        ----------
        name : str
            What errors call it.
        system : ModalModel or StateModel or control.StateSpace or scipy.signal.lti or tuple
            In continuous time; a mode a million times slower than the fastest counts as free.

        Returns
        -------
        ModalModel
            With the same response.

        Raises
        ------
        InputError
            When it is no model, or not one of modes with real shapes that measures a position or a velocity.

        Examples
        --------
        >>> from control import tf
        >>> lti.ModalModel.converted("stage", tf([1.0], [1.0, 0.2, 100.0])).frequencies.round(6)
        array([10.])
        """
        if isinstance(system, cls):
            return system
        states = StateModel.converted(name, system)
        omega, candidates = fields_of_modes(states, name)
        wanted = states.frequency_response(omega)
        for model in (cls(**each) for each in candidates):
            off = np.linalg.norm(model.frequency_response(omega) - wanted, axis=(0, 1))
            if np.all(off < AGREES * np.linalg.norm(wanted, axis=(0, 1))):
                return model
        raise InputError(
            f"{name} is no model of modes with real shapes that measures a position or a velocity; give a "
            "stillwork.lti.ModalModel, as lti.modal_model makes of masses and springs"
        )

    @property
    def rigid_modes(self) -> int:
        """Number of modes of zero frequency."""
        return int(np.count_nonzero(self.frequencies == 0))

    @property
    def poles(self) -> Complex128[np.ndarray, " poles"]:
        """Both poles of every mode."""
        w, z = self.frequencies, self.damping
        upper = w * (-z + 1j * np.sqrt(1 - z**2))
        return np.concatenate([upper, np.where(w > 0, upper.conj(), -self.drag)])

    @checked
    def modes(self, chosen: Sequence[int] | slice) -> "ModalModel":
        """Keep only these modes (and the feedthrough).

        Parameters
        ----------
        chosen : sequence of int or slice
            Their places in `frequencies`, from 0.

        Returns
        -------
        ModalModel
            Of the chosen modes, in the given order.

        Raises
        ------
        InputError
            When a place does not exist.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> stage.modes([1]).frequencies  # rad/s: the flexible one alone
        array([600.])
        """
        return self._taken(chosen, self.frequencies)

    def _taken(self, chosen, frequencies) -> "ModalModel":
        return replace(
            self,
            frequencies=frequencies[chosen],
            damping=self.damping[chosen],
            input_shapes=self.input_shapes[chosen],
            output_shapes=self.output_shapes[:, chosen],
        )

    @checked
    def moved(self, frequencies: Float64[np.ndarray, " modes"]) -> "ModalModel":
        """The same modes at other frequencies (rad/s), in ascending order: two of them may change places.

        Parameters
        ----------
        frequencies : array_like, shape (modes,)
            One for each mode, in the order of the model.

        Returns
        -------
        ModalModel
            With the shapes and damping ratios of this one.

        Raises
        ------
        InputError
            When there is not one for each mode, or one is negative.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> stage.moved([0.0, 660.0]).frequencies  # rad/s: 10 % stiffer in frequency
        array([  0., 660.])
        """
        frequencies = require_array("frequencies", frequencies, shape=self.frequencies.shape)
        return self._taken(np.argsort(frequencies, kind="stable"), frequencies)

    @checked
    def at(self, inputs: Sequence[int], outputs: Sequence[int]) -> "ModalModel":
        """Keep only these inputs and outputs: actuators and sensors at other places.

        Parameters
        ----------
        inputs, outputs : sequence of int
            Their indices, from 0, in the desired order.

        Returns
        -------
        ModalModel
            From the chosen inputs to the chosen outputs.

        Raises
        ------
        InputError
            When a place does not exist.

        Examples
        --------
        >>> shapes = np.array([[0.3, 0.3], [0.5, -0.5]])  # translation and rotation, at two actuators
        >>> beam = lti.ModalModel([0.0, 0.0], [0.0, 0.0], shapes, shapes.T, np.zeros((2, 2)))
        >>> beam.at([1], [0]).input_shapes.ravel()  # from the second actuator
        array([ 0.3, -0.5])
        """
        return replace(
            self,
            input_shapes=self.input_shapes[:, list(inputs)],
            output_shapes=self.output_shapes[list(outputs)],
            feedthrough=self.feedthrough[np.ix_(list(outputs), list(inputs))],
        )

    @checked
    def compliance(self) -> Float64[np.ndarray, "outputs inputs"]:
        """Static gain of the flexible modes, eq. (2.13) of the observer thesis (m/N).

        Returns
        -------
        ndarray, shape (outputs, inputs)
            m/N; the rigid-body modes are left out.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> (1e6 * stage.compliance()).round(3)  # um/N; the sensor moves against the force
        array([[-0.25]])
        """
        flexible = self.frequencies > 0
        gains = self.input_shapes[flexible] / self.frequencies[flexible, None] ** 2
        return self.output_shapes[:, flexible] @ gains

    @checked
    def frequency_response(self, omega: Vector) -> Complex128[np.ndarray, "outputs inputs frequencies"]:
        """Response at `omega` (rad/s) from the closed-form residues of each mode.

        Parameters
        ----------
        omega : array_like, shape (frequencies,)
            Frequencies, rad/s.

        Returns
        -------
        ndarray, shape (outputs, inputs, frequencies)
            Complex, in m/N, or in m/s/N when it measures a velocity.

        Raises
        ------
        InputError
            When one of them is a pole, e.g. 0 of a rigid-body mode.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> np.abs(stage.modes([0]).frequency_response([10.0])).round(6)  # 0.09 / 10^2: the rigid body
        array([[[0.0009]]])
        """
        if not len(omega):
            raise InputError("omega is empty; give at least one frequency")
        if self.rigid_modes and np.any(omega == 0):
            raise InputError("omega holds 0, where a rigid-body mode has no finite response; leave it out")
        w, z = self.frequencies[:, None], self.damping[:, None]
        residues = self.output_shapes[:, None, :] * self.input_shapes.T[None]
        with np.errstate(all="ignore"):  # what is not finite is refused
            modal = 1 / ((w - omega) * (w + omega) + 2j * z * w * omega + 1j * self._drags[:, None] * omega)
            if self.measures == "velocity":
                modal = modal * (1j * omega)
            return residues @ modal + self.feedthrough[:, :, None]

    @property
    def _drags(self) -> np.ndarray:
        """Drag of what moves freely, 1/s."""
        return np.where(self.frequencies > 0, 0.0, self.drag)

    @checked
    def state_space(self) -> StateModel:
        """State-space model of form 1 of the observer thesis: position and velocity of one mode after the other, (2.9).

        Returns
        -------
        StateModel
            Two states per mode.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> stage.state_space().a[3]  # acceleration of the flexible mode
        array([ 0.0e+00,  0.0e+00, -3.6e+05, -1.2e+01])
        """
        n = len(self.frequencies)
        a, b = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, self.input_shapes.shape[1]))
        c = np.zeros((len(self.output_shapes), 2 * n))
        position, velocity = np.arange(0, 2 * n, 2), np.arange(1, 2 * n, 2)
        a[position, velocity] = 1
        a[velocity, position] = -(self.frequencies**2)
        a[velocity, velocity] = -2 * self.damping * self.frequencies - self._drags
        b[velocity] = self.input_shapes
        c[:, position if self.measures == "position" else velocity] = self.output_shapes
        return StateModel(a, b, c, self.feedthrough)

    def to_control(self):
        """The same model as `control.StateSpace`, in form 1.

        Returns
        -------
        control.StateSpace
            With the same states.

        Raises
        ------
        MissingPackage
            When python-control is not installed.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> stage.to_control().nstates  # two a mode
        4
        """
        return self.state_space().to_control()


@checked
def modal_model(
    mass: Matrix,
    stiffness: ArrayLike,
    input_map: ArrayLike,
    output_map: ArrayLike,
    damping_ratio: float | ArrayLike = 0.0,
    damping_matrix: ArrayLike | None = None,
) -> ModalModel:
    r"""Modal model of :math:`M\ddot q + D\dot q + Kq = S_a f,\; y = S_s q`.

    Parameters
    ----------
    mass, stiffness : array_like, shape (nodes, nodes)
        Symmetric, kg and N/m; the mass matrix positive definite.
    input_map : array_like, shape (nodes, inputs)
    output_map : array_like, shape (outputs, nodes)
    damping_ratio : float or array_like, shape (modes,)
        Modal damping of the flexible modes; used when there is no `damping_matrix`.
    damping_matrix : array_like, shape (nodes, nodes), optional
        Damping that the mode shapes decouple (proportional damping), N s/m; for the rigid body its friction.

    Returns
    -------
    ModalModel
        With mass-normalised shapes, rigid-body modes first.

    Raises
    ------
    InputError
        When M or K is not symmetric or not (semi)definite, or the damping does not decouple.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (2.1)-(2.5).

    Examples
    --------
    >>> spring = [[1e6, -1e6], [-1e6, 1e6]]  # N/m, between 8 kg and 2 kg
    >>> model = lti.modal_model(np.diag([8.0, 2.0]), spring, input_map=[[1], [0]], output_map=[[0, 1]])
    >>> (model.frequencies / (2 * np.pi)).round(1)  # Hz
    array([  0. , 125.8])
    """
    n = len(mass)
    stiffness = require_array("stiffness", stiffness, shape=(n, n))
    for name, matrix in (("mass", mass), ("stiffness", stiffness)):
        if matrix.shape != (n, n) or not np.allclose(matrix, matrix.T, rtol=1e-12, atol=0):
            raise InputError(f"{name} is not symmetric; give a symmetric {n} x {n} matrix")
    try:
        squares, shapes = linalg.eigh(stiffness, mass)
    except linalg.LinAlgError:
        raise InputError("mass is not positive definite; every degree of freedom needs mass") from None
    # A rigid-body mode comes out at rounding level; 1e-10 of the largest is far above that and far below a mode.
    floor = 1e-10 * max(squares[-1], 0)
    if squares[0] < -floor:
        raise InputError("stiffness has a negative eigenvalue; a structure needs a semidefinite matrix")
    w, drag = np.sqrt(np.where(squares > floor, squares, 0)), 0.0
    if damping_matrix is None:
        ratio = np.broadcast_to(require_array("damping_ratio", damping_ratio), (n,))
        ratio = np.where(w > 0, ratio, 0.0)
    else:
        modal = shapes.T @ require_array("damping_matrix", damping_matrix, shape=(n, n)) @ shapes
        own, loose = np.diag(modal).copy(), 1e-8 * np.abs(modal).max()
        free = own[w == 0]
        if (
            len(free) and free.max() > loose and np.ptp(free) <= loose
        ):  # friction brakes all that moves freely alike
            drag = float(free.mean())
        own[w == 0] = drag
        if np.abs(modal - np.diag(own)).max() > loose:
            raise InputError(
                "damping_matrix does not decouple in the mode shapes; leave it out and give damping_ratio, or give the "
                "frequency response of this machine as a file: a fit takes whatever damping it has"
            )
        ratio = np.divide(np.where(w > 0, own, 0.0), 2 * w, out=np.zeros(n), where=w > 0)
    input_map = require_array("input_map", input_map, shape=(n, None))
    output_map = require_array("output_map", output_map, shape=(None, n))
    return ModalModel(
        w,
        ratio,
        shapes.T @ input_map,
        output_map @ shapes,
        np.zeros((len(output_map), input_map.shape[1])),
        drag=drag,
    )


@checked
def mirrored(model: ModalModel) -> ModalModel:
    """The same structure measured by a second sensor, at which every flexible mode has the other sign."""
    shapes = model.output_shapes.copy()
    shapes[:, model.rigid_modes :] *= -1
    return replace(model, output_shapes=shapes, feedthrough=-model.feedthrough)
