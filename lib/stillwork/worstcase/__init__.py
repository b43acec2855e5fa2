"""Exponentially weighted min-max estimation: parameters from data whose regressors are known to a bound.

Work: A. H. Sayed, A. Garulli, V. H. Nascimento, S. Chandrasekaran, "Exponentially-weighted iterative
solutions for worst-case parameter estimation".
"""

from stillwork.worstcase.batch import MinMaxSolution, ZeroEstimateWarning, min_max_solve
from stillwork.worstcase.cone import solve_cone_program
from stillwork.worstcase.estimators import GrowingMinMax, LeastSquares, MinMax, Ridge, Track
from stillwork.worstcase.recursive import Stepper, run, worst_case_residuals
from stillwork.worstcase.regressors import (
    arx_regressors,
    exponential_bound,
    fir_regressors,
    noise_bound,
    row_bound,
)
from stillwork.worstcase.secular import SecularFunction, secular_function
from stillwork.worstcase.total import TotalLeastSquaresSolution, total_least_squares

__all__ = [
    "GrowingMinMax",
    "LeastSquares",
    "MinMax",
    "MinMaxSolution",
    "Ridge",
    "SecularFunction",
    "Stepper",
    "TotalLeastSquaresSolution",
    "Track",
    "ZeroEstimateWarning",
    "arx_regressors",
    "exponential_bound",
    "fir_regressors",
    "min_max_solve",
    "noise_bound",
    "row_bound",
    "run",
    "secular_function",
    "solve_cone_program",
    "total_least_squares",
    "worst_case_residuals",
]
