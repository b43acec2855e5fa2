"""State-feedback gains on the flexible modes: active damping (3.31)-(3.34) and active stiffness (3.42)."""

from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.bounds import Positive, one_of
from stillwork.base.checks import InputError, require_array, require_number
from stillwork.base.validation import checked
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel

SELECTIONS = ("each mode", "minimal interaction", "pole placement")


@checked
def per_flexible_mode(
    model: ModalModel, name: str, value: float | ArrayLike
) -> Float64[np.ndarray, " flexible"]:
    """The argument `name` as one number a flexible mode; a single number stands for all of them."""
    flexible = model.modes(slice(model.rigid_modes, None))
    if not len(flexible.frequencies):
        raise InputError("model has no flexible modes; there is nothing to damp or to stiffen")
    value = require_array(name, value)
    if value.ndim == 0:
        value = np.full(len(flexible.frequencies), float(value))
    return require_array(name, value, shape=(len(flexible.frequencies),))


@checked
def require_reach(model: ModalModel) -> None:
    """Refuse an actuator on a node of a flexible mode."""
    reach = np.linalg.norm(model.input_shapes[model.rigid_modes :], axis=1)
    if np.any(reach < 1e-9 * np.linalg.norm(model.input_shapes)):
        raise InputError(
            "input_shapes: the actuator sits on a node of a mode and cannot move it; leave that mode out"
        )


@checked
def damping_gain(
    model: ModalModel,
    increase: float | ArrayLike,
    selection: Annotated[str, one_of(SELECTIONS)] = "each mode",
) -> Float64[np.ndarray, "inputs states"]:
    """Gain K of active damping, u_d = K x, on the states of modal form 1.

    Parameters
    ----------
    model : ModalModel
    increase : float or array_like, shape (flexible modes,)
        Desired increase zeta_des of each damping ratio (an increase, not a target).
    selection : str
        ``each mode``: (3.31), mode by mode, without regard to coupling; ``minimal interaction``: (3.32),
        the pseudo-inverse over all modes, rigid body included; ``pole placement``: (3.33), one input only,
        with the gain on the rigid-body states set to zero.

    Returns
    -------
    ndarray, shape (inputs, states)

    Raises
    ------
    InputError
        When the actuator cannot move a mode, or the selection is unknown.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), (3.31)-(3.34).

    Examples
    --------
    >>> mode = lti.ModalModel([100.0], [0.01], [[1.0]], [[1.0]], [[0.0]])
    >>> control.damping_gain(mode, increase=0.1)  # -2 zeta_des omega on the velocity, N s/m
    array([[  0., -20.]])
    """
    increase = per_flexible_mode(model, "increase", increase)
    rigid = model.rigid_modes
    w, shapes = model.frequencies[rigid:], model.input_shapes[rigid:]
    require_reach(model)
    if selection == "pole placement":
        z = model.damping[rigid:] + increase
        if np.any(np.abs(z) >= 1):
            raise InputError(f"increase leads to damping ratios up to {z.max():.3g}; keep them below 1")
        upper = w * (-z + 1j * np.sqrt(1 - z**2))
        gain = place(model.state_space(), np.concatenate([np.zeros(2 * rigid), upper, upper.conj()]))
        gain[:, : 2 * rigid] = 0
        return gain
    gain = np.zeros((model.input_shapes.shape[1], 2 * len(model.frequencies)))
    wanted = 2 * increase * w
    if selection == "each mode":
        gain[:, 2 * rigid + 1 :: 2] = -_each(shapes, wanted)
    else:
        rates = np.concatenate([np.zeros(rigid), wanted])
        gain[:, 2 * rigid + 1 :: 2] = -(np.linalg.pinv(model.input_shapes) * rates)[:, rigid:]
    return gain


