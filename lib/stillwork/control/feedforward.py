"""Tracking: data-based feedforward (A.1), its modification for an observer (A.7), exact simulation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from stillwork.base.bounds import NonNegative
from stillwork.base.checks import InputError, pluralise, require_array
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.loops import INPUTS, OUTPUTS, require_deviations, require_stable
from stillwork.control.setpoint import MoveLimits, Setpoint, largest_of
from stillwork.lti.discretisation import zoh
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel, block_matrix, interconnect

BASIS = ("velocity", "acceleration", "jerk", "snap")


@by_value
@dataclass(frozen=True)
class Feedforward:
    r"""Gains of :math:`C_{ff} = \Theta_{vel}s + \Theta_{acc}s^2 + \Theta_{jerk}s^3 + \Theta_{snap}s^4`, and dry friction.

    Parameters
    ----------
    velocity, acceleration, jerk, snap : float
        Terms for viscous friction, mass, and the compliance of the flexible modes.
    coulomb : float
        Dry friction: its size is constant, its sign that of the velocity.

    Examples
    --------
    >>> control.Feedforward(acceleration=10.0, coulomb=1.0).gains
    array([ 0., 10.,  0.,  0.])
    """

    velocity: float = 0.0  # N s/m
    acceleration: float = 0.0  # kg
    jerk: float = 0.0  # kg s
    snap: float = 0.0  # kg s^2
    coulomb: NonNegative = 0.0  # N, with the sign of the velocity

    def __post_init__(self):
        check_fields(self)

    @property
    def gains(self) -> Float64[np.ndarray, "4"]:
        """Those of velocity, acceleration, jerk and snap."""
        return np.array([self.velocity, self.acceleration, self.jerk, self.snap], dtype=float)

    @checked
    def force(self, setpoint: Setpoint) -> Float64[np.ndarray, " samples"]:
        """Feedforward force at the samples (N).

        Parameters
        ----------
        setpoint : Setpoint
            The move.

        Returns
        -------
        ndarray, shape (samples,)
            N.

        Raises
        ------
        InputError
            When it is no setpoint.

        Examples
        --------
        >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])  # 10 kg
        >>> loop = control.closed_loop(mass, None, control.PidFamily(10.0)(50.0).state_space())
        >>> move = control.point_to_point(1e4, 100.0, 2.0, 0.1, cruise=0.02, settling=0.005, sample_time=1e-3)
        >>> gains = control.fit_feedforward(control.error_loop(loop), move)
        >>> float(gains.force(move).max().round(3))  # N: 10 kg at 2 m/s^2
        20.0
        """
        return self.gains @ setpoint.derivatives[1:] + self.coulomb * np.sign(setpoint.derivatives[1])


@by_value
@dataclass(frozen=True)
class Motion:
    """Feedforward and limits of the setpoint, which make a motion controller of one of the error.

    Attributes
    ----------
    feedforward : Feedforward
        In the units of the controller's input and output.
    lag : float
        s, by which the position follows the feedforward: delay of the loop and half a sample of the hold.
    limits : MoveLimits, optional
        Limits of the setpoint; without them it cannot move until they are set in the C code.

    Raises
    ------
    InputError
        When the lag is negative.

    Examples
    --------
    >>> control.Motion(control.Feedforward(acceleration=10.0), lag=1.5e-4).limits is None
    True
    """

    feedforward: Feedforward = Feedforward()
    lag: NonNegative = 0.0
    limits: MoveLimits | None = None

    def __post_init__(self):
        check_fields(self)

    @checked
    def most_force(self, peaks: Float64[np.ndarray, "4"]) -> float:
        """Bound on the sum of the feedforward's terms over a move.

        Parameters
        ----------
        peaks : ndarray, shape (4,)
            Its largest velocity, acceleration, jerk and snap.

        Returns
        -------
        float

        Examples
        --------
        >>> control.Motion(control.Feedforward(acceleration=10.0, coulomb=1.0)).most_force(np.array([0.1, 2.0, 0.0, 0.0]))
        21.0
        """
        return float(np.abs(self.feedforward.gains) @ peaks) + self.feedforward.coulomb

    @checked(infinite=True)
    def require_within(self, allowed: float | ArrayLike) -> None:
        """Refuse limits of the setpoint under which the sum of the feedforward's terms may exceed the limit of the output.

        Parameters
        ----------
        allowed : float
            Largest output; may be infinite.

        Raises
        ------
        InputError
            When it may exceed the limit.

        Examples
        --------
        >>> heavy = control.Feedforward(acceleration=10.0)
        >>> control.Motion(heavy, limits=control.MoveLimits(0.1, 2.0, 100.0)).require_within(21.0)  # N
        """
        allowed = float(require_array("allowed", allowed, shape=(), infinite=True))
        if self.limits is None:
            return
        asked = self.most_force(largest_of(self.limits))
        if asked > allowed:
            raise InputError(
                f"limits: the feedforward's terms sum to up to {asked:.4g}, the output is limited to {allowed:.4g}; "
                "lower the limits of acceleration, velocity, jerk or snap"
            )


@checked(infinite=True)
def motion_of(
    model: ModalModel, lag: float, position: float = 1.0, drive: float = 1.0, limits: MoveLimits | None = None
) -> Motion:
    """Feedforward terms of a plant, in units given per unit of its position and force; zero on a suspension."""
    if model.rigid_modes != 1:
        return Motion(lag=lag, limits=limits)
    gains = inverse_gains(model).gains * drive / position
    return Motion(Feedforward(*gains), lag, limits)


@checked
def inverse_gains(model: ModalModel) -> Feedforward:
    """Gains of (A.1) that agree with the inverse of a plant, from its series about zero frequency up to s^4.

    For one rigid body (mass and viscous friction), one actuator and one sensor; the flexible modes determine the snap gain.

    Parameters
    ----------
    model : ModalModel

    Returns
    -------
    Feedforward

    Raises
    ------
    InputError
        When the model has another number of inputs, outputs or rigid modes than one.

    Examples
    --------
    >>> stage = lti.ModalModel([0.0, 600.0], [0.0, 0.0], [[0.5], [0.5]], [[0.5, -0.5]], [[0.0]])
    >>> gains = control.inverse_gains(stage)
    >>> gains.acceleration, round(gains.snap, 9)  # kg, kg s^2: 4 kg, and 0.25 / 600^2 of compliance against it
    (4.0, 1.1111e-05)
    """
    if model.feedthrough.shape != (1, 1) or model.rigid_modes != 1 or model.measures != "position":
        raise InputError("model must have one input, one output that is a position, and one rigid-body mode")
    parts = model.output_shapes[0] * model.input_shapes[:, 0]
    w, z = model.frequencies[1:], model.damping[1:]
    mass = 1 / parts[0]
    # P = 1/(mass s (s + drag)) + c0 + c1 s + ..., so 1/P = N / (1 + N (c0 + c1 s)) with N = mass s (s + drag).
    c0 = float(model.feedthrough[0, 0] + np.sum(parts[1:] / w**2))
    c1 = float(-np.sum(2 * z * parts[1:] / w**3))
    rigid = np.polynomial.Polynomial([0.0, mass * model.drag, mass])
    beside = rigid * np.polynomial.Polynomial([c0, c1])
    series = rigid * (1 - beside + beside**2 - beside**3)
    return Feedforward(*series.coef[1:5])


@checked
def modified_feedforward(compensator: StateModel, controller: StateModel) -> StateModel:
    """Feedforward of Fig. A.2: from the original feedforward force u0 and the setpoint r to u_ff.

    A copy of the observer runs on (u0, r) and subtracts what the observer in the loop adds, (A.7).
    """
    inputs, outputs = controller.d.shape
    given, found = (inputs, outputs), (inputs, outputs, inputs)  # u0, r; u_d, y_flex, controller
    taken = (inputs, outputs, outputs)  # u0, r, y_flex into the controller
    return interconnect(
        [compensator, controller],
        block_matrix(taken, found, (0, 0, 0), (0, 0, 0), (0, 1, 0)),
        block_matrix(taken, given, (1, 0), (0, 1), (0, 0)),
        block_matrix((inputs,), found, (-1, 0, -1)),
        block_matrix((inputs,), given, (1, 0)),
    )


@checked
def error_loop(loop: StateModel) -> StateModel:
    """Model from (r, u0) to e_true of a single `closed_loop` with the modified feedforward.

    With that feedforward the observer cancels against its copy: the setpoint acts like the sensor reference v
    and the original feedforward like a force w that the observer does not see.

    Parameters
    ----------
    loop : StateModel
        See `closed_loop`.

    Returns
    -------
    StateModel
        Inputs (r, u0), output e_true.

    Raises
    ------
    InputError
        When the loop has more than one actuator or sensor, or is none of `closed_loop`.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (A.7).

    Examples
    --------
    >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])
    >>> loop = control.closed_loop(mass, None, control.PidFamily(10.0)(50.0).state_space())
    >>> control.error_loop(loop).d.shape
    (1, 2)
    """
    outputs, inputs = loop.d.shape
    if (inputs, outputs) != (len(INPUTS), len(OUTPUTS)):
        raise InputError(
            f"loop has {pluralise(inputs, 'input')} and {pluralise(outputs, 'output')}; give closed_loop(...) of one actuator and sensor"
        )
    return loop.select([INPUTS.index("v"), INPUTS.index("w")], [OUTPUTS.index("e_true")])


def _held(loop: StateModel, source: int, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition matrix, and input matrix for an input and its derivatives up to the constant fourth."""
    n = len(loop.a)
    chain = np.zeros((n + 4, n + 4))
    chain[:n, :n], chain[:n, n] = loop.a, loop.b[:, source]
    chain[n:, n:] = np.eye(4, k=1)
    last = np.eye(n + 4)[:, -1:]
    whole = zoh(StateModel(chain, last, np.zeros((1, n + 4)), np.zeros((1, 1))), sample_time)
    return whole.a[:n, :n], np.hstack([whole.a[:n, n:], whole.b[:n]])


