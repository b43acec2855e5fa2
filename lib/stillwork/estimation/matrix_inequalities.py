"""H2-optimal controllers and observers by linear matrix inequalities, solved by Clarabel.

They take a bound on one weighted peak as well, with one Lyapunov matrix for both norms.
"""

import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError
from stillwork.base.extras import require_package
from stillwork.base.validation import checked
from stillwork.estimation.h2 import (
    H2Synthesis,
    checked_h2_norm,
    in_units,
    regularised,
    scaled_plant,
    verified,
)
from stillwork.lti.generalised_plant import GeneralisedPlant
from stillwork.lti.norms import hinf_norm
from stillwork.lti.state_space import StateModel


def _require_continuous(plant: GeneralisedPlant) -> None:
    if plant.model.sample_time:
        raise InputError(
            "plant is in discrete time; these inequalities need continuous time; h2_riccati accepts both"
        )


@checked
def h2_lmi(
    plant: GeneralisedPlant,
    effort: float | ArrayLike = 0.0,
    noise: float | ArrayLike = 0.0,
    tolerance: Positive = 1e-3,
) -> H2Synthesis:
    r"""Controller u = K y with the smallest H2 norm from w to z, from matrix inequalities that Clarabel solves.

    An independent check of the Riccati equations of `h2_riccati`: slower, less accurate, and without a result
    for many plants with unstable modes that these solve. The controller's feedthrough is zero: with a regular
    :math:`D_{12}` and :math:`D_{21}` any other makes the norm infinite. It needs cvxpy, which the extra `control` brings.

    Parameters
    ----------
    plant : GeneralisedPlant
        In continuous time, without feedthrough from w to z; it may be unstable.
    effort : float or array_like, shape (controls,)
        An additional performance output for every control: this factor times the control, in units of z per unit of u.
    noise : float or array_like, shape (measurements,)
        Additional white noise in every measurement: the root of its intensity, in units of y times a root of s.
    tolerance : float
        Allowed relative difference between the norm of the loop and the solver's value.

    Returns
    -------
    H2Synthesis
        `status` is ``optimal``, or ``optimal_inaccurate`` if the solver stopped a little short of it.

    Raises
    ------
    InputError
        When the problem is not regular, the solver fails, or the loop does not have the solver's norm.
    MissingPackage
        Without cvxpy.

    References
    ----------
    Scherer, Gahinet and Chilali, IEEE Transactions on Automatic Control 42 (1997), 896-911; Verkerk, Improved accuracy
    of flexible systems by state estimation, thesis (2018), section 5.1.

    Examples
    --------
    >>> mass = lti.StateModel([[0, 1], [0, 0]], [[0, 0], [1, 1]], [[1, 0], [1, 0]], np.zeros((2, 2)))
    >>> plant = lti.GeneralisedPlant(mass, exogenous=1, performance=1)
    >>> apart = estimation.h2_lmi(plant, effort=0.5, noise=0.5)
    >>> round(apart.regular_norm / estimation.h2_riccati(plant, effort=0.5, noise=0.5).regular_norm, 2)
    1.0
    """
    _require_continuous(plant)
    regular = regularised(plant, effort, noise)
    return _solved(
        regular,
        lambda status, claimed, controller: verified(plant, regular, controller, claimed, status, tolerance),
    )