def _each(shapes: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    columns = [np.linalg.pinv(row[None, :]) * rate for row, rate in zip(shapes, wanted, strict=True)]
    return np.hstack(columns)


@checked
def place(model: StateModel, poles: ArrayLike) -> Float64[np.ndarray, "1 states"]:
    """Gain K that gives A + BK these poles, by Ackermann's formula on a scaled model with one input.

    Repeated poles are allowed, which `scipy.signal.place_poles` refuses.
    """
    n = len(model.a)
    if model.b.shape[1] != 1:
        raise InputError(f"model has {model.b.shape[1]} inputs; this formula is for one")
    poles = require_array("poles", poles, dtype=np.complex128)
    if poles.shape != (n,):
        raise InputError(f"poles has shape {poles.shape}; give {n}, one per state")
    polynomial = np.poly(poles)
    if np.any(np.abs(polynomial.imag) > 1e-9 * np.abs(polynomial)):
        raise InputError("poles are not real or in conjugate pairs; the gain would be complex")
    rate = np.abs(poles).max() or 1.0
    whole = np.block(
        [[model.a / rate, model.b / np.linalg.norm(model.b)], [np.ones((1, n)), np.zeros((1, 1))]]
    )
    _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    scale = scale[:n]
    a = model.a * scale[None, :] / scale[:, None] / rate
    b = model.b / scale[:, None] / rate
    columns, polynomial = [b], np.poly(poles / rate).real
    for _ in range(n - 1):
        columns.append(a @ columns[-1])
    reach = np.hstack(columns)
    if np.linalg.cond(reach / np.linalg.norm(reach, axis=0)) > 1e12:
        raise InputError("model is not controllable from its input; its poles cannot be placed")
    last = np.linalg.solve(reach.T, np.eye(n)[:, -1])
    value = np.zeros((n, n))
    for coefficient in polynomial:
        value = value @ a + coefficient * np.eye(n)
    return -(last @ value / scale)[None, :]


@checked
def stiffness_gain(model: ModalModel, factor: float | ArrayLike) -> Float64[np.ndarray, "inputs states"]:
    """Gain K on the states of form 1 that multiplies each resonance frequency by `factor`, (3.42).

    A factor of 1.5 gives the -1.25 omega^2/phi of (3.43).
    """
    require_reach(model)
    rigid = model.rigid_modes
    gain = np.zeros((model.input_shapes.shape[1], 2 * len(model.frequencies)))
    gain[:, 2 * rigid :: 2] = -_each(model.input_shapes[rigid:], stiffening(model, factor))
    return gain


@checked
def stiffening(model: ModalModel, factor: float | ArrayLike) -> Float64[np.ndarray, " flexible"]:
    """Increase of the square of each resonance frequency that multiplies the frequency by `factor`, one for all or each."""
    factor = per_flexible_mode(model, "factor", factor)
    for each in factor:
        require_number("factor", each, above=0.0)
    return (factor**2 - 1) * model.frequencies[model.rigid_modes :] ** 2


class DampedModes(NamedTuple):
    """Modes of a machine under state feedback, sorted by frequency; a rigid-body mode is one entry of zeros."""

    damping: Float64[np.ndarray, " modes"]
    frequencies: Float64[np.ndarray, " modes"]  # undamped, rad/s


@checked
def fed_back(model: ModalModel, gain: Float64[np.ndarray, "inputs states"]) -> DampedModes:
    """Damping ratios and frequencies of A + BK, for perfect estimates."""
    states = model.state_space()
    if gain.shape != states.b.T.shape:
        raise InputError(f"gain has shape {gain.shape}; give {states.b.shape[1]} x {len(states.a)}")
    # A rigid-body mode without feedback stays at the origin: leave it out of the eigenvalue problem, where
    # rounding would spread its double pole.
    still = 2 * model.rigid_modes if not np.any(gain[:, : 2 * model.rigid_modes]) else 0
    poles = linalg.eigvals((states.a + states.b @ gain)[still:, still:])
    if np.any(np.abs(poles.imag) <= 1e-12 * np.abs(poles)):
        raise InputError("gain is so large that a mode no longer oscillates; it has no damping ratio below 1")
    upper = poles[poles.imag > 0]
    upper = upper[np.argsort(np.abs(upper))]
    return damped_modes(upper, still // 2)


@checked
def damped_modes(upper: Complex128[np.ndarray, " modes"], rigid: int) -> DampedModes:
    """Modes with these poles in the upper half-plane, behind the rigid-body modes."""
    rest = np.zeros(rigid)
    return DampedModes(np.append(rest, -upper.real / np.abs(upper)), np.append(rest, np.abs(upper)))


@checked
def band_pass(omega: Positive, selectivity: Positive) -> StateModel:
    r"""Band-pass :math:`\frac{(\omega/Q)s}{s^2 + (\omega/Q)s + \omega^2}`, (3.34)."""
    a = np.array([[0, omega], [-omega, -omega / selectivity]])
    return StateModel(a, np.array([[0.0], [omega / selectivity]]), np.array([[0.0, 1.0]]), np.zeros((1, 1)))
