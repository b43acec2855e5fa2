"""Adaptive filters, estimation under bounded uncertainty, Kalman, robust and optimal observers, low passes."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "adaptive": ("FeLms", "FeRls"),
        "coordinate_filters": ("ExtendedKalman", "LowPass", "UnscentedKalman"),
        "filtering": ("filter_signal",),
        "h2": ("H2Synthesis", "h2_riccati"),
        "least_mean_squares": ("LeastMeanSquares",),
        "min_max": ("min_max_solve",),
        "min_max_regression": ("MinMaxRegressor",),
        "observer": ("NoiseIntensities", "kalman_observer"),
        "online": ("AdaptationStepper", "adapt", "identify"),
        "plant": ("Plant",),
        "recursive": ("track",),
        "recursive_least_squares": ("RecursiveLeastSquares",),
    },
)
