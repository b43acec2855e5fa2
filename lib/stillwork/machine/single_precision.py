"""A controller in float32: rounded coefficients, its recursion, and a form with small rounding errors."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.control.digital import DigitalController, without_dead_states
from stillwork.lti.norms import solve_lyapunov
from stillwork.lti.state_space import StateModel

HOLDS = 0.5  # a state whose own coefficient is larger changes by little: it is summed up, the others are set
LOST_LITTLE = 2e-6  # of the output's rms: another form is not looked for
LOST_MOST = 1e-3  # likewise: more is refused; 0.009 dB of a peak
SAMPLES = 4096  # that are run
GROWTH = 1e6  # of an unstable controller's states meanwhile, at most
SLOW = 1000.0  # samples, time constant of half of what is given to it
APART = 1e8  # condition of the eigenvectors of a form by modes, at most
CONTRACTED = 1 - 1e-6  # for balancing, which cannot treat an integrator


class InSinglePrecision(NamedTuple):
    """A controller in the form that is written for float32."""

    controller: DigitalController
    form: str
    error: float  # rms of what float32 changes at the output over the output's rms
    rounded: StateModel  # from the inputs to the outputs, with the coefficients that float32 holds


@checked(infinite=True)
def in_single_precision(controller: DigitalController) -> InSinglePrecision:
    """The form of a controller that suits float32: its own if accurate enough, else modal or balanced.

    Each is run in float32 and in double precision, as in the C code: states that change slowly are summed up
    with their rounding errors. The controller is the same without and at a limit: the states follow the applied output
    by the same gain.

    Parameters
    ----------
    controller : DigitalController

    Returns
    -------
    InSinglePrecision

    Raises
    ------
    InputError
        When each form has an error of more than a thousandth of the output.
    """
    found = []
    for form, made in (("as designed", _as_it_is), ("by its modes", by_modes), ("balanced", balanced_form)):
        trial = made(controller)
        if trial is not None:
            found.append(InSinglePrecision(trial, form, rounding_error(trial), _rounded(trial)))
            if found[-1].error <= LOST_LITTLE:
                break
    best = min(found, key=lambda each: each.error)
    if not best.error <= LOST_MOST:
        raise InputError(
            f"precision: in single precision the error of the output is {best.error:.1e} of it ({best.form}); use double"
        )
    return best


@checked(infinite=True)
def rounding_error(controller: DigitalController) -> float:
    """Rms error of the outputs in float32 over their rms, for as many samples of white and slow noise."""
    exact, single = (_coefficients(controller, each) for each in (np.float64, np.float32))
    inputs, samples = len(controller.inputs), _samples(controller)
    white = np.random.default_rng(1).standard_normal((2, samples, inputs))
    slow = np.zeros((samples, inputs))
    for k in range(1, samples):
        slow[k] = slow[k - 1] * (1 - 1 / SLOW) + white[1, k] * np.sqrt(2 / SLOW)
    given = (white[0] + slow).astype(np.float32)
    wanted, found = _run(*exact, given.astype(float)), _run(*single, given)
    size = wanted.std(axis=0)
    left = (found - wanted).std(axis=0)
    return float(np.max(np.divide(left, size, out=np.zeros_like(size), where=size > 0), initial=0.0))


def _samples(controller: DigitalController) -> int:
    radius = max(np.abs(controller.linear.poles), default=0.0)
    return SAMPLES if radius <= 1 + 1e-9 else int(np.clip(np.log(GROWTH) / np.log(radius), 16, SAMPLES))


@checked
def kept_states(controller: DigitalController) -> np.ndarray:
    """Mask of the states that are summed up."""
    return np.diag(controller.model.a) > HOLDS


def _coefficients(controller: DigitalController, precision) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    m = controller.model
    keeps = kept_states(controller).astype(float)
    arrays = np.hstack([m.a - np.diag(keeps), m.b]), np.hstack([m.c, m.d[:, : len(controller.inputs)]]), keeps
    with np.errstate(over="ignore"):
        rows, outputs, kept = (array.astype(precision) for array in arrays)
    for exact, each in zip(arrays, (rows, outputs, kept), strict=True):
        if not np.all(np.isfinite(each)):
            size = float(exact[~np.isfinite(each)][0])
            raise InputError(f"{size:g} is beyond the range of single precision; use another unit, or double")
    return rows, outputs, kept


def _run(rows: np.ndarray, outputs: np.ndarray, keeps: np.ndarray, given: np.ndarray) -> np.ndarray:
    """The recursion of the C in the precision of its arrays, no limit acting."""
    states, back = len(keeps), rows.shape[1] - outputs.shape[1]
    x, rest = np.zeros(states, rows.dtype), np.zeros(states, rows.dtype)
    found = np.empty((len(given), len(outputs)))
    for k, e in enumerate(given):
        together = np.concatenate([x, e])
        found[k] = command = outputs @ together
        kept = keeps * x
        step = rows @ (np.concatenate([together, command]) if back else together) + rest
        x = kept + step
        rest = step - (x - kept)
    return found


def _rounded(controller: DigitalController) -> StateModel:
    """From the inputs to the outputs with the coefficients that float32 holds."""
    rows, outputs, keeps = (
        coefficient.astype(float) for coefficient in _coefficients(controller, np.float32)
    )
    n, inputs = len(keeps), len(controller.inputs)
    a, b, back = rows[:, :n] + np.diag(keeps), rows[:, n : n + inputs], rows[:, n + inputs :]
    c, d = outputs[:, :n], outputs[:, n:]
    if back.size:
        a, b = a + back @ c, b + back @ d
    return StateModel(a, b, c, d, controller.model.sample_time)


def _as_it_is(controller: DigitalController) -> DigitalController:
    return without_dead_states(controller)


def _folded(controller: DigitalController) -> DigitalController:
    """Fed back by the commanded output; the part that a limit removes is fed back beside it, by the same gain."""
    winds = controller.anti_windup + controller._back
    return without_dead_states(replace(controller, model=controller.linear, anti_windup=winds))


@checked(infinite=True)
def by_modes(controller: DigitalController) -> DigitalController | None:
    """Each real pole a state, each pair a turn of two; None if two of them are nearly equal."""
    folded = _folded(controller)
    m = folded.model
    if not len(m.a):
        return None
    a, (scale, _) = linalg.matrix_balance(m.a, permute=False, separate=True)
    poles, vectors = linalg.eig(a)
    columns, blocks = [], []
    for k in np.argsort(np.abs(poles - 1)):
        if poles[k].imag == 0:
            columns.append(vectors[:, k].real)
            blocks.append(poles[k : k + 1].real[None])
        elif poles[k].imag > 0:
            columns += [vectors[:, k].real, vectors[:, k].imag]
            blocks.append(poles[k].real * np.eye(2) + poles[k].imag * np.array([[0.0, 1.0], [-1.0, 0.0]]))
    into = np.array(columns).T
    if np.linalg.cond(into) > APART:
        return None
    return _turned(folded, scale[:, None] * into, np.linalg.inv(into) / scale, linalg.block_diag(*blocks))


@checked(infinite=True)
def balanced_form(controller: DigitalController) -> DigitalController | None:
    """Balanced realisation: each state is as controllable as observable; None if unstable."""
    folded = _folded(controller)
    m = folded.model
    if not len(m.a) or np.abs(m.poles).max() * CONTRACTED >= 1:
        return None
    a, (scale, _) = linalg.matrix_balance(m.a, permute=False, separate=True)
    b, c = m.b / scale[:, None], m.c * scale
    left, right = (
        _root(solve_lyapunov(CONTRACTED * each, power, discrete=True))
        for each, power in ((a, b @ b.T), (a.T, c.T @ c))
    )
    u, sizes, vt = np.linalg.svd(right.T @ left)
    if not sizes[-1] > 0:
        return None
    into, back = left @ vt.T / np.sqrt(sizes), (u / np.sqrt(sizes)).T @ right.T
    return _turned(folded, scale[:, None] * into, back / scale)


def _root(power: np.ndarray) -> np.ndarray:
    sizes, vectors = np.linalg.eigh((power + power.T) / 2)
    return vectors * np.sqrt(np.maximum(sizes, np.finfo(float).eps * sizes[-1]))


def _turned(
    controller: DigitalController, into: np.ndarray, back: np.ndarray, a: np.ndarray | None = None
) -> DigitalController:
    """The same in other states, x = into z; each so large that its inputs are about 1."""
    m = controller.model
    a = back @ m.a @ into if a is None else a
    size = max(float(np.abs(back @ m.b).max()), np.finfo(float).tiny)
    into, back = into * size, back / size
    model = replace(m, a=a, b=back @ m.b, c=m.c @ into)
    return replace(controller, model=model, anti_windup=back @ controller.anti_windup)