@checked
def mixed_lmi(
    plant: GeneralisedPlant,
    level: Positive,
    ratio: Positive = 1.0,
    effort: float | ArrayLike = 0.0,
    noise: float | ArrayLike = 0.0,
    tolerance: Positive = 1e-3,
) -> H2Synthesis:
    r"""Controller u = K y with a small H2 norm whose weighted error keeps a level, from matrix inequalities.

    The plant has two performance outputs, an error and the same through a weight. The two-norm is that from all w to
    the first (and to the efforts), the peak the H-infinity norm from the first w to the second. One change of variables
    serves both norms only if their Lyapunov matrices are multiples of each other, by `ratio`. That makes `claimed` an
    upper bound of both the loop's norm and the optimum: any ratio is valid, the least claim over ratios is the best, and
    no ratio gives the true trade-off. It needs cvxpy, which the extra `control` brings.

    Parameters
    ----------
    plant : GeneralisedPlant
        In continuous time, without feedthrough from w to z; z are the error and the weighted error.
    level : float
        Largest magnitude from the first w to the weighted error, in their units.
    ratio : float
        Ratio of the peak's Lyapunov matrix to the two-norm's, in scaled time; 1 in most texts. It is in units of z, as
        `level` does.
    effort : float or array_like, shape (controls,)
        An additional performance output for every control: this factor times the control, in units of z per unit of u.
    noise : float or array_like, shape (measurements,)
        Additional white noise in every measurement: the root of its intensity, in units of y times a root of s.
    tolerance : float
        Allowed relative excess of the loop's norm and peak over the solver's values.

    Returns
    -------
    H2Synthesis
        Its norms are those to the error; `claimed` bounds `regular_norm` from above.

    Raises
    ------
    InputError
        When the problem is not regular, no controller with one Lyapunov matrix keeps the level, the solver fails, or
        the loop has a larger norm or peak than the solver's.
    MissingPackage
        Without cvxpy.

    References
    ----------
    Scherer, Gahinet and Chilali, IEEE Transactions on Automatic Control 42 (1997), 896-911; Verkerk, Improved accuracy
    of flexible systems by state estimation, thesis (2018), section 5.1.

    Examples
    --------
    A lag with its error, and the error through a low-pass of 0.2 rad/s as the second state.

    >>> a, b, c = [[-1.0, 0.0], [0.2, -0.2]], [[1.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]]
    >>> plant = lti.GeneralisedPlant(lti.StateModel(a, b, c, np.zeros((3, 2))), exogenous=1, performance=2)
    >>> found = estimation.mixed_lmi(plant, level=0.5, ratio=10.0, effort=0.3, noise=0.3)
    >>> bool(lti.hinf_norm(plant.close(found.controller).select([0], [1])).magnitude < 0.5)
    True
    """
    if plant.performance != 2:
        raise InputError(
            f"plant has {plant.performance} performance outputs; give the error and the weighted"
        )
    _require_continuous(plant)
    regular = regularised(plant, effort, noise)

    def judge(status: str, claimed: float, controller: StateModel) -> H2Synthesis:
        loop = regular.close(controller)
        achieved = peak = np.inf
        if loop.is_stable:
            achieved = checked_h2_norm(loop.select(range(regular.exogenous), _unweighted(regular)))
            peak = hinf_norm(loop.select([0], [1])).magnitude
        excess = max((achieved - claimed) / (claimed or 1.0), peak / level - 1)
        if not excess <= tolerance:
            raise InputError(
                f"the solver reports {status!r} with H2 norm {claimed:.6g} at level {level:.6g}, but the loop of its "
                f"controller has {achieved:.6g} and {peak:.6g}: relative residual {excess:.1e}, "
                f"allowed {tolerance:.1e}"
            )
        posed = plant.close(controller).select(range(plant.exogenous), [0])
        return H2Synthesis(controller, achieved, checked_h2_norm(posed), claimed, status)

    return _solved(regular, judge, level, ratio)


def _unweighted(regular: GeneralisedPlant) -> list[int]:
    """Performance outputs of a regularised plant that count for the two-norm when the second has a bound."""
    return [0, *range(2, regular.performance)]


MOST_SOLUTIONS = 6  # of one problem
LEAST_SHARE = 1e-6  # of the first guess: an optimum below is counted in no finer units
TIGHT = 1e-5  # a loop so near its claim needs no finer units
NEAR = 3.0  # the unit of the performance is within this factor of the optimum


