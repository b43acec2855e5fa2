"""H2 and H-infinity norms of models in continuous and discrete time."""

import warnings

import numpy as np
from jaxtyping import Float64
from scipy import linalg

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.lti.peaks import Peak
from stillwork.lti.state_space import StateModel, unit_of

# A gain this far below |B| |C|, in slow time and balanced, is the rounding of a model that passes nothing.
NOTHING = 1e-15
TOLERANCE = 1e-10  # of the H-infinity norm, relative
GRID = 200  # frequencies at which a model that no pole lifts above its feedthrough is looked at first
HIDDEN = (
    1e-10  # of (|B| |C|)^2: a rounding above it may hide a power, and what seems to pass nothing is refused
)
MAX_UNCERTAINTY = 1e-6  # of the power that a Lyapunov equation gives, relative
APART = 1e-3  # by which the power may differ, relative, where the dual equation gives it
MOST_SPREAD = 1e-4  # of the H-infinity norm: by how much it may move with the rounding of A


@checked
def hinf_norm(model: StateModel) -> Peak:
    """H-infinity norm of a stable model, and its frequency, by the eigenvalues of a Hamiltonian.

    No frequency grid: a level is exceeded exactly when the Hamiltonian has imaginary eigenvalues there. A model in
    discrete time is taken to continuous time by the bilinear transformation, which keeps the norm.

    Parameters
    ----------
    model : StateModel

    Returns
    -------
    Peak
        `magnitude`, and the `omega` (rad/s) at which it is reached; where the gain only approaches it
        towards infinity, one at which it is within the accuracy of the norm, 1e-10.

    Raises
    ------
    InputError
        When the model is unstable, or too ill-conditioned for its rounding to be harmless.

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
    if not model.is_stable:
        raise InputError("model must be stable for this norm")
    if model.sample_time:
        peak = hinf_norm(to_bilinear(model))
        return Peak(peak.magnitude, float(2 * np.arctan(peak.omega) / model.sample_time))
    if not (np.any(model.b) and np.any(model.c)):
        return Peak(_finite(float(np.linalg.norm(model.d, 2))) if model.d.size else 0.0, 0.0)
    units, rate, a, b, c = _balanced(model)
    b, d = b / rate, model.d / units[0] / units[1]
    _finite(np.abs(d).max())
    sizes = np.linalg.norm(b), np.linalg.norm(c)
    size = np.sqrt(sizes[0] / sizes[1]) if all(sizes) else 1.0
    whole = unit_of(np.array([[sizes[0] * sizes[1], np.linalg.norm(d)]]))  # the Hamiltonian squares gains
    b, c, d = b / size / np.sqrt(whole), c * size / np.sqrt(whole), d / whole
    scaled = StateModel(a, b, c, d)

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
        middle = np.sqrt(crossings[:-1] * crossings[1:])  # none is 0: the level is above the gain there
        values = gains(middle)
        if values.max() <= raised:
            break
        level, where = values.max(), middle[values.argmax()]
    if passes:
        _require_harmless(scaled, np.append(resonances, where), level)
    return Peak(_finite(level * whole * units[0] * units[1]), float(where * rate))


@checked
def to_bilinear(model: StateModel) -> StateModel:
    """The continuous model with the response at s = (z - 1) / (z + 1) that a discrete one has at z.

    It keeps stability and the H-infinity norm, and each controller of the one is one of the other. `tustin` goes back, for
    a model whose s counts in half the rate.
    """
    shifted = np.eye(len(model.a)) + model.a
    if np.any(np.abs(1 + model.poles) < 1e-13):
        raise InputError("model has a pole at z = -1, half of the rate; shift it a little")
    a, b = np.linalg.solve(shifted, model.a - np.eye(len(model.a))), np.linalg.solve(shifted, model.b)
    return StateModel(
        a, np.sqrt(2) * b, np.sqrt(2) * np.linalg.solve(shifted.T, model.c.T).T, model.d - model.c @ b
    )


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
    uncertainty = 2 * np.finfo(float).eps * sizes(np.abs(left) @ np.abs(model.a) @ np.abs(right))
    worst = max(np.max(sizes(model.d + left @ model.b) + uncertainty) - level, uncertainty[-1])
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


def _balanced(model: StateModel, in_slow_time: bool = True):
    """Units of B and C, the rate of the fastest pole, A in slow time, and B and C in these units; balanced."""
    units = unit_of(model.b), unit_of(model.c)
    rate = np.abs(model.poles).max() if in_slow_time else 1.0
    a, (scale, _) = linalg.matrix_balance(model.a / rate, permute=False, separate=True)
    return units, rate, a, model.b / units[0] / scale[:, None], model.c / units[1] * scale


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


def _passes_nothing(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> bool:
    """Whether every Markov parameter, C A^k B, is zero but for its rounding."""
    carried, sizes = b, np.abs(b)
    for _ in range(len(a)):
        if not np.all(np.abs(c @ carried) <= 4 * len(a) * np.finfo(float).eps * (np.abs(c) @ sizes)):
            return False
        carried, sizes = a @ carried, np.abs(a) @ sizes
    return True


@checked
def solve_lyapunov(
    a: Float64[np.ndarray, "states states"],
    q: Float64[np.ndarray, "states states"],
    *,
    discrete: bool = False,
) -> Float64[np.ndarray, "states states"]:
    """X of A X + X A' + Q = 0, or of A X A' - X + Q = 0; the caller bounds its error, so that scipy need not warn."""
    with warnings.catch_warnings(action="ignore"):
        return linalg.solve_discrete_lyapunov(a, q) if discrete else linalg.solve_continuous_lyapunov(a, -q)


@checked
def h2_norm(model: StateModel) -> float:
    """H2 norm of a stable model, in continuous time a strictly proper one: from a balanced Lyapunov equation, checked.

    Parameters
    ----------
    model : StateModel

    Returns
    -------
    float
        Square root of the output's variance under white noise of unit intensity on every input; in discrete time
        under independent numbers of unit variance.

    Raises
    ------
    InputError
        When the model is unstable, has feedthrough in continuous time, or the equation is too ill-conditioned: in discrete
        time for example by a double pole nearer to z = 1 than some 0.002, or a triple one nearer than 0.02, in companion
        form, where the rounding of the coefficients alone moves the squared norm by 1e-6.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), chapters 4 and 21.

    Examples
    --------
    >>> lag = lti.StateModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> round(lti.h2_norm(lag) ** 2, 6)  # variance under white noise of unit intensity
    0.5
    >>> lag = lti.StateModel([[0.5]], [[1.0]], [[1.0]], [[0.0]], sample_time=1.0)
    >>> round(lti.h2_norm(lag) ** 2, 6)  # 1 + 1/4 + 1/16 + ...
    1.333333
    """
    discrete = model.sample_time > 0
    if not model.is_stable or (np.any(model.d) and not discrete):
        raise InputError("model must be stable for this norm, and strictly proper in continuous time")
    direct = float(np.linalg.norm(model.d))
    if not (np.any(model.b) and np.any(model.c)):
        return direct
    units, power, uncertainty, nothing = _squared(model)
    if nothing:
        return direct
    if not uncertainty <= MAX_UNCERTAINTY * power:
        raise InputError(
            f"the Lyapunov equation leaves an uncertainty of {uncertainty:.1e} in a squared norm of {power:.1e} (scaled); the "
            "model is too close to instability, or needs other units"
        )
    return _finite(np.hypot(np.sqrt(power) * units[0] * units[1], direct))


@checked
def rough_h2_norm(model: StateModel) -> tuple[float, float]:
    """H2 norm of a stable, strictly proper model, however few of its digits are known, and what it does not exceed."""
    units, power, uncertainty, _ = _squared(model)
    size = units[0] * units[1]
    return _finite(np.sqrt(max(power, 0.0)) * size), _finite(np.sqrt(abs(power) + uncertainty) * size)


def _squared(model: StateModel) -> tuple[tuple[float, float], float, float, bool]:
    """Units of B and C, the squared norm in these without D, its uncertainty, and whether the model's response is zero."""
    discrete = model.sample_time > 0
    units, rate, a, b, c = _balanced(model, in_slow_time=not discrete)
    b = b / np.sqrt(rate)
    gramian, dual = (solve_lyapunov(*each, discrete=discrete) for each in ((a, b @ b.T), (a.T, c.T @ c)))
    power = float(np.trace(c @ gramian @ c.T))
    # What cancels on the way is known to its rounding alone.
    rounding = 4 * len(a) * np.finfo(float).eps * float(np.trace(np.abs(c) @ np.abs(gramian) @ np.abs(c).T))
    # Both equations give the power, by other roundings; what the solver left of one is a power, too, in more digits.
    wide, x, drive = (each.astype(np.longdouble) for each in (a, gramian, b))
    moving = wide @ x @ wide.T - x if discrete else wide @ x + x @ wide.T
    left = float(np.sum(dual * (moving + drive @ drive.T)))
    apart = abs(power - float(np.trace(b.T @ dual @ b))), abs(left)
    hidden = HIDDEN * float(np.linalg.norm(b) * np.linalg.norm(c)) ** 2
    if max(abs(power), *apart) <= rounding <= hidden and _passes_nothing(a, b, c):
        return units, 0.0, 0.0, True
    # The equation is solved for an A that is a rounding away from ours, E: to first order the power moves by
    # 2 tr(Y E X), in discrete time by 2 tr(Y E X A').
    if discrete:  # each number by itself: in skew states the solver loses more than the norms indicate
        moved = float(np.sum(np.abs(a).T * (np.abs(gramian) @ np.abs(a.T) @ np.abs(dual))))
    else:
        moved = np.linalg.norm(a, 2) * np.linalg.norm(gramian @ dual)
    uncertainty = max(2 * np.finfo(float).eps * moved, rounding, min(apart))
    # To first order no longer, where that moves a pole as far as it lies from the edge of stability. A multiple pole has
    # no such order: there a Lyapunov matrix decides.
    poles, left, right = linalg.eig(a, left=True)
    moved = np.finfo(float).eps * np.sum(np.abs(left) * (np.abs(a) @ np.abs(right)), axis=0)
    far = np.abs(np.sum(left.conj() * right, axis=0)) * (1 - np.abs(poles) if discrete else -poles.real)
    unsure = np.any(moved > far) and not _stays_stable(a, discrete)
    if unsure or max(apart) > APART * power:
        uncertainty = max(uncertainty, abs(power))
    return units, power, uncertainty, False


def _stays_stable(a: np.ndarray, discrete: bool) -> bool:
    """Whether all matrices A + E, E the rounding of A, are stable by one Lyapunov matrix.

    With X of A X + X A' = -I it is enough that E X + X E' stays far below I. Hinrichsen and Pritchard, Mathematical Systems
    Theory I (2005), section 5.3.
    """
    one = np.eye(len(a))
    x = solve_lyapunov(a, one, discrete=discrete)
    left = a @ x @ a.T - x + one if discrete else a @ x + x @ a.T + one
    moved, size = 4 * np.finfo(float).eps * np.linalg.norm(a), np.linalg.norm(x, 2)
    lost = (2 * np.linalg.norm(a, 2) + moved if discrete else 2.0) * moved * size
    return bool(np.linalg.eigvalsh((x + x.T) / 2)[0] > 0 and np.linalg.norm(left, 2) + lost < 0.1)
