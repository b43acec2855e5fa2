"""H2 and H-infinity norms of continuous models."""

import numpy as np
from scipy import linalg

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.lti.peaks import Peak
from stillwork.lti.state_space import StateModel

# A gain this far below |B| |C|, in slow time and balanced, is the rounding of a model that passes nothing.
NOTHING = 1e-15
TOLERANCE = 1e-10  # of the H-infinity norm, relative
GRID = 200  # frequencies at which a model that no pole lifts above its feedthrough is looked at first
MOST_DOUBT = 1e-6  # of the power that a Lyapunov equation gives, relative
MOST_SPREAD = 1e-4  # of the H-infinity norm: by how much it may move with the rounding of A


@checked
def hinf_norm(model: StateModel) -> Peak:
    """H-infinity norm of a stable continuous model, and its frequency, by the eigenvalues of a Hamiltonian.

    No frequency grid: a level is exceeded exactly when the Hamiltonian has imaginary eigenvalues there.

    Parameters
    ----------
    model : StateModel

    Returns
    -------
    Peak
        `magnitude`, and the `omega` (rad/s) at which it is reached; where the gain only approaches it
        towards infinity, one at which it is as near as the norm is exact, 1e-10.

    Raises
    ------
    InputError
        When the model is unstable or in discrete time, or too ill-conditioned for its rounding to be harmless.

    References
    ----------
    Boyd and Balakrishnan, Systems & Control Letters 15 (1990); Bruinsma and Steinbuch, ibid. 14 (1990).

    Examples
    --------
    >>> mode = lti.ModalModel([100.0], [0.01], [[1.0]], [[1.0]], [[0.0]])
    >>> peak = lti.hinf_norm(mode.state_space())
    >>> round(peak.magnitude * 100.0**2, 2)  # times the static compliance: 1 / (2 zeta)
    50.0
    """
    if model.sample_time or not model.is_stable:
        raise InputError("model must be stable and in continuous time for this norm")
    if not (np.any(model.b) and np.any(model.c)):
        return Peak(_finite(float(np.linalg.norm(model.d, 2))) if model.d.size else 0.0, 0.0)
    units, rate, a, b, c = _balanced(model)
    b, d = b / rate, model.d / units[0] / units[1]
    _finite(np.abs(d).max())
    size = np.sqrt(np.linalg.norm(b) / np.linalg.norm(c)) if np.any(b) and np.any(c) else 1.0
    scaled = StateModel(a, b / size, c * size, d)

    def gains(omega: np.ndarray) -> np.ndarray:
        return np.linalg.norm(np.moveaxis(scaled.frequency_response(omega), -1, 0), ord=2, axis=(1, 2))

    resonances = start = np.concatenate([[0.0], np.abs(scaled.poles), np.abs(scaled.poles.imag)])
    values, ends = gains(start), np.linalg.norm(d, 2)
    level, where = values.max(), start[values.argmax()]
    # Near the size of the feedthrough the Hamiltonian loses the crossings, which move to infinity. There the model is
    # seen from the other end: as a function of 1 / s, whose feedthrough is the smaller static gain.
    turned = ends > level
    if turned:
        slow, fast = np.abs(scaled.poles).min(), np.abs(scaled.poles).max()
        start = np.append(np.geomspace(1e-3 * slow, 1e3 * fast, GRID), fast * np.array([1e6, 1e8, 1e10]))
        values = gains(start)
        level = max(values.max(), ends)
        where = start[np.argmax(values >= (1 - TOLERANCE) * level)]
    seen = _turned(scaled) if turned else scaled
    passes = level > NOTHING * np.linalg.norm(b) * np.linalg.norm(c)
    for _ in range(60 if passes else 0):
        raised = (1 + 2 * TOLERANCE) * level
        crossings = _crossings(seen, raised)
        if turned:
            crossings = 1 / crossings[crossings > 0][::-1]
        if len(crossings) < 2:
            break
        middle = (
            np.sqrt(crossings[:-1] * crossings[1:])
            if crossings[0] > 0
            else (crossings[:-1] + crossings[1:]) / 2
        )
        values = gains(middle)
        if values.max() <= raised:
            break
        level, where = values.max(), middle[values.argmax()]
    if passes:
        _require_harmless(scaled, np.append(resonances, where), level)
    return Peak(_finite(level * units[0] * units[1]), float(where * rate))


