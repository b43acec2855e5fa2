"""Suspension modes of a twin with its real skyhook loop: weak integrator, notch, lag and delay included."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from experiments.isolation.responses import control_paths, series
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError


@dataclass(frozen=True)
class Modes:
    """Frequencies and relative damping of the suspension modes, by rising frequency."""

    frequencies_hz: Float64[np.ndarray, "modes"]  # of each pair of poles
    damping: Float64[np.ndarray, "modes"]


def suspension_modes(twin: Twin, feedback: bool = True) -> Modes:
    """Poles of the sampled loop that belong to the suspension, none of them overdamped."""
    import control

    open_path = control_paths(twin, feedback=False)[1]
    skyhook = series(twin.skyhook_filter, twin.sample_time)
    gain = control.append(*[skyhook * float(feedback)] * twin.outputs)
    poles = np.linalg.eigvals(control.feedback(np.eye(twin.outputs), open_path * gain).A)
    poles = np.log(poles[np.abs(poles) > 1e-6].astype(complex)) / twin.sample_time
    undamped = np.sqrt(np.linalg.eigvals(np.linalg.solve(twin.plant.mass, twin.plant.stiffness)).real)
    size = np.abs(poles)
    near = (poles.imag > 0) & (size > undamped.min() / 3) & (size < 3 * undamped.max())
    if near.sum() != len(undamped):
        raise InputError(
            f"{near.sum()} oscillating modes near the suspension instead of {len(undamped)}; lower the skyhook gain"
        )
    order = np.argsort(size[near])
    return Modes(size[near][order] / (2 * np.pi), (-poles.real / size)[near][order])
