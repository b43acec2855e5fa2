"""H2-optimal controllers and observers of a generalised plant, by two scaled Riccati equations.

They need a regular problem: every control has a cost, and every measurement has noise. If a plant lacks these, a
small cost and a small noise are added; the result is checked by the norm of the original plant's loop, computed independently.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.bounds import NonNegative
from stillwork.base.checks import InputError, require_array
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.estimation.h2_discrete import discrete_h2, require_promised
from stillwork.estimation.riccati import continuous_gain
from stillwork.lti.generalised_plant import GeneralisedPlant
from stillwork.lti.norms import h2_norm, rough_h2_norm
from stillwork.lti.scaling import state_scale
from stillwork.lti.state_space import StateModel


@by_value
@dataclass(frozen=True)
class H2Synthesis:
    """A controller, or an observer where the controls are estimates, and the two-norms of its loop.

    Attributes
    ----------
    controller : StateModel
        From the measurements y to the controls u, in continuous time strictly proper.
    regular_norm : float
        H2 norm of the regularised plant's loop, computed on the closed loop.
    norm : float
        H2 norm of the loop of the original problem, without the added cost and noise.
    claimed : float
        The synthesis's own value for the regularised loop: its optimum, or a bound of it.
    status : str
        Status of the solver.

    Raises
    ------
    InputError
        When a norm is below zero.

    References
    ----------
    Zhou, Doyle and Glover, Robust and Optimal Control (1996), chapter 14.

    Examples
    --------
    >>> model = lti.StateModel([[-1.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]])
    >>> found = estimation.h2_riccati(lti.GeneralisedPlant(model, exogenous=2, performance=2))
    >>> bool(abs(found.norm - found.claimed) < 1e-9)  # nothing was added
    True
    """

    controller: StateModel  # from y to u
    regular_norm: NonNegative  # H2 norm of the regularised loop, recomputed on the closed loop
    norm: NonNegative  # H2 norm of the loop as it was posed
    claimed: NonNegative  # the synthesis's own value for the regularised loop
    status: str = "solved"

    def __post_init__(self):
        check_fields(self)


@checked
def regularised(
    plant: GeneralisedPlant, effort: float | ArrayLike, noise: float | ArrayLike
) -> GeneralisedPlant:
    """Add `effort` times every control to the performance, and white noise to every measurement.

    The effort is in performance units per unit of control, the noise the root of an intensity; they may be zero where
    D12 has full column rank and D21 full row rank.
    """
    a, b1, b2, c1, c2, d11, d12, d21, d22 = plant.blocks
    if np.any(d11) and not plant.model.sample_time:
        raise InputError("the plant has feedthrough from w to z; its H2 norm is infinite, add a low-pass")
    if not len(a):
        raise InputError("plant has no states; there is nothing to control")
    controls, measurements = b2.shape[1], len(c2)
    effort = _each("effort", effort, controls, "control")
    noise = _each("noise", noise, measurements, "measurement")
    z, w = len(c1), b1.shape[1]
    d = np.block(
        [
            [d11, np.zeros((z, measurements)), d12],
            [np.zeros((controls, w + measurements)), np.diag(effort)],
            [d21, np.diag(noise), d22],
        ]
    )
    b = np.hstack([b1, np.zeros((len(a), measurements)), b2])
    c = np.vstack([c1, np.zeros((controls, len(a))), c2])
    model = StateModel(a, b, c, d, plant.model.sample_time)
    regular = GeneralisedPlant(model, w + measurements, z + controls)
    *_, d12, d21, _ = regular.blocks
    for name, matrix in (("effort", d12.T), ("noise", d21)):
        lengths = np.linalg.norm(matrix, axis=1)[:, None]
        if not np.all(lengths) or np.linalg.matrix_rank(matrix / lengths) < len(matrix):
            raise InputError(f"effort and noise must make the problem regular; it takes more {name}")
    return regular


def _each(name: str, value: float | ArrayLike, count: int, what: str) -> np.ndarray:
    """One number for each of so many, not below zero."""
    given = require_array(name, value)
    if given.shape not in ((), (count,)):
        raise InputError(f"{name} has shape {given.shape}; give a number, or one for each {what}: {count}")
    if np.any(given < 0):
        raise InputError(f"{name} is negative; effort and noise make the problem regular from zero upwards")
    return np.broadcast_to(given, (count,))


@checked
def h2_riccati(
    plant: GeneralisedPlant, effort: float | ArrayLike = 0.0, noise: float | ArrayLike = 0.0
) -> H2Synthesis:
    r"""Controller u = K y with the smallest H2 norm from w to z, from two Riccati equations.

    They are scaled before and checked after: the cost of full information and that of estimating, each from its own
    half of the solution, must add up to the norm of the closed loop. A plant is regular, and needs neither `effort` nor
    `noise`, where :math:`D_{12}` has full column rank and :math:`D_{21}` full row rank. They may share what drives the
    states and what is controlled (correlated noise, products of state and control), and :math:`D_{22}` is free.

    Parameters
    ----------
    plant : GeneralisedPlant
        It may be unstable. In continuous time without feedthrough from w to z; in discrete time the controller has
        feedthrough: it uses the measurement of its own sample.
    effort : float or array_like, shape (controls,)
        An additional performance output for every control: this factor times the control, in units of z per unit of u.
    noise : float or array_like, shape (measurements,)
        Additional white noise in every measurement: the root of its intensity, in units of y times a root of s; in discrete
        time its standard deviation.

    Returns
    -------
    H2Synthesis
        Its `norm` is that of the plant as given, `regular_norm` that with effort and noise, which is the smallest.

    Raises
    ------
    InputError
        When the problem is not regular, has no stabilising solution, or only an inaccurate one.

    References
    ----------
    Doyle, Glover, Khargonekar and Francis, IEEE Transactions on Automatic Control 34 (1989), 831-847; Zhou, Doyle and
    Glover, Robust and Optimal Control (1996), chapter 14.

    Examples
    --------
    A mass of 1 kg that white noise of unit intensity pushes; its position counts, and is measured with noise.

    >>> mass = lti.StateModel([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0], [1, 0]], np.zeros((2, 2)))
    >>> plant = lti.GeneralisedPlant(mass, exogenous=1, performance=1)
    >>> found = estimation.h2_riccati(plant, effort=0.01, noise=0.001)
    >>> found.controller.c.shape, plant.close(found.controller).is_stable
    ((1, 2), True)
    >>> round(1e3 * found.norm, 1)  # mm, the root of the position's variance
    32.3
    """
    regular = regularised(plant, effort, noise)
    if plant.model.sample_time:
        controller, claimed = discrete_h2(regular)
        achieved = require_promised(regular.close(controller), claimed)
        return H2Synthesis(controller, achieved, checked_h2_norm(plant.close(controller)), claimed)
    scaled, units = scaled_plant(regular)
    a, b1, b2, c1, c2, d11, d12, d21, d22 = scaled.blocks
    gain = _filter_gain(a, b1, c2, d21)
    feedback = _filter_gain(a.T, c1.T, b2.T, d12.T).T
    driven = StateModel(a - b2 @ feedback, b1, c1 - d12 @ feedback, d11)
    missed = StateModel(a - gain @ c2, b1 - gain @ d21, d12 @ feedback, np.zeros_like(d11))
    claimed = float(np.hypot(checked_h2_norm(driven), checked_h2_norm(missed)))
    core = a - b2 @ feedback - gain @ c2 + gain @ d22 @ feedback
    controller = in_units(units, core, gain, -feedback)
    return verified(plant, regular, controller, claimed, "solved", WORST_SEPARATION)


# A scaled pair of Riccati equations leaves 1e-8 at worst; the norms of unbalanced loops scatter above that.
WORST_SEPARATION = 1e-5


@checked
def verified(
    plant: GeneralisedPlant,
    regular: GeneralisedPlant,
    controller: StateModel,
    claimed: float,
    status: str,
    tolerance: float,
) -> H2Synthesis:
    """A controller with its norms; `InputError` when its loop does not have the norm that its synthesis gives."""
    loop = regular.close(controller)
    achieved = checked_h2_norm(loop) if loop.is_stable else np.inf
    _, b1, _, c1, *_ = scaled_plant(regular)[0].blocks
    scale = float(np.linalg.norm(b1) * np.linalg.norm(c1))
    # A norm is the root of a sum that is known to rounding units: near zero to the root of these.
    rounding, gap = 4 * np.sqrt(np.finfo(float).eps), abs(achieved - claimed)
    allowed = tolerance * claimed + rounding * scale
    if not gap <= allowed and not (
        loop.is_stable and gap <= rounding * _uncancelled(loop, len(regular.model.a))
    ):
        raise InputError(
            f"the solver reports {status!r} with H2 norm {claimed:.6g}, but the loop of its controller has "
            f"{achieved:.6g}: relative residual {(achieved - claimed) / (claimed or 1.0):.1e}, allowed {tolerance:.1e}"
        )
    return H2Synthesis(controller, achieved, checked_h2_norm(plant.close(controller)), claimed, status)


def _uncancelled(loop: StateModel, states: int) -> float:
    """H2 norm of what the plant's states and the controller's add to the performance, each for itself."""
    apart = linalg.block_diag(loop.c[:, :states], loop.c[:, states:])
    return checked_h2_norm(StateModel(loop.a, loop.b, apart, np.zeros((len(apart), loop.b.shape[1]))))


@checked
def checked_h2_norm(loop: StateModel) -> float:
    """H2 norm of a loop; where it has no accurate one, the error does not name the plant as its cause."""
    try:
        return h2_norm(loop)
    except InputError as error:
        # Of a loop that passes next to nothing it is known that it does.
        if loop.is_stable and not np.any(loop.d) and np.any(loop.b) and np.any(loop.c):
            norm, largest = rough_h2_norm(loop)
            if largest <= 4 * np.sqrt(np.finfo(float).eps) * np.linalg.norm(loop.b) * np.linalg.norm(loop.c):
                return norm
        raise InputError(
            f"the norm of the optimal loop cannot be computed accurately; add effort or noise, or other sensors: {error}"
        ) from None


def _filter_gain(a, b, c, d) -> np.ndarray:
    """Kalman gain for correlated noise, L = (P C' + B D') (D D')^-1."""
    r = d @ d.T
    p = _covariance(a, b, c, d, r)
    gain = np.linalg.solve(r, (p @ c.T + b @ d.T).T).T
    if not np.isfinite(gain).all() or not np.all(linalg.eigvals(a - gain @ c).real < 0):
        raise InputError(
            "a Riccati equation has no stabilising solution that could be found; add effort or noise, or rescale"
        )
    return gain


def _covariance(a, b, c, d, r) -> np.ndarray:
    """Stabilising solution P of the filter's Riccati equation."""
    known = np.linalg.solve(r, d).T  # the noise that a measurement reveals
    free, noise = a - b @ known @ c, b - b @ known @ d
    if len(d) == d.shape[1] and np.all(linalg.eigvals(free).real < 0):
        return np.zeros_like(a)  # the measurements determine all noise, so nothing remains uncertain
    try:
        p = linalg.solve_continuous_are(a.T, c.T, b @ b.T, r, s=b @ d.T)
        if np.isfinite(p).all():
            return p
    except (np.linalg.LinAlgError, ValueError):
        pass
    try:  # decorrelated, scaled and checked
        return continuous_gain(free, noise, c, 1.0, r).covariance
    except (InputError, np.linalg.LinAlgError, ValueError) as error:
        raise InputError(
            f"a Riccati equation has no stabilising solution that could be found ({error}); check the plant, or add "
            "effort or noise"
        ) from None


@by_value
@dataclass(frozen=True)
class Units:
    """Units in which a synthesis is solved."""

    rate: float  # rad/s: time runs in 1/rate
    controls: Float64[np.ndarray, " controls"]  # their cost becomes 1
    measurements: Float64[np.ndarray, " measurements"]  # their noise becomes 1

    def __post_init__(self):
        check_fields(self)


@checked
def in_units(
    units: Units,
    a: Float64[np.ndarray, "states states"],
    b: Float64[np.ndarray, "states measurements"],
    c: Float64[np.ndarray, "controls states"],
) -> StateModel:
    """A controller of the scaled plant in the plant's own units."""
    b, c = b * units.rate / units.measurements, c * units.controls[:, None]
    return StateModel(a * units.rate, b, c, np.zeros((len(c), b.shape[1])))


@checked
def scaled_plant(plant: GeneralisedPlant, size: float = 1.0) -> tuple[GeneralisedPlant, Units]:
    """Slow time, unit cost and noise, balanced states, the performance in units of `size`: an H2 norm of 1 was that."""
    a, b1, b2, c1, c2, d11, d12, d21, d22 = plant.blocks
    rate = float(np.median(np.abs(linalg.eigvals(a)))) or 1.0  # most of them may be zero
    controls = size / np.linalg.norm(d12, axis=0)
    measurements = np.linalg.norm(d21, axis=1) * np.sqrt(rate)
    each = measurements[:, None]
    b = np.hstack([b1 / np.sqrt(rate), b2 * controls / rate])
    c = np.vstack([c1 / size, c2 / each])
    d = np.block([[d11 / size, d12 * controls / size], [d21 * np.sqrt(rate) / each, d22 * controls / each]])
    scale = state_scale(a / rate, b, c)
    model = StateModel(a * scale / scale[:, None] / rate, b / scale[:, None], c * scale, d)
    return GeneralisedPlant(model, plant.exogenous, plant.performance), Units(rate, controls, measurements)
