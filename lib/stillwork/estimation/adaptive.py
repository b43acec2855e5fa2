"""Self-tuning of feedforward weights with a filtered error: FeLMS and FeRLS (Section 4).

    u = W psi,   e = N P2^-1 a1,   psi_N = N psi

With a `path_delay` of d samples the weights follow the modified filtered error of Bjarnason (1995), which holds what the
weights of now would have left, with the regressors of then:

    e_m(k) = e(k) - N[u](k - d) + W(k) psi_N(k - d)

The weights W have one row per actuator; every row sees the same regressors, so that one covariance P of the
regressors serves all of them, eq. (27).
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Float64

from stillwork.base.algebra import add_scaled, inner_product
from stillwork.base.bounds import Count, Natural, Positive, one_of, within
from stillwork.base.checks import (
    Converted,
    InputError,
    pluralise,
    require_array,
    require_memory,
    require_number,
)
from stillwork.base.kernels import borrowing_kernel, inlined_kernel, pasted_kernel
from stillwork.base.validation import by_value, check_fields, checked, copy_arrays
from stillwork.estimation.covariance_forms import (
    FORMS,
    covariance_of,
    factor_of,
    hold_diagonal,
    update_covariance,
    update_ud,
    variance,
)
from stillwork.estimation.gaussian import require_covariance

# How much more than the steady value from its own power alone a regressor's correlation with the others may make of P.
INFLATION = 10.0


@by_value
@dataclass(frozen=True)
class FeLms:
    """Settings of filtered-error LMS, eq. (18)-(19); the defaults are the published ones.

    Attributes
    ----------
    step_size : float
        mu, of the normalised update.
    regularisation : float
        epsilon, in squared units of the regressors.
    trace : str
        ``regressors``: the trace over the n regressors, which fits the published curves. ``literal``: the trace
        that eq. (18) prints, which counts them once for every actuator and is that many times slower.
    path_delay : int, optional
        As of `FeRls`.

    Raises
    ------
    InputError
        When a number is not positive.

    References
    ----------
    The work that extends Beijen, Heertjes, van Dijk, Hakvoort, Control Engineering Practice 72 (2018), by FeRLS,
    eq. (18)-(19).

    Examples
    --------
    >>> floor = np.random.default_rng(1).standard_normal((2, 5000))  # m/s^2
    >>> estimation.identify(estimation.FeLms(step_size=0.2), floor, [[-3.0, 5.0]] @ floor).weights.round(3)
    array([[ 3., -5.]])
    """

    step_size: Positive = 1e-4
    regularisation: Positive = 1e-5
    trace: Annotated[str, one_of(("regressors", "literal"))] = "regressors"
    path_delay: Natural | None = None

    def __post_init__(self):
        check_fields(self)

    def trace_copies(self, actuators: int) -> float:
        """Number of times the trace counts the power of the regressors.

        Parameters
        ----------
        actuators : int
            Number of actuators.

        Returns
        -------
        float
            1, or the number of actuators for the literal trace.

        Examples
        --------
        >>> estimation.FeLms(0.5).trace_copies(6), estimation.FeLms(0.5, trace="literal").trace_copies(6)
        (1.0, 6.0)
        """
        return float(actuators) if self.trace == "literal" else 1.0


class Recursion(NamedTuple):
    """P and the workspace of its kernel, in the order of the arguments of `ferls_update`."""

    matrix: np.ndarray  # (n, n), what the form stores for P
    form: int  # place in FORMS
    forgetting: float  # lambda as the precision holds it
    # (4, n): limits of P's diagonal, power of psi in the window, share of time at the limit, workspace
    levels: np.ndarray
    allowance: float  # limit times power that is granted to each regressor
    gain: np.ndarray  # (n,), workspace
    # Workspace, (n,): none in the triangle. So kernels that test whether it is None are compiled for the triangle
    # alone: a test of the form at every sample would take half as long again.
    inner: np.ndarray | None
    other: np.ndarray | None

    def copy(self) -> "Recursion":
        """An independent recursion; the workspace is shared."""
        return self._replace(matrix=self.matrix.copy(), levels=self.levels.copy())

    @property
    def covariance(self) -> Float64[np.ndarray, "n n"]:
        """P."""
        return covariance_of(FORMS[self.form], self.matrix.astype(np.float64))

    @property
    def held(self) -> Float64[np.ndarray, " n"]:
        """Share of the last time constant in which a diagonal element of P was at its limit."""
        return self.levels[2].astype(np.float64)


@by_value
@dataclass(frozen=True)
class FeRls:
    """Settings of filtered-error RLS, eq. (29)-(30).

    The defaults are the published forgetting and the safe form of the covariance: without `growth_limit` a
    direction that the floor does not excite winds P up as exp(t / T), and its return breaks the loop.

    Attributes
    ----------
    initial_covariance : array_like, shape (), (n,) or (n, n)
        P(-1), its diagonal, or one number for the whole diagonal. The steady value is (1 - lambda) E[psi psi']^-1;
        the paper starts at ten times its diagonal.
    forgetting : float
        lambda in (0, 1]; exp(-sample time / time constant).
    growth_limit : float
        How far an element of the diagonal of P may grow, at least 1; ``inf`` for the printed algorithm. It counts from
        P(-1), but from ten times the steady value that the regressor's own power gives, 1 / sum lambda^j psi^2, where
        that is less; of regressors so alike that P(-1) is more than ten times that, P_ii (P^-1)_ii, from as many. It keeps
        P from winding up after any P(-1), but does not keep too large a P(-1) from breaking the loop in its first samples.
        A floor that gets quieter by more than this, in power, and a combination of
        regressors that is weaker than this are followed more slowly; `held` of the result lists the regressors that the
        limit held. The triangle does not depend on the order of the regressors; forms with factors hold one regressor a
        sample, in turn, so that while limits act their result depends on the order.
    form : str
        How P is kept, one of `covariance_forms.FORMS`. ``safe``: the triangle in float64; in float32, where it loses
        definiteness on regressors that one record drives, Bierman's factors, which take no longer.
    dtype : str
        Precision of the update and of the weights, ``float64`` or ``float32``.
    path_delay : int, optional
        Samples by which the path from command to error, its estimate inverted, is late: the update then uses the modified
        filtered error, and psi_N of as many samples ago. None: the published update, which takes N[W psi] for W psi_N
        and feeds slow signals back as the weights move.

    Raises
    ------
    InputError
        When the covariance is not positive definite, or the precision rounds the forgetting to another number.

    References
    ----------
    The work that extends Beijen, Heertjes, van Dijk, Hakvoort, Control Engineering Practice 72 (2018), by FeRLS,
    eq. (29)-(30).
    Bjarnason, Analysis of the filtered-X LMS algorithm, IEEE Trans. Speech and Audio Processing 3 (1995): the modified
    form; Rupp and Sayed, IEEE Trans. Signal Processing 44 (1996).

    Examples
    --------
    >>> settings = estimation.FeRls(initial_covariance=10.0, forgetting=float(np.exp(-2e-4 / 5)))  # 5 s at 5 kHz
    >>> settings.start(regressors=2).levels[0]  # limits of the diagonal of P
    array([100., 100.])
    """

    initial_covariance: Converted
    forgetting: Annotated[float, within(above=0.0, at_most=1.0)] = float(np.exp(-2e-4 / 10))
    growth_limit: float = 10.0
    form: Annotated[str, one_of(("safe", *FORMS))] = "safe"
    dtype: Annotated[str, one_of(("float64", "float32"))] = "float64"
    path_delay: Natural | None = None

    @checked
    def __post_init__(self):
        check_fields(self, infinite=("growth_limit",))
        if self.growth_limit != np.inf:
            require_number("growth_limit", self.growth_limit, at_least=1.0)
        rounded, forgotten = float(np.dtype(self.dtype).type(self.forgetting)), 1 - self.forgetting
        if not 0 < rounded or abs(rounded - self.forgetting) > 0.05 * forgotten:
            raise InputError(
                f"forgetting is {self.forgetting}, which {self.dtype} rounds to {rounded}; "
                "give a shorter time constant, in samples, or float64"
            )
        initial = require_array("initial_covariance", self.initial_covariance)
        if initial.ndim > 2 or (initial.ndim == 2 and initial.shape[0] != initial.shape[1]):
            raise InputError(
                f"initial_covariance has shape {initial.shape}; give a number, its diagonal or a square matrix"
            )
        whole = np.atleast_1d(initial)
        require_covariance("initial_covariance", whole, len(whole))
        object.__setattr__(self, "initial_covariance", initial)
        copy_arrays(self)

    @checked(infinite=True)
    def start(self, regressors: Count) -> Recursion:
        """P(-1), exactly symmetric, and the limits of its diagonal for a number of regressors.

        Parameters
        ----------
        regressors : int
            n, their number.

        Returns
        -------
        Recursion
            State of the recursion before the first sample.

        Raises
        ------
        InputError
            When `initial_covariance` is of another size.

        Examples
        --------
        >>> estimation.FeRls(1e3).start(2).covariance
        array([[1000.,    0.],
               [   0., 1000.]])
        """
        initial = self.initial_covariance
        if initial.ndim and len(initial) != regressors:
            raise InputError(
                f"initial_covariance has shape {initial.shape} for {pluralise(regressors, 'regressor')}; "
                "give one value for each, or a single number"
            )
        require_memory("regressors", regressors, regressors)
        covariance = initial if initial.ndim == 2 else np.diag(np.broadcast_to(initial, regressors))
        covariance = (covariance + covariance.T) / 2
        dtype = np.dtype(self.dtype)
        form = self.form
        if form == "safe":
            form = "triangle" if dtype == np.float64 else "UD"
        levels = np.zeros((4, regressors), dtype)
        levels[0] = self.growth_limit * np.diag(covariance)
        # Steady variance of a regressor over that which its own power gives, largest: of regressors that are alike above ten.
        alike = np.max(np.diag(covariance) * np.diag(np.linalg.inv(covariance)))
        return Recursion(
            factor_of(form, covariance).astype(dtype),
            FORMS.index(form),
            float(dtype.type(self.forgetting)),
            levels,
            float(self.growth_limit * max(INFLATION, alike)),
            np.zeros(regressors, dtype),
            *(None if form == "triangle" else np.zeros(regressors, dtype) for _ in range(2)),
        )


@pasted_kernel
def ferls_update(weights, matrix, forgetting, levels, allowance, gain, regressor, error):
    """One sample of FeRLS in the triangle's form in place, eq. (29)-(30), in the precision of the arrays.

    `matrix` to `gain` are those of a `Recursion`; the error e may be longer than the actuators are many. Returns the
    leverage lambda + psi' P psi, below lambda or NaN when P was no longer positive definite, and whether
    `hold_triangle` has something to do: called from here it would cost every sample a third more.
    """
    n, forget = len(regressor), matrix.dtype.type(forgetting)
    denominator, shrink = update_covariance(matrix, regressor, forget, gain)
    step_weights(weights, gain, shrink, error)
    check_powers(levels, regressor, forget, allowance)
    reached = False
    for i in range(n):
        reached |= matrix[i, i] > levels[0, i]
    return denominator, reached


@borrowing_kernel
def ferls_form_update(
    weights, matrix, form, forgetting, levels, allowance, gain, inner, other, regressor, error, sample
):
    """One sample in Bierman's factors, by a call; returns the leverage.

    Factors show P's diagonal at the price of a product, so one element a sample is held to its limit.
    """
    one, n, axis = matrix.dtype.type(1), len(regressor), sample % len(regressor)
    forget = matrix.dtype.type(forgetting)
    denominator = update_ud(matrix, regressor, forget, gain, inner)
    step_weights(weights, gain, one / denominator, error)
    check_powers(levels, regressor, forget, allowance)
    found = variance(matrix, axis)
    if found > levels[0, axis]:
        # A regressor along this axis, seen without forgetting. Here: in a function of its own the compiler would make
        # machine code of all forms once more.
        for i in range(n):
            other[i] = 0
        other[axis] = np.sqrt(one / levels[0, axis] - one / found)
        update_ud(matrix, other, one, gain, inner)
        levels[2, axis] = stretched(levels[2, axis], forget, n)
    return denominator


@inlined_kernel
def step_weights(weights, gain, shrink, error):
    """W; the gain becomes P psi of after, which is that of before over the denominator."""
    for i in range(len(gain)):
        gain[i] *= shrink
    for a in range(weights.shape[0]):
        add_scaled(-error[a], gain, weights[a])


@inlined_kernel
def check_powers(levels, regressor, forgetting, allowance):
    """Power of each regressor in the window; the limit of its variance where that leads to a lower one."""
    lower = False
    for i in range(len(regressor)):
        power = forgetting * levels[1, i] + regressor[i] * regressor[i]
        levels[1, i] = power
        levels[2, i] *= forgetting
        lower |= levels[0, i] * power > allowance
    if lower:  # rare, and a division that is hardly ever needed would prevent vectorised code
        for i in range(len(regressor)):
            if levels[0, i] * levels[1, i] > allowance:
                levels[0, i] = allowance / levels[1, i]


@borrowing_kernel
def hold_triangle(covariance, forgetting, levels, gain):
    """Bring the diagonal of P back to its limits, as if each regressor above its own had been seen once more."""
    hold_diagonal(covariance, levels[0], levels[3], gain)
    for i in range(len(gain)):
        if levels[3, i]:
            levels[2, i] += covariance.dtype.type(1) - covariance.dtype.type(forgetting)


@inlined_kernel
def stretched(share, forgetting, n):
    """Share of time at the limit, with one sample that stands for n: an element is looked at each n-th time."""
    return min(1.0, share + 1.0 - forgetting**n)


@pasted_kernel
def ferls_step(
    weights, matrix, form, forgetting, levels, allowance, gain, inner, other, regressor, error, sample
):
    """One sample in the form of a `Recursion`, of which `inner` decides at compile time whether it is the triangle; the leverage."""
    if inner is None:
        leverage, reached = ferls_update(
            weights, matrix, forgetting, levels, allowance, gain, regressor, error
        )
        if reached:
            hold_triangle(matrix, forgetting, levels, gain)
    else:
        leverage = ferls_form_update(
            weights, matrix, form, forgetting, levels, allowance, gain, inner, other, regressor, error, sample
        )
    return leverage


@pasted_kernel
def felms_update(weights, regressor, error, step_size, regularisation, trace_copies):
    """One sample of FeLMS in place, eq. (18)-(19).

    The trace counts psi_N' psi_N `trace_copies` times: the number of actuators for the literal trace of eq. (18), 1
    for the trace over the regressors.
    """
    rate = step_size / (regularisation + trace_copies * inner_product(regressor, regressor))
    for a in range(weights.shape[0]):
        add_scaled(-rate * error[a], regressor, weights[a])