def _solved(
    regular: GeneralisedPlant,
    judge: Callable[..., H2Synthesis],
    level: float | None = None,
    ratio: float = 1.0,
) -> H2Synthesis:
    """What `judge` accepts of the inequalities' solutions; its refusal, or the solver's, where that is none.

    The solver's tolerances are absolute, so the performance is counted in units in which the optimum is about one: a
    first guess, larger where the solver fails, then what it claims itself, and less while its loop is not near that.
    """
    plant, units = scaled_plant(regular)
    a, b1, b2, c1, c2, *_ = plant.blocks
    rest = in_units(units, a, np.zeros_like(c2.T), np.zeros_like(b2.T))
    if not (np.any(b1) and np.any(c1)) and rest.is_stable:  # the optimum is zero, at rest
        return judge("optimal", 0.0, rest)
    guess = size = float(np.linalg.norm(b1) * np.linalg.norm(c1)) or 1.0
    best: H2Synthesis | None = None
    refusals: list[InputError] = []
    settled = False  # the optimum is known well enough to look finer
    for _ in range(MOST_SOLUTIONS):
        try:
            status, claimed, controller = _by_inequalities(regular, size, level, ratio)
        except InputError as error:
            refusals.insert(0, error)  # that of a loop is more informative
            if best or settled:
                break
            size *= 10
            continue
        least = max(claimed, LEAST_SHARE * guess)
        settled = settled or least / NEAR < size < least * NEAR
        bound = np.inf if best is None else max(best.claimed, best.regular_norm)
        try:
            found = judge(status, claimed, controller)
        except InputError as error:
            refusals.append(error)
        else:
            reached = max(found.claimed, found.regular_norm)
            if reached < bound:
                best = found
            tight = abs(found.regular_norm - found.claimed) <= TIGHT * found.claimed
            if settled and (tight or bound < (1 + 10 * TIGHT) * reached):
                break
        size = size / 10 if settled else least
    if best is None:
        raise refusals[-1]
    return best


def _by_inequalities(regular: GeneralisedPlant, size: float, level: float | None, ratio: float):
    """Status, claimed norm and controller of a plant with its performance in units of `size`; with a level, the second
    output is bounded.
    """
    cp = require_package("cvxpy")

    plant, units = scaled_plant(regular, size)
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
        own, ratio = level / size * np.sqrt(units.rate), ratio / size  # in slow time and these units
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
    if str(solution.status) not in ("Solved", "AlmostSolved"):  # the loop is judged either way
        raise InputError(
            f"the matrix inequalities have no usable solution: Clarabel reports {str(solution.status)!r} after "
            f"{solution.iterations} iterations, residuals {solution.r_prim:.1e} (primal) and "
            f"{solution.r_dual:.1e} (dual); rescale the problem, regularise it more or relax the constraint"
        )
    with warnings.catch_warnings(action="ignore"):  # the status reports it, too
        problem.unpack_results(solution, chain, inverse)
    found = (variable.value for variable in (x, y, a_hat, b_hat, c_hat))
    claimed = size * float(np.sqrt(max(problem.value, 0.0)))  # a trace near zero may round below it
    return problem.status, claimed, in_units(units, *_recover(plant, *found))


def _recover(plant: GeneralisedPlant, x, y, a_hat, b_hat, c_hat):
    """Controller matrices (Lemma 5.1.1 of the thesis) without feedthrough, and with D22 taken out of the measurement."""
    a, _, b2, _, c2, _, _, _, d22 = plant.blocks
    left, values, right = np.linalg.svd(np.eye(len(x)) - x @ y)
    m, n = left * np.sqrt(values), right.T * np.sqrt(values)
    c_o = np.linalg.solve(m, c_hat.T).T
    b_o = np.linalg.solve(n, b_hat)
    core = a_hat - b_hat @ c2 @ x - y @ b2 @ c_hat - y @ a @ x
    a_o = np.linalg.solve(n, np.linalg.solve(m, core.T).T)
    return a_o - b_o @ d22 @ c_o, b_o, c_o
