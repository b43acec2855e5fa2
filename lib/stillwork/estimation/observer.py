"""The Kalman observer (3.3), alone or with a noise model that restores integral action (3.15)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy import linalg

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError, require_choice
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.estimation.riccati import continuous_gain
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


@by_value
@dataclass(frozen=True)
class NoiseIntensities:
    """Intensities that the observer is designed for; without a noise model only their ratio matters.

    Parameters
    ----------
    process : float
        Q, N^2, above zero.
    sensor : float
        R, m^2, above zero.

    Raises
    ------
    InputError
        When an intensity is not positive.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), section 3.1.

    Examples
    --------
    >>> estimation.NoiseIntensities(process=1.0, sensor=1e-12).sensor  # m^2: 1 um
    1e-12
    """

    process: Positive  # Q, N^2
    sensor: Positive  # R, m^2

    def __post_init__(self):
        check_fields(self)


class FlexibleEstimates:
    """Of an observer of a modal model: rows that read the flexible modes off its states."""

    model: ModalModel
    a: Float64[np.ndarray, "states states"]

    @checked
    def read(
        self, flexible: Float64[np.ndarray, "signals flexible_modes"], quantity: str = "position"
    ) -> Float64[np.ndarray, "signals states"]:
        """Rows that weight the estimated positions (or velocities) of the flexible modes.

        Parameters
        ----------
        flexible : array_like, shape (signals, flexible_modes)
            The weights.
        quantity : str
            ``position`` or ``velocity``.

        Returns
        -------
        ndarray, shape (signals, states)
            One row per signal.

        Raises
        ------
        InputError
            When the weights do not fit the modes of the model.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> observer = estimation.kalman_observer(stage, estimation.NoiseIntensities(process=1.0, sensor=1e-12))
        >>> observer.read([[1.0]], "velocity")  # rigid-body position and velocity, then the flexible mode's
        array([[0., 0., 0., 1.]])
        """
        require_choice("quantity", quantity, ("position", "velocity"))
        rigid = self.model.rigid_modes
        first = rigid if self.model.measures == "velocity" else 2 * rigid
        rows = np.zeros((len(flexible), len(self.a)))
        rows[:, first + (quantity == "velocity") : first + 2 * flexible.shape[1] : 2] = flexible
        return rows

    @property
    def flexible_outputs(self) -> Float64[np.ndarray, "outputs states"]:
        """C_f: what the estimated flexible modes put into each measurement."""
        return self.read(self.model.output_shapes[:, self.model.rigid_modes :], self.model.measures)

    @checked
    def feedback(
        self, gain: Float64[np.ndarray, "inputs modal_states"]
    ) -> Float64[np.ndarray, "inputs states"]:
        """Rows for a gain on the modal states of form 1, whose part on the rigid-body modes is left out.

        Parameters
        ----------
        gain : array_like, shape (inputs, modal states)
            On positions and velocities in turn.

        Returns
        -------
        ndarray, shape (inputs, states)
            One row per input.

        Raises
        ------
        InputError
            When the gain does not fit the modes of the model.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> observer = estimation.kalman_observer(stage, estimation.NoiseIntensities(process=1.0, sensor=1e-12))
        >>> observer.feedback([[5.0, 6.0, 100.0, 2.0]])
        array([[  0.,   0., 100.,   2.]])
        """
        flexible = gain[:, 2 * self.model.rigid_modes :]
        return self.read(flexible[:, ::2]) + self.read(flexible[:, 1::2], "velocity")


@by_value
@dataclass(frozen=True)
class Observer(FlexibleEstimates):
    r"""Observer :math:`\dot{\hat x} = (A - LC)\hat x + (B - LD)u + Ly` of a reduced modal model.

    The states are the rigid-body states, those of the flexible modes (position and velocity of each), then
    (with a noise model) one integrator per input. For velocity measurements the rigid-body positions, which
    they do not see, stay out.
    """

    model: ModalModel
    a: Float64[np.ndarray, "states states"]
    b: Float64[np.ndarray, "states inputs"]
    c: Float64[np.ndarray, "outputs states"]
    gain: Float64[np.ndarray, "states outputs"]  # L
    residual: float = 0.0  # of the Riccati equation

    @checked
    def __post_init__(self):
        check_fields(self)
        n, outputs = len(self.a), len(self.model.output_shapes)
        for name, wanted in (
            ("a", (n, n)),
            ("b", (n, self.b.shape[1])),
            ("c", (outputs, n)),
            ("gain", (n, outputs)),
        ):
            if getattr(self, name).shape != wanted:
                raise InputError(
                    f"{name} has shape {getattr(self, name).shape}; give {wanted[0]} x {wanted[1]}"
                )
        if np.any(linalg.eigvals(self.a - self.gain @ self.c).real >= 0):
            raise InputError("the observer is unstable; its gain must stabilise A - LC")

    @checked
    def estimator(self, rows: Float64[np.ndarray, "signals states"]) -> StateModel:
        """Model from (u, y) to the signals ``rows @ x_hat``.

        Parameters
        ----------
        rows : array_like, shape (signals, states)
            Weights of the estimated states, e.g. of `read`.

        Returns
        -------
        StateModel
            Inputs (u, y), as many outputs as rows.

        Raises
        ------
        InputError
            When the rows do not fit the states.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
        >>> observer = estimation.kalman_observer(stage, estimation.NoiseIntensities(process=1.0, sensor=1e-12))
        >>> observer.estimator(observer.read([[-0.3]])).d.shape  # position of the sensor by the flexible mode
        (1, 2)
        """
        b = np.hstack([self.b - self.gain @ self.model.feedthrough, self.gain])
        return StateModel(self.a - self.gain @ self.c, b, rows, np.zeros((len(rows), b.shape[1])))


@checked
def kalman_observer(
    model: ModalModel, noise: NoiseIntensities, noise_model: Positive | None = None
) -> Observer:
    """Kalman observer of section 3.1, with the process noise at the plant input (G = B).

    Parameters
    ----------
    model : ModalModel
        Reduced model; its feedthrough is the compliance T_DC.
    noise : NoiseIntensities
    noise_model : float, optional
        Intensity Q_nu of the random walk z that is added to the plant input, with U = B: (3.14) and
        Theorem 3.2.4.

    Returns
    -------
    Observer
        With its gain, and the relative residual of the Riccati equation.

    Raises
    ------
    InputError
        When a mode that is not stable by itself cannot be observed, or the Riccati equation has no accurate solution.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), section 3.1.

    Examples
    --------
    >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.01], [[0.3], [0.3]], [[0.3, -0.3]], [[0.0]])
    >>> observer = estimation.kalman_observer(stage, estimation.NoiseIntensities(process=1.0, sensor=1e-12))
    >>> bool(np.linalg.eigvals(observer.a - observer.gain @ observer.c).real.max() < 0)
    True
    """
    states = model.state_space()
    a, b, c = states.a, states.b, states.c
    if model.measures == "velocity":
        seen = np.r_[1 : 2 * model.rigid_modes : 2, 2 * model.rigid_modes : len(a)]
        a, b, c = a[np.ix_(seen, seen)], b[seen], c[:, seen]
    inputs = b.shape[1]
    g, q = b, noise.process * np.eye(inputs)
    if noise_model is not None:
        walk = np.zeros((inputs, inputs))
        a, b, g, c = augment_random_walk(a, b, c, walk)
        q = linalg.block_diag(q, noise_model * np.eye(inputs))
    solved = continuous_gain(a, g, c, q, noise.sensor)
    return Observer(model, a, b, c, solved.gain, solved.residual)


@checked
def augment_random_walk(
    a: Float64[np.ndarray, "states states"],
    b: Float64[np.ndarray, "states inputs"],
    c: Float64[np.ndarray, "outputs states"],
    walk: Float64[np.ndarray, "inputs inputs"],
) -> tuple[np.ndarray, ...]:
    """A, B, G and C with a random walk added to each plant input; `walk` is its transition without noise."""
    inputs = b.shape[1]
    a = np.block([[a, b], [np.zeros((inputs, len(a))), walk]])
    g = linalg.block_diag(b, np.eye(inputs))
    return a, np.vstack([b, np.zeros((inputs, inputs))]), g, np.hstack([c, np.zeros((len(c), inputs))])
