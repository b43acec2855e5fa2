"""The published fit (2) of the secondary path, held against a twin's own path (section 2.1, Fig. 3)."""

import numpy as np
from jaxtyping import Complex128, Float64
from numpy.typing import ArrayLike
from scipy import optimize, signal

from experiments.isolation.responses import responses
from experiments.isolation.shaping import secondary_path
from experiments.isolation.twin import Twin
from stillwork.base.checks import require_number


def parametric_fit(twin: Twin, frequencies_hz: ArrayLike) -> Complex128[np.ndarray, " frequencies"]:
    """Eq. (2) as Fig. 3 draws it, discretised by Tustin's rule and with one sample of delay; m/s^2 per N."""
    f = np.asarray(frequencies_hz, dtype=float)
    path = secondary_path(twin.feedforward.path, twin.sample_time)
    delay = np.exp(-2j * np.pi * f * twin.sample_time)
    return signal.freqz_sos(path, f, fs=twin.instruments.sample_rate)[1] * delay


def diagonal_path(twin: Twin, frequencies_hz: ArrayLike) -> Complex128[np.ndarray, "actuators frequencies"]:
    """Diagonal elements from command to measured platform acceleration, skyhook loop closed; m/s^2 per N."""
    return np.ascontiguousarray(np.einsum("fii->if", responses(twin, frequencies_hz).secondary))


def dominance(twin: Twin, frequencies_hz: ArrayLike) -> Float64[np.ndarray, " frequencies"]:
    """Least diagonal element of the open 6 × 6 path over the sum of the others in its row, magnitudes.

    Above 1 the path is diagonally dominant in the strict sense. The skyhook loop is open: its diagonal form is
    what the dominance argues for (section 2.1).
    """
    size = np.abs(responses(twin, frequencies_hz, feedback=False).secondary)
    diagonal = np.einsum("fii->fi", size)
    with np.errstate(divide="ignore"):  # struts without cross-coupling: infinite
        return (diagonal / (size.sum(axis=2) - diagonal)).min(axis=1)


def fit_error_db(twin: Twin, frequencies_hz: ArrayLike) -> Float64[np.ndarray, "actuators frequencies"]:
    """Magnitude of the path over that of the fit, dB."""
    ratio = diagonal_path(twin, frequencies_hz) / parametric_fit(twin, frequencies_hz)
    return 20 * np.log10(np.abs(ratio))


def fit_reaches_hz(twin: Twin, above_hz: float, within_db: float = 3.0) -> float:
    """Highest frequency up to which, from `above_hz` on, the fit's magnitude stays within `within_db`."""
    require_number("above_hz", above_hz, above=0.0, below=twin.instruments.sample_rate / 2)
    f = np.arange(above_hz, twin.instruments.sample_rate / 2, 1.0)
    outside = np.any(np.abs(fit_error_db(twin, f)) > within_db, axis=0)
    return float(f[np.argmax(outside)] if outside.any() else f[-1])


def resonance_hz(twin: Twin, low_hz: float, high_hz: float) -> float:
    """Frequency of the highest peak of the first diagonal element between two frequencies, refined."""
    f = np.linspace(low_hz, high_hz, 2001)
    middle = int(np.clip(np.argmax(np.abs(diagonal_path(twin, f)[0])), 1, len(f) - 2))
    found = optimize.minimize_scalar(
        lambda x: -np.abs(diagonal_path(twin, [x])[0, 0]),
        bounds=(f[middle - 1], f[middle + 1]),
        method="bounded",
    )
    return float(found.x)
