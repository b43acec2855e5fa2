"""Models of an input-output record of one's own: fitted, the bound chosen, and judged on unseen data."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from experiments.worstcase.pairs import Pair, residual
from experiments.worstcase.total import total_least_squares
from stillwork.base.checks import InputError, counted, require_array, require_count
from stillwork.estimation.min_max import solve_sweep, triangle
from stillwork.estimation.recursive import run_silently
from stillwork.estimation.recursive_settings import LeastSquares, MinMax
from stillwork.identification.regressors import exponential_bound, exponential_weights, fir_regressors

PARTS = (0.5, 0.25, 0.25)  # of the record: to fit, to choose the bound, to judge


@dataclass(frozen=True)
class Fitted:
    """Models of one record from its first part, and how they do on its last."""

    # impulse responses by method, output unit per input unit
    estimates: dict[str, Float64[np.ndarray, " taps"]]
    # inside, held_out: rms residual over rms output where the model was fitted, and on the last part; 1 is
    # the zero model
    inside: dict[str, float]
    held_out: dict[str, float]
    bounds: dict[str, float]  # eta of each min-max estimate, in the input's unit
    threshold: float  # from this bound on the estimate is zero, in the input's unit
    factors: Float64[np.ndarray, " factors"]  # bounds of the sweep over the typical bound
    # choosing, judging: residual of each on the part for choosing and on the last part
    choosing: Float64[np.ndarray, " factors"]
    judging: Float64[np.ndarray, " factors"]

    @property
    def chosen(self) -> float:
        """Factor with the smallest residual on the part for choosing."""
        return float(self.factors[np.argmin(self.choosing)])


def fit_pair(pair: Pair, taps: int, memory: int, factors: np.ndarray | None = None) -> Fitted:
    """FIR models by RLS, min-max and total least squares from the first half of a record, judged on the last quarter.

    The recursive estimators run over the first half and end with the exponential weights of their memory; total least
    squares takes its last `memory` samples. The bound is swept with the same weights, over these `factors` of the
    typical bound, and chosen on the third quarter, which no model was fitted to and none is judged on.
    """
    taps, memory = require_count("taps", taps), require_count("memory", memory, at_least=2)
    scaled = pair.normalised
    fit, choose, judge = parts(len(scaled.input))
    if memory <= 2 * taps or memory > fit.stop:
        raise InputError(
            f"memory is {counted(memory, 'sample')}; give more than {2 * taps} (twice the taps) and at most {fit.stop} (the part "
            "of the record that is fitted)"
        )
    regressors, output = fir_regressors(scaled.input, taps), scaled.output
    forgetting = 1 - 1 / memory
    typical = scaled.typical_bound(taps, forgetting)
    bounds = {
        "min-max, typical bound": typical,
        "min-max, guaranteed bound": exponential_bound(3 * np.sqrt(taps), forgetting),
    }
    estimators = {"RLS": LeastSquares(forgetting, 1.0)}
    estimators |= {name: MinMax(bound, forgetting) for name, bound in bounds.items()}
    estimates = {
        name: run_silently(estimator, regressors[:, fit], output[fit]).estimates[:, -1]
        for name, estimator in estimators.items()
    }
    last = slice(fit.stop - memory, fit.stop)
    estimates["total least squares"] = total_least_squares(regressors[:, last].T, output[last])
    matrix, target = weighted_corner(regressors[:, fit], output[fit], forgetting)
    factors = np.geomspace(0.01, 10, 25) if factors is None else require_array("factors", factors, ndim=1)
    swept = solve_sweep(matrix, target, factors * typical)
    choosing, judging = (
        np.array([residual(regressors[:, part].T, output[part], one.estimate) for one in swept])
        for part in (choose, judge)
    )
    best = int(np.argmin(choosing))
    bounds["min-max, chosen bound"] = float(factors[best]) * typical
    estimates["min-max, chosen bound"] = swept[best].estimate
    return Fitted(
        {name: pair.gain * estimate for name, estimate in estimates.items()},
        *(
            {name: residual(regressors[:, part].T, output[part], one) for name, one in estimates.items()}
            for part in (last, judge)
        ),
        {name: pair.noise[0] * bound for name, bound in bounds.items()},
        pair.noise[0] * swept[0].threshold,
        factors,
        choosing,
        judging,
    )


def parts(samples: int) -> tuple[slice, slice, slice]:
    """The stretches of a record to fit, to choose the bound, and to judge."""
    first, second = round(PARTS[0] * samples), round((PARTS[0] + PARTS[1]) * samples)
    return slice(0, first), slice(first, second), slice(second, samples)


def weighted_corner(regressors, output, forgetting: float) -> tuple[np.ndarray, np.ndarray]:
    """Square A and b that say the same as all exponentially weighted rows: a rotation changes no residual."""
    weights = exponential_weights(len(output), forgetting)[:, None]
    corner = triangle(np.column_stack([regressors.T, output]) * weights)
    return corner[:, :-1].copy(), corner[:, -1].copy()


def window_lengths(taps: int, samples: int) -> list[int]:
    """Training windows from hardly longer than the model to an eighth of the record, at most 6400 samples."""
    longest = min(6400, samples // 8)
    if longest < 2 * taps:
        raise InputError(
            f"the record holds {counted(samples, 'sample')}, too few for {counted(taps, 'tap')}; give {16 * taps} samples or at most "
            f"{samples // 16} taps"
        )
    return np.unique(np.geomspace(1.25 * taps, longest, 7).round().astype(int)).tolist()