@checked
def tracking_model(loop: StateModel, feedforward: Feedforward, sample_time: float) -> StateModel:
    """Discrete model from the setpoint and its derivatives (5 inputs) to the error, exact for constant snap."""
    return _driven(_moved(loop, sample_time), feedforward)


class _Moved(NamedTuple):
    """A loop moved by a setpoint of constant snap: what does not depend on the feedforward."""

    loop: StateModel
    a: Float64[np.ndarray, "states states"]
    drive: Float64[np.ndarray, "states 5"]  # of r and its derivatives
    force: Float64[np.ndarray, "states 5"]  # of u0 and its derivatives
    sample_time: float


def _moved(loop: StateModel, sample_time: float) -> _Moved:
    if loop.b.shape[1] != 2:
        raise InputError(f"loop has {pluralise(loop.b.shape[1], 'input')}; give error_loop(closed_loop(...))")
    require_stable(loop)
    a, drive = _held(loop, 0, sample_time)
    _, force = _held(loop, 1, sample_time)
    return _Moved(loop, a, drive, force, sample_time)


def _driven(moved: _Moved, feedforward: Feedforward) -> StateModel:
    loop, drive = moved.loop, moved.drive.copy()
    direct = np.zeros((len(loop.c), 5))
    direct[:, 0] = loop.d[:, 0]
    for order, gain in enumerate(feedforward.gains, 1):
        drive[:, order:] += gain * moved.force[:, : 5 - order]
        direct[:, order] += gain * loop.d[:, 1]
    return StateModel(moved.a, drive, loop.c, direct, moved.sample_time)


