"""Settings and steps of the recursive estimators; `recursive` runs them over data."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from stillwork.base.bounds import Fraction, NonNegative, Positive
from stillwork.base.checks import InputError, require_choice, require_count, require_number
from stillwork.base.validation import by_value, check_fields
from stillwork.estimation.recursive_kernels import known_length, run_least_squares, run_min_max, run_ridge
from stillwork.estimation.triangle_kernels import empty_record, least_share, track_rows

UPDATES = ("exact", "approximate")


@by_value
@dataclass(frozen=True)
class Track:
    """Results of an estimator over a record."""

    estimates: Float64[np.ndarray, "unknowns samples"]  # x_t; min-max: 0 up to as many samples
    errors: Float64[np.ndarray, " samples"]  # y_t - a_t'x_(t-1), before the sample is used
    alphas: Float64[np.ndarray, " samples"]  # x_t = (R_t + alpha_t I)^-1 s_t; infinite where x_t = 0
    evaluations: Int64[np.ndarray, " samples"]  # of the secular function, a step
    held: Bool[np.ndarray, " unknowns"]  # whose variance `growth_limit` held down at the last sample


class _Recursion:
    # The state stands apart from the settings, so one estimator serves many records.
    def bounds(self, first: int, count: int) -> np.ndarray:
        """eta of `count` samples from sample `first` on; zero where everything is known exactly.

        Parameters
        ----------
        first, count : int
            The first sample, from 0, and how many.

        Returns
        -------
        ndarray, shape (count,)
            In the unit of the regressors.

        Examples
        --------
        >>> estimation.LeastSquares(0.98).bounds(0, 3)
        array([0., 0., 0.])
        """
        return np.zeros(count)

    def fill(self, state, bounds, rows, outputs, *track) -> None:
        """Take in rows with their bounds: the state and the arrays of a track are changed in place."""
        raise NotImplementedError

    def advance(self, state, first: int, rows, outputs) -> Track:
        """Take in rows from sample `first` on; the state is changed in place.

        Parameters
        ----------
        state : tuple of ndarray
            From `start`; changed in place.
        first : int
            Number of the first of these samples.
        rows : ndarray, shape (rows, unknowns)
            Regressors, one per sample.
        outputs : ndarray, shape (rows,)
            Measured with them.

        Returns
        -------
        Track
            Of these samples alone.

        Examples
        --------
        >>> settings = estimation.LeastSquares(0.98)
        >>> state = settings.start(unknowns=1)
        >>> settings.advance(state, 0, np.ones((3, 1)), 2 * np.ones(3)).errors.round(2)
        array([2., 0., 0.])
        """
        out = empty_track(rows)
        self.fill(state, self.bounds(first, len(rows)), rows, outputs, *out)
        estimates, errors, alphas, evaluations = out
        return Track(estimates.T, errors, alphas, evaluations, self.held(state))

    def held(self, state) -> np.ndarray:
        """Which unknowns' variance a limit held down at the last sample; none without a limit.

        Parameters
        ----------
        state : tuple of ndarray
            From `start`.

        Returns
        -------
        ndarray of bool, shape (unknowns,)

        Examples
        --------
        >>> settings = estimation.LeastSquares(0.98)
        >>> settings.held(settings.start(unknowns=2))
        array([False, False])
        """
        return state[3] > 0 if isinstance(self, LeastSquares) else np.zeros(len(state[1]), bool)


class _MinMaxUpdate(_Recursion):
    # Shared by the two windows below: how alpha is found, and the kernels behind it.
    update: str
    iterations: int

    @property
    def _weight(self) -> float:
        return 1.0

    def start(self, unknowns: int) -> tuple[np.ndarray, ...]:
        """State before the first sample.

        Parameters
        ----------
        unknowns : int
            Number of parameters.

        Returns
        -------
        tuple of ndarray
            R, s and what the update of alpha keeps.

        Examples
        --------
        >>> settings = estimation.MinMax(bound=0.5, forgetting=0.98)
        >>> settings.start(unknowns=2)[0]  # nothing is known
        array([[0., 0.],
               [0., 0.]])
        """
        square = np.zeros((unknowns, unknowns))
        state = (square, np.zeros(unknowns), np.array([np.inf, 0.0, 0.0]), np.zeros(unknowns))
        return (*state, np.zeros((unknowns, unknowns)), np.zeros(unknowns))

    def fill(self, state, bounds, rows, outputs, *track) -> None:
        """As `advance`, into arrays that are there.

        Parameters
        ----------
        state : tuple of ndarray
            From `start`; changed in place.
        bounds : ndarray, shape (rows,)
            From `bounds`.
        rows : ndarray, shape (rows, unknowns)
            Regressors, one per sample.
        outputs : ndarray, shape (rows,)
            Measured with them.
        track : ndarray
            The arrays of `empty_track`; changed in place.

        Examples
        --------
        >>> settings = estimation.MinMax(bound=0.5, forgetting=0.98)
        >>> state, estimates = settings.start(unknowns=1), np.zeros((3, 1))
        >>> rows, track = np.ones((3, 1)), (estimates, np.zeros(3), np.zeros(3), np.zeros(3, int))
        >>> settings.fill(state, settings.bounds(0, 3), rows, 2 * np.ones(3), *track)
        >>> bool(0 < estimates[-1, 0] < 2)  # the uncertainty shrinks
        True
        """
        iterations = self.iterations if self.update == "approximate" else 0
        known = known_length(rows.shape[1], len(rows))
        run_min_max(known, rows, outputs, bounds, self._weight, iterations, *state, *track)

    def _check(self) -> None:
        require_choice("update", self.update, UPDATES)
        require_count("iterations", self.iterations)
        if self.iterations > 1 and self.update != "approximate":
            raise InputError("iterations is for update 'approximate'; the others solve for alpha exactly")


@by_value
@dataclass(frozen=True)
class MinMax(_MinMaxUpdate):
    """Exponentially weighted min-max estimator: constant bound on the perturbation of the weighted data.

    At every t it minimises the largest |(A_t + dA) x - b_t| over |dA| <= `bound`, where row j of A_t and b_t
    carries the weight forgetting^((t - j) / 2); problem (11).

    Attributes
    ----------
    bound : float
        eta, in the unit of the regressors; `exponential_bound` gives it from a bound on each row.
    forgetting : float
        lambda, between 0 and 1.
    update : str
        ``exact``: Theorem 2, one O(n^3) factorisation per step towards alpha; (R + alpha I) x = s is solved
        anew, to which the theorem's correction of h is equal, so that leaving zero needs no special case.
        ``approximate``: algorithm (20).
    iterations : int
        Fixed-point steps of the approximate update; the published algorithm takes 1.

    Raises
    ------
    InputError
        When a number is out of its range.

    Notes
    -----
    The residual comes from sums of squares: below 1e-7 of |b| it drowns in rounding. Use `min_max_solve`
    for data that fit to more digits than that.

    References
    ----------
    Sayed, Garulli, Nascimento, Chandrasekaran, "Exponentially-weighted iterative solutions for worst-case
    parameter estimation", Theorem 2, (20). With h as printed, (15) and (18) need lam alpha_t.

    Examples
    --------
    >>> rows = identification.fir_regressors(np.random.default_rng(1).standard_normal(500), taps=2)
    >>> track = estimation.run(estimation.MinMax(bound=1.0, forgetting=0.98), rows, [0.7, 0.2] @ rows)
    >>> bool(np.linalg.norm(track.estimates[:, -1]) <= np.hypot(0.7, 0.2))  # the uncertainty only shrinks
    True
    """

    bound: NonNegative
    forgetting: Fraction
    update: str = "exact"
    iterations: int = 1

    def __post_init__(self):
        check_fields(self)
        self._check()

    @property
    def _weight(self) -> float:
        return float(self.forgetting)

    def bounds(self, first: int, count: int) -> np.ndarray:
        """The bound at each of `count` samples.

        Parameters
        ----------
        first, count : int
            The first sample, from 0, and how many.

        Returns
        -------
        ndarray, shape (count,)
            In the unit of the regressors.

        Examples
        --------
        >>> estimation.MinMax(bound=0.5, forgetting=0.98).bounds(0, 3)
        array([0.5, 0.5, 0.5])
        """
        return np.full(count, float(self.bound))


@by_value
@dataclass(frozen=True)
class GrowingMinMax(_MinMaxUpdate):
    """Min-max estimator in which all rows count alike and the bound grows: eta_t = row_bound sqrt(t).

    This is the setting of Fig. 1 (forgetting 1); parameters as in `MinMax`.
    """

    row_bound: NonNegative  # epsilon, on the 2-norm of the perturbation of one regressor
    update: str = "exact"
    iterations: int = 1

    def __post_init__(self):
        check_fields(self)
        self._check()

    def bounds(self, first: int, count: int) -> np.ndarray:
        return self.row_bound * np.sqrt(np.arange(first + 1.0, first + count + 1))


@by_value
@dataclass(frozen=True)
class LeastSquares(_Recursion):
    """Exponentially weighted recursive least squares (RLS): a triangle of all rows, or a covariance from a given start.

    Attributes
    ----------
    forgetting : float
        lambda, between 0 and 1.
    initial_covariance : float, optional
        P_0 = initial_covariance I of the covariance form, in the unit of 1 / regressor^2: large means that the start at
        x = 0 has no weight. Without it the start has none: the estimate has the digits of a QR decomposition, and units do
        not matter. An unknown that nothing excites, or whose regressor those before it explain, is 0.
    growth_limit : float
        How far a variance may grow without excitation, at least 1: with P_0 an element of the diagonal of P beyond it;
        without, of a regressor, once what those before it explain is taken out, beyond its smallest. ``inf`` for the
        textbook's recursion, in which P grows as 1 / forgetting^t: it overflows, and long before that its return breaks
        the recursion; the triangle stays finite. Information is added only where a variance exceeds the limit; `held` of
        the track lists the unknowns for which it acted at the last sample.

    Raises
    ------
    InputError
        When a number is out of its range.

    References
    ----------
    Ljung, System Identification (1999), section 11.2.

    Examples
    --------
    >>> rows = identification.fir_regressors(np.random.default_rng(1).standard_normal(500), taps=2)
    >>> estimation.run(estimation.LeastSquares(0.98), rows, [0.7, 0.2] @ rows).estimates[:, -1].round(3)
    array([0.7, 0.2])
    """

    forgetting: Fraction
    initial_covariance: Positive | None = None
    growth_limit: float = 1e6

    def __post_init__(self):
        check_fields(self, infinite=("growth_limit",))
        if self.growth_limit != np.inf:
            require_number("growth_limit", self.growth_limit, at_least=1.0)

    def start(self, unknowns: int) -> tuple[np.ndarray, ...]:
        """P or the triangle, x, the limits of the diagonal of P and those that act, before the first sample.

        Parameters
        ----------
        unknowns : int
            Number of parameters.

        Returns
        -------
        tuple of ndarray
            The first of shape (unknowns, unknowns), the others (unknowns,).

        Examples
        --------
        >>> estimation.LeastSquares(0.98, initial_covariance=1e3).start(unknowns=1)[0]
        array([[1000.]])
        """
        vectors = (np.full(unknowns, each) for each in (0.0, 0.0, 0.0))
        if self.initial_covariance is None:
            return empty_record(unknowns, 1), *vectors
        initial = float(self.initial_covariance)
        estimate, limits, held = vectors
        return initial * np.eye(unknowns), estimate, initial * float(self.growth_limit) + limits, held

    def fill(self, state, bounds, rows, outputs, *track) -> None:
        """As of all estimators, without bounds.

        Parameters
        ----------
        state : tuple of ndarray
            From `start`; changed in place.
        bounds : ndarray, shape (rows,)
            From `bounds`.
        rows : ndarray, shape (rows, unknowns)
            Regressors, one per sample.
        outputs : ndarray, shape (rows,)
            Measured with them.
        track : ndarray
            The arrays of `empty_track`; changed in place.

        Examples
        --------
        >>> settings = estimation.LeastSquares(0.98)
        >>> state, estimates = settings.start(unknowns=1), np.zeros((3, 1))
        >>> rows, track = np.ones((3, 1)), (estimates, np.zeros(3), np.zeros(3), np.zeros(3, int))
        >>> settings.fill(state, settings.bounds(0, 3), rows, 2 * np.ones(3), *track)
        >>> estimates[-1].round(3)
        array([2.])
        """
        forgetting = float(self.forgetting)
        if self.initial_covariance is not None:
            run_least_squares(rows, outputs, forgetting, *state, *track[:2])
            return
        record, estimate, _, held = state
        share = least_share(self.growth_limit)
        track_rows(record, estimate, rows, outputs, forgetting, share, held, *track[:2])


@by_value
@dataclass(frozen=True)
class Ridge(_Recursion):
    """Exponentially weighted ridge regression with a constant penalty: x = (R + penalty I)^-1 s."""

    penalty: Positive  # above 0; in the unit of the squared regressors, summed over the window
    forgetting: Fraction  # lambda, between 0 and 1

    def __post_init__(self):
        check_fields(self)

    def start(self, unknowns: int) -> tuple[np.ndarray, ...]:
        return np.zeros((unknowns, unknowns)), np.zeros(unknowns), np.zeros(unknowns)

    def fill(self, state, bounds, rows, outputs, *track) -> None:
        settings = float(self.penalty), float(self.forgetting)
        run_ridge(rows, outputs, *settings, *state, *track[:2])
        track[2][:] = self.penalty


Estimator = MinMax | GrowingMinMax | LeastSquares | Ridge


def empty_track(rows) -> tuple[np.ndarray, ...]:
    """Arrays that `fill` takes, one entry per row."""
    return (
        np.zeros(rows.shape),
        np.zeros(len(rows)),
        np.zeros(len(rows)),
        np.zeros(len(rows), dtype=np.int64),
    )
