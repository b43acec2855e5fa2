"""Adaptive filters, estimation under bounded doubt, Kalman, robust and optimal observers, low passes."""

from stillwork.base.faces import face

__all__, __getattr__, __dir__ = face(
    __name__,
    {
        "adaptive": ("FeLms", "FeRls"),
        "coordinate_filters": (
            "ExtendedKalman",
            "LowPass",
            "MovingWindow",
            "SavitzkyGolay",
            "UnscentedKalman",
        ),
        "filtering": ("filter_signal",),
        "min_max": ("MinMaxSolution", "ZeroEstimateWarning", "min_max_solve"),
        "nonlinear": ("NonlinearModel", "extended_filter", "unscented_filter"),
        "observer": ("NoiseIntensities", "Observer", "kalman_observer"),
        "online": (
            "Adaptation",
            "AdaptationStepper",
            "UnstableAdaptation",
            "adapt",
            "identify",
            "steady_covariance",
        ),
        "plant": ("Plant",),
        "recursive": ("RecursiveStepper", "run", "worst_case_residuals"),
        "recursive_settings": ("GrowingMinMax", "LeastSquares", "MinMax", "Ridge", "Track"),
        "riccati": ("KalmanGain", "continuous_gain", "discrete_gain"),
        "secular": ("SecularFunction", "secular_function"),
        "unscented": ("SigmaPoints",),
    },
)
