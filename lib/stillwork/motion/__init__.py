"""Motion: observers that raise the bandwidth of flexible motion systems (the observer thesis).

The public names live in the modules of this package and are imported when they are first used.
"""

from importlib import import_module

_PLACES = {
    "applications": ("Application", "compensator", "soft_sensor"),
    "bandwidth": ("Bandwidth", "Loop", "PeakConstraint", "make_loop", "maximise_bandwidth"),
    "beam": ("beam_shapes", "published_beam"),
    "controller": ("Notch", "Pid", "PidFamily"),
    "decoupled_damping": (
        "band_passed",
        "common_band_passed",
        "constrained_damping",
        "constrained_stiffness",
    ),
    "decoupling": ("Decoupling", "coupling_onset", "decouple", "decoupled_plant", "rigid_coupling"),
    "designs": ("DESIGNS", "Design", "stage_bandwidth", "stage_compensator", "stage_loops", "stage_observer"),
    "discrete_damping": ("discrete_damping_gain", "sampled_feedback"),
    "discrete_observer": ("DiscreteObserver", "discrete_compensator", "discrete_kalman_observer"),
    "feedback": ("band_pass", "damping_gain", "fed_back", "stiffness_gain"),
    "ideal_feedforward": ("feedforward_error", "ideal_force", "invert"),
    "loops": ("LoopResponse", "channel", "closed_loop"),
    "machines": ("chain", "drive", "stage", "stage_mass"),
    "observer": ("Noise", "Observer", "kalman_observer", "published_noise"),
    "performance": ("moving", "rms"),
    "position_dependence": ("at_place", "equivalent_controller", "observer_at", "place_loops"),
    "reduction": ("roll_off", "truncate"),
    "riccati": ("KalmanGain", "continuous_gain", "discrete_gain"),
    "setpoint": ("Setpoint", "point_to_point", "published_setpoint"),
    "tracking": ("Feedforward", "error_loop", "fit_feedforward", "modified_feedforward", "tracking_error"),
}
_MODULES = {name: module for module, names in _PLACES.items() for name in names}

__all__ = sorted(_MODULES)


def __getattr__(name: str):
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
