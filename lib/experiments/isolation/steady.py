"""Where a twin's adaptation ends and how it gets there, from spectra alone: an oracle for the simulation."""

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike

from experiments.isolation.floors import ShapedFloor
from experiments.isolation.recorded_floors import SpectralFloor
from experiments.isolation.responses import responses
from experiments.isolation.twin import Twin
from stillwork.base.checks import require_array, require_number
from stillwork.estimation.mean_adaptation import Steady, mean_adaptation

FORGETTING = float(np.exp(-2e-4 / 10))  # exp(-Ts / 10 s), Section 5.1.1


def steady_state(
    twin: Twin,
    floor: ShapedFloor | SpectralFloor,
    *,
    forgetting: float = FORGETTING,
    frequencies_hz: ArrayLike | None = None,
) -> Steady:
    """Fixed point, covariance and mean convergence of FeLMS and FeRLS on a floor with independent sensors.

    Mains lines are left out: N has a notch at each.
    """
    require_number("forgetting", forgetting, above=0.0, below=1.0)
    f = require_array(
        "frequencies_hz", default_grid(twin) if frequencies_hz is None else frequencies_hz, ndim=1
    )
    paths = responses(twin, f)
    power = floor.density(f).T
    return mean_adaptation(
        paths,
        _trapezoid(f),
        power[:, :, None] * np.eye(power.shape[1]),
        twin.instruments.floor_noise,
        twin.instruments.platform_noise,
        forgetting,
    )


def default_grid(twin: Twin) -> Float64[np.ndarray, " frequencies"]:
    """Frequencies dense enough for the weak integrators, the suspension and the notches."""
    half = twin.instruments.sample_rate / 2
    return np.unique(
        np.concatenate([np.geomspace(1e-5, 0.9999, 2000) * half, np.linspace(0.0005, 0.9999, 2000) * half])
    )


def _trapezoid(f: np.ndarray) -> np.ndarray:
    """Weights of the trapezoidal rule on a grid."""
    step = np.diff(f)
    return (np.append(step, 0) + np.append(0, step)) / 2