@checked
def tracking_error(
    loop: StateModel, setpoint: Setpoint, feedforward: Feedforward
) -> Float64[np.ndarray, " samples"]:
    """True tracking error over the move (m), without noise.

    Parameters
    ----------
    loop : StateModel
        From (r, u0) to e_true, see `error_loop`.
    setpoint : Setpoint
    feedforward : Feedforward

    Returns
    -------
    ndarray, shape (samples,)

    Raises
    ------
    InputError
        When the loop is unstable or none of `error_loop`.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (A.7).

    Examples
    --------
    >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])
    >>> loop = control.closed_loop(mass, None, control.PidFamily(10.0)(50.0).state_space())
    >>> move = control.point_to_point(1e4, 100.0, 2.0, 0.1, cruise=0.02, settling=0.005, sample_time=1e-3)
    >>> loop = control.error_loop(loop)
    >>> error = control.tracking_error(loop, move, control.fit_feedforward(loop, move))
    >>> bool(np.abs(error).max() < 1e-12)  # m: the mass is known
    True
    """
    return simulate(tracking_model(loop, feedforward, setpoint.sample_time), setpoint.derivatives)[0]


@checked
def fit_feedforward(loop: StateModel, setpoint: Setpoint) -> Feedforward:
    """Feedforward gains that minimise the sum of squared errors over the whole move.

    The error is linear in the gains, so least squares on simulated moves is where the iterative data-based
    tuning of the thesis converges.

    Parameters
    ----------
    loop : StateModel
        From (r, u0) to e_true, see `error_loop`.
    setpoint : Setpoint

    Returns
    -------
    Feedforward
        Gains of velocity, acceleration, jerk and snap.

    Raises
    ------
    InputError
        When the move does not excite a gain (a setpoint at rest).

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (A.1).

    Examples
    --------
    >>> mass = lti.ModalModel([0.0], [0.0], [[1.0]], [[0.1]], [[0.0]])
    >>> loop = control.closed_loop(mass, None, control.PidFamily(10.0)(50.0).state_space())
    >>> move = control.point_to_point(1e4, 100.0, 2.0, 0.1, cruise=0.02, settling=0.005, sample_time=1e-3)
    >>> round(control.fit_feedforward(control.error_loop(loop), move).acceleration, 6)  # kg
    10.0
    """
    moved = _moved(loop, setpoint.sample_time)

    def error(**gains: float) -> Float64[np.ndarray, " samples"]:
        return simulate(_driven(moved, Feedforward(**gains)), setpoint.derivatives)[0]

    base = error()
    # A gain's part by itself: taken from a whole error it would be lost in that where the units make it small.
    moved = moved._replace(drive=0 * moved.drive, loop=replace(loop, d=loop.d * [0.0, 1.0]))
    gains = least_squares(np.array([error(**{name: 1.0}) for name in BASIS]).T, -base)
    return Feedforward(**dict(zip(BASIS, gains, strict=True)))


