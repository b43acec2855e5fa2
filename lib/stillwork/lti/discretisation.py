"""Discretisation: by zero-order hold exactly, of modes in closed form and of any model, and by Tustin's rule."""

import math
from dataclasses import replace
from functools import lru_cache
from typing import Annotated

import numpy as np
import scipy  # its `signal` is loaded where it is called: it takes half a second
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.bounds import NonNegative, Positive, within
from stillwork.base.checks import InputError, pluralise, require_array, require_memory, require_number
from stillwork.base.validation import checked
from stillwork.lti.delays import delayed, split_delay, with_input_before
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel


@checked
def zoh_modes(model: ModalModel, sample_time: float) -> StateModel:
    """Exact zero-order-hold discretisation in closed form, mode by mode, in modal form 1.

    The transition matrix is (2.29) of the observer thesis taken to the modal states; the input matrix keeps
    the damping that (2.33) leaves out.
    """
    return late_modes(model, sample_time, 0.0)[0]


@checked
def late_modes(
    model: ModalModel, sample_time: Positive, late: Annotated[float, within(at_least=0.0, below=1.0)]
) -> tuple[StateModel, Float64[np.ndarray, "states inputs"]]:
    """As `zoh_modes`, for a force that begins `late` by a fraction of a sample below 1; and the old force's input matrix.

    Until it begins the force of the sample before acts: x_{k+1} = A x_k + B u_k + B_old u_{k-1}.
    """
    n = len(model.frequencies)
    blocks, gains, old = _late(model.frequencies, model.damping, sample_time, late, model.drag)
    a = np.zeros((n, 2, n, 2))
    a[np.arange(n), :, np.arange(n), :] = blocks
    b, before = (
        (each[:, :, None] * model.input_shapes[:, None, :]).reshape(2 * n, -1) for each in (gains, old)
    )
    continuous = model.state_space()
    return StateModel(a.reshape(2 * n, 2 * n), b, continuous.c, continuous.d, sample_time), before


def _late(w, z, sample_time: float, late: float, drag: float):
    """Transition matrices, gains of the new force and of the old one; see `late_modes`."""
    blocks, gains = _held(w, z, sample_time, drag)
    if not late:
        return blocks, gains, np.zeros_like(gains)
    after, new = _held(w, z, (1 - late) * sample_time, drag)
    _, old = _held(w, z, late * sample_time, drag)
    return blocks, new, np.einsum("kij,kj->ki", after, old)


def _held(
    w, z, sample_time: float, drag: float = 0.0
) -> tuple[Float64[np.ndarray, "modes 2 2"], Float64[np.ndarray, "modes 2"]]:
    """Transition matrix and input gains of each mode for itself, over one sample with its force held."""
    s = np.sqrt(1 - z**2)
    angle, decay = w * s * sample_time, np.exp(-z * w * sample_time)
    ratio, cosine = z / s, np.cos(angle)
    # sin(wd T)/wd, with its limit T for a rigid body
    sinc = sample_time * np.sinc(angle / np.pi)
    sine = np.sin(angle)
    blocks = np.empty((len(w), 2, 2))
    blocks[:, 0, 0] = decay * (cosine + ratio * sine)
    blocks[:, 0, 1] = decay * sinc
    blocks[:, 1, 0] = -decay * w**2 * sinc
    blocks[:, 1, 1] = decay * (cosine - ratio * sine)
    flexible = w > 0
    lifted = -np.expm1(-z * w * sample_time) + decay * (2 * np.sin(angle / 2) ** 2 - ratio * sine)
    gains = np.empty((len(w), 2))
    gains[:, 0] = np.divide(lifted, w**2, out=np.full(len(w), sample_time**2 / 2), where=flexible)
    gains[:, 1] = decay * sinc
    if drag and not flexible.all():  # what moves freely loses speed: exp(-drag t)
        free = ~flexible
        lost = drag * sample_time
        once = sample_time * -np.expm1(-lost) / lost
        # 1/2 - x/6 + x^2/24 - ...: the closed form cancels where little is lost
        twice = (
            sum((-lost) ** k / math.factorial(k + 2) for k in range(8))
            if lost < 0.1
            else (lost + np.expm1(-lost)) / lost**2
        )
        blocks[free, 0, 1], blocks[free, 1, 1] = once, np.exp(-lost)
        gains[free, 0], gains[free, 1] = sample_time**2 * twice, once
    return blocks, gains


