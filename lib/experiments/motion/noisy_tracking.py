"""A move of several loops under one noise, section 3.5.2 of the observer thesis."""

import numpy as np

from stillwork.control.feedforward import Feedforward, error_loop, noise_error, tracking_error
from stillwork.control.setpoint import Setpoint
from stillwork.lti.state_space import StateModel
from stillwork.signals.moving_average import rms


def noisy_scan_trial(
    rng: np.random.Generator,
    loops: dict[str, StateModel],
    setpoint: Setpoint,
    feedforward: Feedforward,
    deviations: dict[str, float],
    warm_up: int = 3000,
) -> dict[str, float]:
    """Rms of the true error in the scan (m) of several loops with modified feedforward under one noise realisation."""
    seed = rng.integers(2**63)  # every loop meets the same noise
    samples = warm_up + setpoint.derivatives.shape[1]
    found = {}
    for name, loop in loops.items():
        noise = noise_error(loop, setpoint.step, samples, deviations, np.random.default_rng(seed))[
            0, warm_up:
        ]
        error = tracking_error(error_loop(loop), setpoint, feedforward) + noise
        found[name] = rms(error[setpoint.scanning])
    return found