@checked
def least_squares(
    matrix: Float64[np.ndarray, "samples gains"], wanted: Float64[np.ndarray, " samples"]
) -> list[float]:
    """Least-squares gains of the columns for `wanted`; the columns are normalised first."""
    sizes = np.linalg.norm(matrix, axis=0)
    if np.any(sizes == 0):
        raise InputError("setpoint does not move; the feedforward gains cannot be distinguished")
    gains, _, rank, _ = np.linalg.lstsq(np.asarray_chkfinite(matrix / sizes), wanted, rcond=1e-12)
    if rank < matrix.shape[1]:
        raise InputError(
            "setpoint: its gains cannot be distinguished by this move; give one with other jerk and snap"
        )
    return (gains / sizes).tolist()


@checked
def noise_error(
    loop: StateModel, sample_time: float, samples: int, deviations: dict[str, float], rng: np.random.Generator
) -> Float64[np.ndarray, "2 samples"]:
    """True and measured error of a single `closed_loop` under white noise held over each sample.

    The standard deviations of the inputs ``w``, ``v``, ``d`` (N and m) set with the sample time (s) the noise's power,
    sample_time x deviation^2 a hertz, two-sided.
    """
    return noise_errors(loop, sample_time, samples, deviations, [rng])[0]


@checked
def noise_errors(
    loop: StateModel,
    sample_time: float,
    samples: int,
    deviations: dict[str, float],
    draws: Sequence[np.random.Generator],
) -> list[Float64[np.ndarray, "2 samples"]]:
    """`noise_error` for each of several generators; the loop is discretised and decoupled once for all."""
    require_deviations(deviations)
    require_stable(loop)
    places = [INPUTS.index(name) for name in deviations]
    model = zoh(loop.select(places, [0, 1]), sample_time)
    sizes = np.array(list(deviations.values()))[:, None]
    return [simulate(model, rng.standard_normal((len(places), samples)) * sizes) for rng in draws]