@checked
def zoh(model: StateModel, sample_time: Positive, delay: NonNegative = 0.0) -> StateModel:
    """Zero-order-hold discretisation by the exponential of the balanced [A B; 0 0].

    Parameters
    ----------
    model : StateModel
        In continuous time.
    sample_time : float
        Sample time, s.
    delay : float
        s, by which the inputs act later: any part of a sample, or more. No approximation by Padé is made.

    Returns
    -------
    StateModel
        In discrete time, with as many states, and with a delay those that hold earlier inputs and outputs; exact for an
        input that is held between samples.

    Raises
    ------
    InputError
        When the model is in discrete time already.

    References
    ----------
    Van Loan, Computing integrals involving the matrix exponential (1978); Astrom and Wittenmark, Computer-Controlled
    Systems (1997), section 2.3.

    Examples
    --------
    >>> lag = lti.StateModel([[-100.0]], [[100.0]], [[1.0]], [[0.0]])  # time constant 10 ms
    >>> lti.zoh(lag, sample_time=0.01).a.round(3)  # exp(-1)
    array([[0.368]])
    """
    _require_continuous(model)
    a, b = _exponential(model, sample_time)
    held = replace(model, a=a, b=b, sample_time=sample_time)
    if not delay:
        return held
    whole, late = split_delay(delay / sample_time)
    require_memory("delay", whole * len(model.c), whole * len(model.c))
    if late:  # until the new input acts, that of the sample before does: it is a state
        after, new = _exponential(model, (1 - late) * sample_time)
        held = with_input_before(replace(held, b=new), after @ _exponential(model, late * sample_time)[1])
    return replace(
        delayed(held, whole),
        input_labels=model.input_labels,
        output_labels=model.output_labels,
        state_labels=(),
    )


