"""H2-optimal observers: by two scaled Riccati equations and by linear matrix inequalities (Theorem 5.1.1).

The inequalities also take a bound on one weighted peak, with one Lyapunov matrix for both norms.

Both need a regular problem. The one of Fig. 5.2 is singular twice (the estimate does not enter the performance,
and the plant input is measured without noise), so a small cost and a small noise are added; what comes back
is judged by the norm of the original loop, computed apart.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from stillwork.base.checks import InputError, require_array, require_number
from stillwork.base.extras import require_package
from stillwork.base.front_door import checked
from stillwork.estimation.generalised_plant import GeneralisedPlant
from stillwork.lti.norms import h2_norm, hinf_norm
from stillwork.lti.state_space import StateModel


@dataclass(frozen=True)
class Synthesis:
    """An observer and the norms of its loop."""

    observer: StateModel
    regular_norm: float  # H2 norm of the regularised loop, recomputed on the closed loop
    norm: float  # H2 norm of the loop as it was posed
    claimed: float  # what the synthesis itself says of the regularised loop
    status: str = "solved"


@checked
def regularised(
    plant: GeneralisedPlant, effort: float | ArrayLike, noise: float | ArrayLike
) -> GeneralisedPlant:
    """Add `effort` times every control to the performance, and white noise to every measurement.

    Parameters
    ----------
    plant : GeneralisedPlant
    effort : float or array_like, shape (controls,)
        Cost of each control, in performance units a unit of control; may be zero where D12 has full column rank.
    noise : float or array_like, shape (measurements,)
        Intensity root of the noise on each measurement; may be zero where D21 has full row rank.
    """
    a, b1, b2, c1, c2, d11, d12, d21, d22 = plant.blocks
    controls, measurements = b2.shape[1], len(c2)
    effort = np.broadcast_to(require_array("effort", effort), (controls,))
    noise = np.broadcast_to(require_array("noise", noise), (measurements,))
    if np.any(effort < 0) or np.any(noise < 0):
        raise InputError("effort and noise must be positive; they make the problem regular")
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
    for name, matrix in (
        ("effort", d[: z + controls, w + measurements :].T),
        ("noise", d[z + controls :, :-controls]),
    ):
        lengths = np.linalg.norm(matrix, axis=1)[:, None]
        if not np.all(lengths) or np.linalg.matrix_rank(matrix / lengths) < len(matrix):
            raise InputError(f"effort and noise must make the problem regular; it takes more {name}")
    return GeneralisedPlant(StateModel(a, b, c, d), w + measurements, z + controls)


@checked
def h2_riccati(plant: GeneralisedPlant, effort: float | ArrayLike, noise: float | ArrayLike) -> Synthesis:
    """H2-optimal observer of the regularised plant from two Riccati equations, scaled before and checked after.

    The check is the separation theorem: the cost of full information and that of estimating, each from its own
    half of the solution, must add up to the norm of the closed loop.

    Parameters
    ----------
    plant, effort, noise
        See `regularised`.

    Raises
    ------
    InputError
        When a feedthrough from w to z makes every norm infinite, a Riccati equation has no stabilising
        solution, or the check fails.
    """
    regular = regularised(plant, effort, noise)
    scaled, units = _scaled(regular)
    a, b1, b2, c1, c2, d11, d12, d21, d22 = scaled.blocks
    if np.any(d11):
        raise InputError("the plant has feedthrough from w to z; its H2 norm is infinite, add a low-pass")
    gain = _filter_gain(a, b1, c2, d21)
    feedback = _filter_gain(a.T, c1.T, b2.T, d12.T).T
    driven = StateModel(a - b2 @ feedback, b1, c1 - d12 @ feedback, d11)
    missed = StateModel(a - gain @ c2, b1 - gain @ d21, d12 @ feedback, np.zeros_like(d11))
    claimed = float(np.hypot(h2_norm(driven), h2_norm(missed)))
    core = a - b2 @ feedback - gain @ c2 + gain @ d22 @ feedback
    observer = _in_units(units, core, gain, -feedback)
    return _judged(plant, regular, observer, claimed, "solved", WORST_SEPARATION)


# A scaled pair of Riccati equations leaves 1e-8 at worst; the norms of unbalanced loops scatter above that.
WORST_SEPARATION = 1e-5


# Norms below this share of |B1| |C1| of the scaled plant are compared as if they were as large.
LEAST_SHARE = 1e-6


def _judged(plant, regular, observer, claimed: float, status: str, tolerance: float) -> Synthesis:
    loop = regular.close(observer)
    achieved = h2_norm(loop) if loop.is_stable else np.inf
    _, b1, _, c1, *_ = _scaled(regular)[0].blocks
    scale = np.linalg.norm(b1) * np.linalg.norm(c1)
    size = max(claimed, LEAST_SHARE * scale)
    # A norm is the root of a sum that is known to rounding units: near zero to the root of these.
    rounding = 4 * np.sqrt(np.finfo(float).eps) * scale
    if not abs(achieved - claimed) <= tolerance * size + rounding:
        raise InputError(
            f"the solver reports {status!r} with H2 norm {claimed:.6g}, but the loop of its observer has "
            f"{achieved:.6g}: relative residual {(achieved - claimed) / size:.1e}, allowed {tolerance:.1e}"
        )
    return Synthesis(observer, achieved, h2_norm(plant.close(observer)), claimed, status)


def _filter_gain(a, b, c, d) -> np.ndarray:
    """Kalman gain for correlated noise, L = (P C' + B D') (D D')^-1."""
    r = d @ d.T
    try:
        p = linalg.solve_continuous_are(a.T, c.T, b @ b.T, r, s=b @ d.T)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InputError(
            f"a Riccati equation has no stabilising solution ({error}); check the plant"
        ) from None
    gain = np.linalg.solve(r, (p @ c.T + b @ d.T).T).T
    if not np.all(linalg.eigvals(a - gain @ c).real < 0):
        raise InputError(
            "a Riccati equation has no stabilising solution that could be found; add effort or noise, or rescale"
        )
    return gain


def _in_units(units: "_Units", a, b, c) -> StateModel:
    """An observer of the scaled plant in the plant's own units."""
    return StateModel(
        a * units.rate,
        b * units.rate / units.measurements,
        c * units.controls[:, None],
        np.zeros((len(c), len(units.measurements))),
    )


@dataclass(frozen=True)
class _Units:
    """Units in which the matrix inequalities are solved."""

    rate: float  # rad/s: time runs in 1/rate
    controls: np.ndarray  # their cost becomes 1
    measurements: np.ndarray  # their noise becomes 1


def _scaled(plant: GeneralisedPlant) -> tuple[GeneralisedPlant, _Units]:
    """Slow time, unit cost and noise, balanced states; H2 norms stay what they are."""
    a, b1, b2, c1, c2, d11, d12, d21, d22 = plant.blocks
    rate = float(np.median(np.abs(linalg.eigvals(a)))) or 1.0  # most of them may be zero
    controls = 1 / np.linalg.norm(d12, axis=0)
    measurements = np.linalg.norm(d21, axis=1) * np.sqrt(rate)
    b = np.hstack([b1 / np.sqrt(rate), b2 * controls / rate])
    c = np.vstack([c1, c2 / measurements[:, None]])
    d = np.block(
        [
            [d11, d12 * controls],
            [d21 * np.sqrt(rate) / measurements[:, None], d22 * controls / measurements[:, None]],
        ]
    )
    n, size = len(a), len(a) + max(b.shape[1], len(c))
    whole = np.zeros((size, size))
    whole[:n, :n], whole[:n, n : n + b.shape[1]], whole[n : n + len(c), :n] = a / rate, b, c
    _, (scale, _) = linalg.matrix_balance(whole, permute=False, separate=True)
    scale = scale[:n]
    model = StateModel(a * scale / scale[:, None] / rate, b / scale[:, None], c * scale, d)
    return GeneralisedPlant(model, plant.exogenous, plant.performance), _Units(rate, controls, measurements)


@checked
def h2_lmi(
    plant: GeneralisedPlant, effort: float | ArrayLike, noise: float | ArrayLike, tolerance: float = 1e-3
) -> Synthesis:
    r"""H2-optimal observer of the regularised plant from the matrix inequalities (5.7), solved by Clarabel.

    The observer's feedthrough is zero: with a regular :math:`D_{12}` and :math:`D_{21}` any other makes the
    norm infinite.

    Parameters
    ----------
    plant, effort, noise
        See `regularised`.
    tolerance : float
        How far, relatively, the norm of the recovered loop may lie from what the solver claims.

    Raises
    ------
    InputError
        When the solver does not report an optimum, or the recovered loop does not keep what was claimed;
        the message shows the status and the residual. No matrix of a failed solve is returned.
    """
    tolerance = require_number("tolerance", tolerance, above=0.0)
    regular = regularised(plant, effort, noise)
    status, claimed, observer = _by_inequalities(regular)
    return _judged(plant, regular, observer, claimed, status, tolerance)


@checked
def mixed_lmi(
    plant: GeneralisedPlant,
    level: float,
    ratio: float,
    effort: float | ArrayLike,
    noise: float | ArrayLike,
    tolerance: float = 1e-3,
) -> Synthesis:
    r"""Observer with a small H2 norm whose weighted error keeps a level, from matrix inequalities with Clarabel.

    One change of variables serves both norms only if their Lyapunov matrices are multiples of each other. That
    makes `claimed` an upper bound of both the loop's norm and the optimum: any ratio is valid, the least claim
    over ratios is the best, and no ratio gives the true trade-off.

    Parameters
    ----------
    plant : GeneralisedPlant
        With two performance outputs, as `tradeoff.emphasised` gives for emphasis 1: the error and the weighted
        error. The two-norm is that from all inputs to the first, the peak that from the first input to the second.
    level : float
        Bound on the peak.
    ratio : float
        Lyapunov matrix of the peak over that of the two-norm, for the scaled problem; 1 in most texts.
    effort, noise
        See `regularised`.
    tolerance : float
        How far, relatively, the loop's norms may exceed the claim and the level.

    Returns
    -------
    Synthesis
        Its norms are those to the first output, without and with the added cost and noise.

    Raises
    ------
    InputError
        As for `h2_lmi`; here also when the loop does not keep the level.
    """
    level = require_number("level", level, above=0.0)
    ratio = require_number("ratio", ratio, above=0.0)
    tolerance = require_number("tolerance", tolerance, above=0.0)
    if plant.performance != 2:
        raise InputError(
            f"plant has {plant.performance} performance outputs; give the error and the weighted"
        )
    regular = regularised(plant, effort, noise)
    status, claimed, observer = _by_inequalities(regular, level, ratio)
    loop = regular.close(observer)
    achieved = peak = np.inf
    if loop.is_stable:
        achieved = h2_norm(loop.select(range(regular.exogenous), _unweighted(regular)))
        peak = hinf_norm(loop.select([0], [1])).magnitude
    excess = max(achieved / claimed, peak / level) - 1
    if not excess <= tolerance:
        raise InputError(
            f"the solver reports {status!r} with H2 norm {claimed:.6g} at level {level:.6g}, but the loop of its "
            f"observer has {achieved:.6g} and {peak:.6g}: relative residual {excess:.1e}, allowed {tolerance:.1e}"
        )
    posed = plant.close(observer).select(range(plant.exogenous), [0])
    return Synthesis(observer, achieved, h2_norm(posed), claimed, status)


def _unweighted(regular: GeneralisedPlant) -> list[int]:
    """Performance outputs of a regularised plant that count for the two-norm when the second has a bound."""
    return [0, *range(2, regular.performance)]


def _by_inequalities(regular: GeneralisedPlant, level: float | None = None, ratio: float = 1.0):
    """Status, claimed norm and observer of a regularised plant; with a level, the second output is bounded.

    Raises
    ------
    InputError
        When the solver reports anything but an optimum, with what it reports and its residuals.
    """
    cp = require_package("cvxpy")

    plant, units = _scaled(regular)
    a, b1, b2, c1, c2, _, d12, d21, _ = plant.blocks
    n = len(a)
    x, y = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True)
    a_hat, b_hat, c_hat = cp.Variable((n, n)), cp.Variable((n, len(c2))), cp.Variable((b2.shape[1], n))
    upper, lower = a @ x + b2 @ c_hat, y @ a + b_hat @ c2
    driven, seen = y @ b1 + b_hat @ d21, c1 @ x + d12 @ c_hat
    stable = [[upper + upper.T, a_hat.T + a], [a_hat + a.T, lower + lower.T]]
    kept = list(range(len(c1))) if level is None else _unweighted(plant)
    q = cp.Variable((len(kept), len(kept)), symmetric=True)
    dissipated = [[*stable[0], b1], [*stable[1], driven], [b1.T, driven.T, -np.eye(b1.shape[1])]]
    bounded = [[x, np.eye(n), seen[kept].T], [np.eye(n), y, c1[kept].T], [seen[kept], c1[kept], q]]
    constraints = [cp.bmat(dissipated) << 0, cp.bmat(bounded) >> 0]
    if level is not None:
        own = level * np.sqrt(units.rate)  # in slow time
        into, out = np.sqrt(ratio / own), np.sqrt(1 / (ratio * own))
        b, yb, cx, c = into * b1[:, :1], into * driven[:, :1], out * seen[1:2], out * c1[1:2]
        zero = np.zeros((1, 1))
        real = [
            [*stable[0], b, cx.T],
            [*stable[1], yb, c.T],
            [b.T, yb.T, -np.eye(1), zero],
            [cx, c, zero, -np.eye(1)],
        ]
        constraints.append(cp.bmat(real) << 0)
    problem = cp.Problem(cp.Minimize(cp.trace(q)), constraints)
    data, chain, inverse = problem.get_problem_data(cp.CLARABEL, solver_opts={})
    solution = chain.solve_via_data(problem, data)
    if str(solution.status) != "Solved":
        raise InputError(
            f"the matrix inequalities have no usable solution: Clarabel reports {str(solution.status)!r} after "
            f"{solution.iterations} iterations, residuals {solution.r_prim:.1e} (primal) and "
            f"{solution.r_dual:.1e} (dual); rescale the problem, regularise it more or ask for less"
        )
    problem.unpack_results(solution, chain, inverse)
    found = (variable.value for variable in (x, y, a_hat, b_hat, c_hat))
    return problem.status, float(np.sqrt(problem.value)), _in_units(units, *_recover(plant, *found))


def _recover(plant: GeneralisedPlant, x, y, a_hat, b_hat, c_hat):
    """Observer matrices of Lemma 5.1.1 without feedthrough, and with D22 taken out of the measurement."""
    a, _, b2, _, c2, _, _, _, d22 = plant.blocks
    left, values, right = np.linalg.svd(np.eye(len(x)) - x @ y)
    m, n = left * np.sqrt(values), right.T * np.sqrt(values)
    c_o = np.linalg.solve(m, c_hat.T).T
    b_o = np.linalg.solve(n, b_hat)
    core = a_hat - b_hat @ c2 @ x - y @ b2 @ c_hat - y @ a @ x
    a_o = np.linalg.solve(n, np.linalg.solve(m, core.T).T)
    return a_o - b_o @ d22 @ c_o, b_o, c_o