def _require_harmless(model: StateModel, omega: np.ndarray, level: float) -> None:
    """Refuse a model that may, with A a rounding away from its own, exceed the level at one of these frequencies.

    With A + E, C (sI - A)^-1 B moves by C (sI - A)^-1 E (sI - A)^-1 B to first order.
    """
    n = len(model.a)
    inverse = np.linalg.inv(1j * omega[:, None, None] * np.eye(n) - model.a)
    left, right = model.c @ inverse, inverse @ model.b

    def sizes(matrices: np.ndarray) -> np.ndarray:
        return np.linalg.norm(matrices, 2, axis=(1, 2))

    # Each number of A by itself: its zeros and ones are exact.
    doubt = 2 * np.finfo(float).eps * sizes(np.abs(left) @ np.abs(model.a) @ np.abs(right))
    worst = max(np.max(sizes(model.d + left @ model.b) + doubt) - level, doubt[-1])
    if not worst <= MOST_SPREAD * level:
        raise InputError(
            f"model leaves an uncertainty of {worst:.1e} in a norm of {level:.1e} (scaled) by the "
            "rounding of its numbers; it is too close to instability, or needs other states or units"
        )


def _turned(model: StateModel) -> StateModel:
    """The model as a function of 1 / s."""
    inverse = np.linalg.inv(model.a)
    static = model.d - model.c @ inverse @ model.b
    return StateModel(inverse, -inverse @ model.b, model.c @ inverse, static)


def _balanced(model: StateModel):
    """Units of B and C, the rate of the fastest pole, A in slow time, and B and C in these units; balanced."""
    units = _unit(model.b), _unit(model.c)
    rate = np.abs(model.poles).max()
    a, (scale, _) = linalg.matrix_balance(model.a / rate, permute=False, separate=True)
    return units, rate, a, model.b / units[0] / scale[:, None], model.c / units[1] * scale


def _unit(matrix: np.ndarray) -> float:
    """A power of two beside the largest element, where its square would leave the range of numbers; else 1."""
    largest = np.abs(matrix).max()
    return 1.0 if 1e-60 < largest < 1e60 else float(2.0 ** np.frexp(largest)[1])


def _finite(norm: float) -> float:
    if not np.isfinite(norm):
        raise InputError(
            "model has a norm beyond the range of numbers; use other units for inputs or outputs"
        )
    return float(norm)


def _crossings(model: StateModel, level: float) -> np.ndarray:
    """Frequencies where a singular value equals `level`: imaginary eigenvalues of the Hamiltonian."""
    a, b, c, d = model.a, model.b, model.c, model.d
    r = level**2 * np.eye(d.shape[1]) - d.T @ d
    feed = np.linalg.solve(r, d.T @ c)
    upper = a + b @ feed
    q = c.T @ (c + d @ feed)
    hamiltonian = np.block([[upper, b @ np.linalg.solve(r, b.T)], [-q, -upper.T]])
    values = linalg.eigvals(hamiltonian)
    imaginary = np.abs(values.real) < 1e-8 * np.maximum(np.abs(values), 1e-8)
    return np.unique(np.abs(values[imaginary].imag))


@checked
def h2_norm(model: StateModel) -> float:
    """H2 norm of a stable, strictly proper continuous model: from a balanced Lyapunov equation, checked.

    Parameters
    ----------
    model : StateModel

    Returns
    -------
    float
        Square root of the output's variance under white noise of unit intensity on every input.

    Raises
    ------
    InputError
        When the model is unstable, has feedthrough, or the equation is too ill-conditioned to trust.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), chapter 4.

    Examples
    --------
    >>> lag = lti.StateModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> round(lti.h2_norm(lag) ** 2, 6)  # variance under white noise of unit intensity
    0.5
    """
    if model.sample_time or not model.is_stable or np.any(model.d):
        raise InputError("model must be stable, strictly proper and in continuous time for this norm")
    if not (np.any(model.b) and np.any(model.c)):
        return 0.0
    units, rate, a, b, c = _balanced(model)
    b = b / np.sqrt(rate)
    driven = b @ b.T
    gramian = linalg.solve_continuous_lyapunov(a, -driven)
    # That of a model that passes nothing may round below zero.
    power = max(np.trace(c @ gramian @ c.T), 0.0)
    kept = MOST_DOUBT * power + NOTHING * np.linalg.norm(c) ** 2 * np.linalg.norm(gramian)
    # The equation is solved for an A that is a rounding away from ours, E: to first order the power moves by 2 tr(Y E X).
    dual = linalg.solve_continuous_lyapunov(a.T, -c.T @ c)
    doubt = 2 * np.finfo(float).eps * np.linalg.norm(a, 2) * np.linalg.norm(gramian @ dual)
    if not doubt <= kept:
        raise InputError(
            f"the Lyapunov equation leaves a doubt of {doubt:.1e} in a squared norm of {power:.1e} (scaled); the model "
            "is too close to instability, or needs other units"
        )
    return _finite(np.sqrt(power) * units[0] * units[1])