def _exponential(model: StateModel, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and input matrix over a time in which the input is held."""
    n, m = model.b.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = model.a * time, model.b * time
    # Unbalanced, the exponential of a stiff motion system is silently wrong.
    balanced, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    held = linalg.expm(balanced) * scale[:, None] / scale
    return held[:n, :n], held[:n, n:]


@checked
def tustin(model: StateModel, sample_time: Positive, omega: float | None = None) -> StateModel:
    """Discretise by the bilinear rule, as controllers are.

    Parameters
    ----------
    model : StateModel
        In continuous time.
    sample_time : float
        Sample time, s.
    omega : float, optional
        rad/s; where the response stays exactly what it was.

    Returns
    -------
    StateModel
        In discrete time, with as many states.

    Raises
    ------
    InputError
        When the model is sampled already, or `omega` is not below half the sample rate.

    References
    ----------
    Franklin, Powell and Workman, Digital Control of Dynamic Systems (1998), chapter 6.

    Examples
    --------
    >>> integrator = lti.StateModel([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> lti.tustin(integrator, sample_time=0.1).d  # half a sample of its input at once
    array([[0.05]])
    """
    _require_continuous(model)
    rate = 2 / sample_time
    if omega is not None:
        require_number("omega", omega, above=0.0, below=np.pi / sample_time)
        rate = omega / np.tan(omega * sample_time / 2)
    inverse = np.linalg.inv(rate * np.eye(len(model.a)) - model.a)
    c = model.c @ inverse
    return StateModel(
        inverse @ (rate * np.eye(len(model.a)) + model.a),
        2 * rate * inverse @ model.b,
        c,
        model.d + c @ model.b,
        sample_time,
        model.input_labels,
        model.output_labels,
        model.state_labels,
    )


@checked
def tustin_sections(
    zeros: ArrayLike, poles: ArrayLike, gain: float, sample_time: Positive
) -> Float64[np.ndarray, "sections 6"]:
    """Second-order sections, as `scipy.signal.sosfilt` takes them, of a filter's zeros and poles (rad/s) and its gain."""
    zeros, poles = (
        require_array(name, value, ndim=1, dtype=complex)
        for name, value in (("zeros", zeros), ("poles", poles))
    )
    zeros, poles = (each if each.imag.any() else each.real for each in (zeros, poles))
    if len(zeros) > len(poles):
        raise InputError(
            f"zeros holds {len(zeros)} values for {pluralise(len(poles), 'pole')}; give at most as many"
        )
    with np.errstate(all="ignore"):  # a pole at twice the rate has no equivalent, which validation reports
        return scipy.signal.zpk2sos(*scipy.signal.bilinear_zpk(zeros, poles, gain, 1 / sample_time))


@checked
def prewarped(omega: Float64[np.ndarray, "..."], sample_time: Positive) -> Float64[np.ndarray, "..."]:
    """Frequencies that Tustin's rule takes to `omega` (rad/s): there a continuous controller responds like its rule.

    Beyond half of the sample rate, where a sampled response repeats itself, they repeat themselves, too.
    """
    return np.asarray(2 / sample_time * np.tan(omega * sample_time / 2))  # of a single one, too


@checked
def continuous_poles(poles: ArrayLike, sample_time: Positive) -> Complex128[np.ndarray, " states"]:
    """Discrete poles as a continuous model would have them (rad/s), without those of pure delays at 0."""
    poles = require_array("poles", poles, ndim=1, dtype=complex)
    return np.log(poles[np.abs(poles) > 1e-6]) / sample_time


def _require_continuous(model: StateModel) -> None:
    if model.sample_time:
        raise InputError("model is in discrete time already; give the continuous model")


@checked
def sampled_modes(
    frequencies: Float64[np.ndarray, " modes"],
    damping: Float64[np.ndarray, " modes"],
    sample_time: float,
    omega: Float64[np.ndarray, "... frequencies"],
    late: float = 0.0,
    drag: float = 0.0,
) -> Complex128[np.ndarray, "modes frequencies"]:
    """Force to position of each mode for itself (mass 1), sampled with a zero-order hold, in closed form.

    `omega` is the same for all modes, or holds a row for each. The force may begin `late` by a part of a sample, and
    what moves freely lose its speed at the rate `drag` (1/s).
    """
    return _at(_late(frequencies, damping, sample_time, late, drag), sample_time, omega, late)


@lru_cache(maxsize=64)
def _kept(frequencies: bytes, damping: bytes, sample_time: float, late: float, drag: float):
    """`_late` of modes by their bytes: a search needs the response of the same ones thousands of times."""
    return _late(np.frombuffer(frequencies), np.frombuffer(damping), sample_time, late, drag)


def _at(held, sample_time: float, omega: np.ndarray, late: float) -> np.ndarray:
    """Response of modes at `omega` from what `_late` made of them."""
    blocks, gains, old = held
    # The trace near 2 and the determinant near 1 cancel at low frequencies: write them as differences from 1.
    lifted = np.exp(1j * omega * sample_time) - 1
    first, second = blocks[:, 0, 0, None] - 1, blocks[:, 1, 1, None] - 1
    cross = blocks[:, 0, 1, None] * blocks[:, 1, 0, None]
    determinant = lifted**2 - lifted * (first + second) + first * second - cross
    position, velocity = gains[:, :1], gains[:, 1:]
    if late:
        before = np.exp(-1j * omega * sample_time)
        position, velocity = position + before * old[:, :1], velocity + before * old[:, 1:]
    return ((lifted - second) * position + blocks[:, 0, 1, None] * velocity) / determinant


@checked
def zoh_response(
    model: ModalModel, sample_time: float, omega: Float64[np.ndarray, " frequencies"], late: float = 0.0
) -> Complex128[np.ndarray, "outputs inputs frequencies"]:
    """Response of the zero-order-hold equivalent, mode by mode in closed form; the force `late` as in `late_modes`."""
    residues = model.output_shapes[:, None, :] * model.input_shapes.T[None]
    held = _kept(model.frequencies.tobytes(), model.damping.tobytes(), sample_time, late, model.drag)
    return residues @ _at(held, sample_time, omega, late) + model.feedthrough[:, :, None]
