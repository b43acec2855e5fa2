"""Controllers, loops, bandwidth, observers in the loop, damping, decoupling, feedforward, fixed-point control."""

from stillwork.base.lazy_exports import lazy_exports

__all__, __getattr__, __dir__ = lazy_exports(
    __name__,
    {
        "adaptive_control": ("SlotineLi", "simulate_adaptive"),
        "applications": ("Application", "compensator"),
        "bandwidth": ("PeakConstraint", "make_loop", "maximise_bandwidth"),
        "decoupling": ("decouple",),
        "digital": ("DigitalController", "error_driven", "load_controller"),
        "budget": ("Network", "Source", "error_budget", "tone_response"),
        "feedback": ("damping_gain",),
        "feedforward": (
            "Feedforward",
            "Motion",
            "error_loop",
            "fit_feedforward",
            "inverse_gains",
            "tracking_error",
        ),
        "fixed_point": ("Controller", "simulate"),
        "fixed_point_mechanism": ("simulate_mechanism",),
        "floor_machine": ("FloorMachine",),
        "kinematics": ("KinematicDesign",),
        "loops": ("closed_loop",),
        "mechanism": ("Mechanism",),
        "pid": ("PidFamily",),
        "setpoint": ("MoveLimits", "point_to_point"),
        "trajectory": ("asin_trajectory",),
        "transformation": ("DisturbanceObserver", "FlowTransformation"),
        "uncertain_modes": ("uncertain_channel",),
        "uncertainty": ("Uncertainty",),
    },
)
