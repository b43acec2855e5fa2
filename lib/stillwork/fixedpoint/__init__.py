"""Noise filters inside fixed-point adaptive control.

Issa, Al-Bkree and Tar, "On certain noise filtering techniques in fixed point iteration-based adaptive
control", Systems Theory, Control and Computing Journal 2(2), 2022, DOI 10.52846/stccj.2022.2.2.38.
"""

from stillwork.fixedpoint.convergence import (
    crossings,
    describing_function,
    iterate,
    limit_cycles,
    random_gain,
    stable_range,
    strongest_oscillation,
)
from stillwork.fixedpoint.differentiation import (
    correlations,
    difference_quotient,
    quotient_autocorrelation,
    quotient_covariance,
    quotient_cross_correlation,
    rejects_gaussian,
    steady_errors,
)
from stillwork.fixedpoint.filtering import filter_signal
from stillwork.fixedpoint.filters import (
    ExtendedKalman,
    LowPass,
    MovingWindow,
    SavitzkyGolay,
    UnscentedKalman,
)
from stillwork.fixedpoint.kinematics import KinematicDesign
from stillwork.fixedpoint.linear import linear_filter, linear_loop
from stillwork.fixedpoint.loop import Controller, Run, response_gain, simulate
from stillwork.fixedpoint.metrics import compare, judge
from stillwork.fixedpoint.models import StateModel, extended_filter, unscented_filter
from stillwork.fixedpoint.noise import PUBLISHED_CASES, Noise
from stillwork.fixedpoint.plant import Plant, VanDerPol, load_oscillator
from stillwork.fixedpoint.published import added_controllers, published_controllers
from stillwork.fixedpoint.trajectory import (
    Trajectory,
    asin_trajectory,
    record_trajectory,
    sine_trajectory,
    trapezoid_trajectory,
)
from stillwork.fixedpoint.transformation import (
    ContractionWarning,
    FlowTransformation,
    RobustTransformation,
    contraction_range,
    deform,
)
from stillwork.fixedpoint.tuning import families, tune
from stillwork.fixedpoint.unscented import SigmaPoints

__all__ = [
    "PUBLISHED_CASES",
    "ContractionWarning",
    "Controller",
    "ExtendedKalman",
    "FlowTransformation",
    "KinematicDesign",
    "LowPass",
    "MovingWindow",
    "Noise",
    "Plant",
    "RobustTransformation",
    "Run",
    "SavitzkyGolay",
    "SigmaPoints",
    "StateModel",
    "Trajectory",
    "UnscentedKalman",
    "VanDerPol",
    "added_controllers",
    "asin_trajectory",
    "compare",
    "contraction_range",
    "correlations",
    "crossings",
    "deform",
    "describing_function",
    "difference_quotient",
    "extended_filter",
    "families",
    "filter_signal",
    "iterate",
    "judge",
    "limit_cycles",
    "linear_filter",
    "linear_loop",
    "load_oscillator",
    "published_controllers",
    "quotient_autocorrelation",
    "quotient_covariance",
    "quotient_cross_correlation",
    "random_gain",
    "record_trajectory",
    "rejects_gaussian",
    "response_gain",
    "simulate",
    "sine_trajectory",
    "stable_range",
    "steady_errors",
    "strongest_oscillation",
    "trapezoid_trajectory",
    "tune",
    "unscented_filter",
]
