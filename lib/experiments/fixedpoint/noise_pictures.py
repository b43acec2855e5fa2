"""Pictures of measurement noise: correlations, beliefs of a Kalman filter, tuned filters and their cost."""

from experiments.fixedpoint.oscillator import load_oscillator
from stillwork.control.fixed_point_linear import semi_implicit_motion
from stillwork.estimation.plant import partial_derivatives


def motion_at_rest(sample_time: float):
    """F of x = [velocity, position] for the approximate model at rest, semi-implicit."""
    slopes = partial_derivatives(load_oscillator()["approximate"].plant, 0.0, 0.0, 0.0)
    return semi_implicit_motion(slopes, sample_time)[0]
