"""How the platform moves in z, θx and θy: transmissibility and spectra, measured and exact (section 5.2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import signal

from experiments.isolation.floors import ShapedFloor
from experiments.isolation.recorded_floors import RecordedFloor, SpectralFloor
from experiments.isolation.responses import responses
from experiments.isolation.rig import Rig
from experiments.isolation.simulation import simulate_together
from experiments.isolation.steady import steady_state
from experiments.isolation.twin import Twin
from stillwork.base.checks import InputError, require_array, require_choice, require_number
from stillwork.estimation.adaptive import FeLms, FeRls
from stillwork.signals.criteria import BAND_EDGE
from stillwork.signals.spectra import ResponseEstimate, Spectrum, estimate_response, estimate_spectrum

DIRECTIONS = ("z", "θx", "θy")
_ROWS = [2, 3, 4]  # of (x, y, z, θx, θy, θz)
CASES = ("passive", "feedback", "FeLMS", "FeRLS")
SETTLE_S = 5.0  # start of a record that is cut off: two dozen time constants of the weak integrators


@dataclass(frozen=True)
class Axes:
    """From sensor readings to motion of a rigid body in z, θx, θy about the centre of mass."""

    floor: Float64[np.ndarray, "3 sensors"]
    platform: Float64[np.ndarray, "3 outputs"]
    floor_readings: Float64[np.ndarray, "sensors 3"]  # readings of the floor sensors per motion of the plate


def central_axes(rig: Rig | None) -> Axes:
    """Axes of a rig; motions of the floor plate that its sensors do not measure count as rest."""
    if rig is None:
        raise InputError("the model has no geometry, so no z, θx and θy; take one with a body and struts")
    readings = rig.floor_sensors.jacobian[:, _ROWS]
    platform = np.linalg.pinv(rig.platform_sensors.jacobian)[_ROWS]
    return Axes(np.linalg.pinv(readings), platform, readings)


@dataclass(frozen=True)
class CaseRecord:
    """What the sensors show of one case, in z, θx, θy (m/s^2 and rad/s^2), noise included."""

    floor: Float64[np.ndarray, "3 samples"]  # accelerations
    platform: Float64[np.ndarray, "3 samples"]
    sample_rate: float  # Hz

    def spectrum(self, resolution_hz: float) -> Spectrum:
        """Spectrum of the platform."""
        return estimate_spectrum(self.platform, self.sample_rate, resolution_hz)

    def response(self, resolution_hz: float) -> ResponseEstimate:
        """Transmissibility from floor to platform."""
        return estimate_response(self.floor, self.platform, self.sample_rate, resolution_hz)

    def output_noise(self, resolution_hz: float) -> Spectrum:
        """Spectrum of the platform that no filter of the floor signals explains: the feedforward's limit."""
        found = self.response(resolution_hz)
        return Spectrum(found.frequencies_hz, found.residual, found.averages)


def tune(
    twin: Twin, floor: ShapedFloor, felms_s: float | None, ferls_s: float | None, seeds: Sequence[int]
) -> list[dict[str, Float64[np.ndarray, "actuators regressors"]]]:
    """For each seed the weights that FeLMS and FeRLS reach from zero with the published settings, each in its own time.

    Without its time an algorithm is left out.
    FeRLS starts from ten times the steady covariance's diagonal, section 5.1.1.
    """
    covariance = 10 * np.diag(steady_state(twin, floor).covariance)
    found: list[dict] = [{} for _ in seeds]
    for name, settings, seconds in (("FeLMS", FeLms(), felms_s), ("FeRLS", FeRls(covariance), ferls_s)):
        if seconds is None:
            continue
        options = {"adaptations": {name: settings}, "seeds": seeds, "keep_every_s": seconds}
        runs = simulate_together(twin, floor, seconds, **options)
        for weights, run in zip(found, runs, strict=True):
            weights[name] = run[name].final_weights
    return found


def record_case(
    twin: Twin,
    floor: ShapedFloor | RecordedFloor,
    name: str,
    duration_s: float,
    seed: int,
    **options,
) -> CaseRecord:
    """Record one of `CASES` with frozen weights; runs with the same seed see the same floor and sensor noise.

    ``passive`` opens the skyhook loop; without weights there is no feedforward. The first 5 s, of settling, are not
    kept. The `options` are those of `record_cases`.
    """
    return record_cases(twin, floor, name, duration_s, [seed], **options)[0]


