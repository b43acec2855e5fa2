"""The bound of min-max estimation chosen by cross-validation, and how sure the choice is."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float64

from stillwork.base.bounds import Count, Fraction, Matrix, Natural, Vector, at_least
from stillwork.base.checks import InputError, pluralise
from stillwork.base.validation import by_value, checked
from stillwork.estimation.min_max import qr_r, solve_sweep
from stillwork.estimation.secular import secular_function


@by_value
@dataclass(frozen=True)
class BoundChoice:
    """What cross-validation says of the bounds that were tried.

    The interval holds the best bound when the folds are drawn anew. It needs a dozen rows an unknown: on shorter records
    it misses the bound that predicts best more often than it says.
    """

    bounds: Float64[np.ndarray, " tried"]  # eta for all rows, rising
    errors: Float64[np.ndarray, " tried"]  # held-out residual over the target, rms; 1: the zero model
    interval: tuple[float, float]  # of bounds

    @property
    def best(self) -> float:
        """The bound with the smallest held-out residual."""
        return float(self.bounds[np.argmin(self.errors)])

    @property
    def on_edge(self) -> bool:
        """Whether it is the first or the last that was tried: then the best bound was not found.

        At the lower edge doubt does not help the prediction; at the upper one nothing is learned.
        """
        return bool(np.argmin(self.errors) in (0, len(self.errors) - 1))


@checked
def choose_bound(
    matrix: Matrix,
    target: Vector,
    bounds: Vector | None = None,
    *,
    folds: Annotated[int, at_least(2)] = 10,
    coverage: Fraction = 0.95,
    draws: Count = 1000,
    seed: Natural = 0,
) -> BoundChoice:
    """Choose eta by what min-max estimates predict: each stretch of the rows is held out once.

    Parameters
    ----------
    matrix : array_like, shape (rows, unknowns)
        A, in the order of time: neighbours stay together.
    target : array_like, shape (rows,)
        b.
    bounds : array_like, shape (tried,), optional
        Rising bounds for all rows, those of a fold's fit are smaller by the square root of its share; without, 25
        from a thousandth of |A'b| / |b|, from which the estimate is zero, to this.
    folds : int
        Stretches, 2 at least.
    coverage : float
        Of the interval, by bootstrap over the folds.
    draws, seed : int
        Of the bootstrap.

    Returns
    -------
    BoundChoice
        Its `best` predicts about as well as any bound where there are fifty rows an unknown, less surely with fewer.

    Raises
    ------
    InputError
        For data that do not fit together, or too few rows for a fit without one stretch.

    References
    ----------
    Stone, Cross-validatory choice and assessment of statistical predictions (1974).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> clean, noise = rng.standard_normal((2, 100, 4))
    >>> target = clean @ [1.0, -1.0, 1.0, -1.0] + rng.standard_normal(100)
    >>> choice = estimation.choose_bound(clean + 0.5 * noise, target)
    >>> choice.interval[0] <= choice.best <= choice.interval[1]
    True
    """
    rows, unknowns = matrix.shape
    tail = (1 - coverage) / 2
    if rows - -(-rows // folds) <= unknowns:
        raise InputError(
            f"matrix has {pluralise(rows, 'row')}, too few to fit {pluralise(unknowns, 'unknown')} without one of {pluralise(folds, 'fold')}"
        )
    threshold = secular_function(matrix, target, 0.0).threshold
    tried = np.geomspace(1e-3, 1, 25) * threshold if bounds is None else bounds
    if len(tried) < 2 or tried[0] < 0 or np.any(np.diff(tried) <= 0):
        raise InputError(
            "bounds does not rise from zero or above; give at least two, each above the one before"
        )
    # Of a stretch its triangle says the same as all its rows.
    stretches = np.array_split(np.column_stack([matrix, target]), folds)
    corners = [qr_r(stretch) for stretch in stretches]
    squares = np.empty((folds, len(tried)))
    for out, held in enumerate(corners):
        kept = qr_r(np.vstack(corners[:out] + corners[out + 1 :]))
        fitted, aimed = np.ascontiguousarray(kept[:, :-1]), np.ascontiguousarray(kept[:, -1])
        share = np.sqrt(1 - len(stretches[out]) / rows)
        for place, solution in enumerate(solve_sweep(fitted, aimed, share * tried)):
            squares[out, place] = np.sum((held[:, -1] - held[:, :-1] @ solution.estimate) ** 2)
    rng = np.random.default_rng(seed)
    times = rng.multinomial(folds, np.full(folds, 1 / folds), draws)
    best = tried[np.argmin(times @ squares, axis=1)]
    low, high = np.quantile(best, [tail, 1 - tail], method="nearest")
    errors = np.sqrt(squares.sum(axis=0)) / np.linalg.norm(target)
    return BoundChoice(tried, errors, (float(low), float(high)))
