"""Controllers, loops, bandwidth, observers in the loop, damping, decoupling, feedforward, fixed-point control."""

from stillwork.base.faces import face

__all__, __getattr__, __dir__ = face(
    __name__,
    {
        "applications": ("Application", "compensator", "soft_sensor"),
        "bandwidth": ("Bandwidth", "Loop", "PeakConstraint", "make_loop", "maximise_bandwidth"),
        "decoupled_damping": (
            "band_passed",
            "constrained_damping",
            "constrained_stiffness",
        ),
        "decoupling": ("Decoupling", "coupling_onset", "decouple", "decoupled_plant", "rigid_coupling"),
        "discrete_damping": ("discrete_damping_gain", "sampled_feedback"),
        "discrete_observer": ("DiscreteObserver", "discrete_compensator", "discrete_kalman_observer"),
        "feedback": ("band_pass", "damping_gain", "fed_back", "stiffness_gain"),
        "feedforward": (
            "Feedforward",
            "error_loop",
            "fit_feedforward",
            "modified_feedforward",
            "tracking_error",
        ),
        "fixed_point": ("Controller", "ControlledRun", "response_gain", "simulate"),
        "fixed_point_convergence": (
            "crossings",
            "describing_function",
            "iterate",
            "limit_cycles",
            "random_gain",
            "stable_range",
            "strongest_oscillation",
        ),
        "fixed_point_linear": ("linear_filter", "linear_loop"),
        "ideal_feedforward": ("feedforward_error", "ideal_force", "invert"),
        "kinematics": ("KinematicDesign",),
        "loops": ("LoopResponse", "channel", "closed_loop"),
        "pid": ("Notch", "Pid", "PidFamily"),
        "setpoint": ("Setpoint", "point_to_point"),
        "trajectory": (
            "Trajectory",
            "asin_trajectory",
            "record_trajectory",
            "sine_trajectory",
            "trapezoid_trajectory",
        ),
        "transformation": (
            "ContractionWarning",
            "FlowTransformation",
            "RobustTransformation",
            "contraction_range",
            "deform",
        ),
    },
)