def record_cases(
    twin: Twin,
    floor: ShapedFloor | RecordedFloor,
    name: str,
    duration_s: float,
    seeds: Sequence[int],
    *,
    weights: ArrayLike | None = None,
    noise: bool = True,
) -> list[CaseRecord]:
    """`record_case` for each seed, side by side; `weights` are those of all, or one W for each seed."""
    require_choice("name", name, CASES)
    require_number("duration_s", duration_s, above=0.0)
    axes = central_axes(twin.rig)
    runs = simulate_together(
        twin,
        floor,
        SETTLE_S + duration_s,
        seeds=seeds,
        adaptations={name: None},
        weights=weights,
        feedback=name != "passive",
        noise=noise,
        signals_from_s=SETTLE_S,
        signals=("sensed_floor", "measured_platform"),
    )
    return [
        CaseRecord(axes.floor @ run.sensed_floor, axes.platform @ run.measured_platform, run.sample_rate)
        for run in (each[name] for each in runs)
    ]


def diagonal_size(response: ArrayLike) -> Float64[np.ndarray, "3 frequencies"]:
    """Magnitude from each motion of the floor to the same one of the platform."""
    return np.abs(np.einsum("iif->if", np.asarray(response)))


def expected_density(
    twin: Twin,
    floor: ShapedFloor | SpectralFloor,
    frequencies_hz: ArrayLike,
    *,
    weights: ArrayLike | None = None,
) -> dict[str, Float64[np.ndarray, "3 frequencies"]]:
    """Spectrum that the platform's sensors show in z, θx, θy by cause, without simulation and without mains.

    The causes are ``floor``, ``floor noise`` (n0 through the feedforward) and ``output noise`` (n1, also through the
    skyhook loop), each (m/s^2)^2/Hz or (rad/s^2)^2/Hz; they are independent, so their sum is the spectrum.
    """
    axes = central_axes(twin.rig)
    paths = responses(twin, frequencies_hz)
    command = paths.feedforward(weights)
    by_floor = axes.platform @ (paths.primary + command)
    by_sensors = axes.platform @ command
    # n1 reaches the reading directly and through the loop: (I + L)^-1 = I - P2 K.
    rate = twin.instruments.sample_rate
    skyhook = signal.freqz_sos(twin.skyhook_filter, paths.frequencies_hz, fs=rate)[1]
    sensitivity = np.eye(twin.outputs) - paths.secondary * skyhook[:, None, None]
    by_output = axes.platform @ (sensitivity * paths.conditioning[:, None, None])
    return {
        "floor": _power(by_floor, floor.density(paths.frequencies_hz).T),
        "floor noise": _power(by_sensors, twin.instruments.floor_noise**2),
        "output noise": _power(by_output, twin.instruments.platform_noise**2),
    }


def reduction_db(
    frequencies_hz: ArrayLike, before: ArrayLike, after: ArrayLike
) -> tuple[Float64[np.ndarray, " bands"], Float64[np.ndarray, "3 bands"]]:
    """Centres of the one-third-octave bands from 3 to 200 Hz, and the reduction of a transmissibility's diagonal in each.

    Responses have shape (3, 3, frequencies), evenly spaced, at most 0.5 Hz apart; positive is less vibration.
    """
    f = require_array("frequencies_hz", frequencies_hz, ndim=1)
    centres, inside = third_octaves(f)
    squares = [diagonal_size(response) ** 2 for response in (before, after)]
    means = [np.stack([square[:, band].mean(axis=1) for band in inside], axis=1) for square in squares]
    return centres, 10 * np.log10(means[0] / means[1])


def third_octaves(f: np.ndarray) -> tuple[Float64[np.ndarray, " bands"], list[np.ndarray]]:
    """Centres of the one-third-octave bands from 3.2 to 203 Hz, and which frequencies lie in each."""
    centres = 2.0 ** (np.arange(5, 24) / 3)
    return centres, [(f >= centre / BAND_EDGE) & (f < centre * BAND_EDGE) for centre in centres]


def _power(gain, density):
    """Sum over independent sources of |gain|^2 density, (3, frequencies); density (frequencies, sources) or 1."""
    power = np.abs(gain) ** 2 * np.reshape(density, (-1, 1, np.size(density) // len(gain) or 1))
    return np.ascontiguousarray(power.sum(axis=2).T)
