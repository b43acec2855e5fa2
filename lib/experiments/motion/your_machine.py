"""What an observer would give on a machine of one's own: from its file to the achievable bandwidths."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from experiments.motion.structure import extra_turns, observed_loops, on_measurement
from stillwork.base.checks import InputError, require_count, require_number
from stillwork.control.applications import Application
from stillwork.control.bandwidth import Bandwidth, Loop, PeakConstraint, maximise_bandwidth
from stillwork.control.pid import PidFamily
from stillwork.estimation.observer import NoiseIntensities
from stillwork.identification.machine import Machine, whole_band
from stillwork.identification.modal_fit import ModalFit

SEARCH = (1 / 40, 1.0)  # of the first resonance: where bandwidths are sought


@dataclass(frozen=True)
class Intensities:
    """What the observer is designed for, as accelerations of the rigid body, so that it fits any mass.

    Attributes
    ----------
    disturbance : float
        m/s^2, root of the intensity of the force disturbance over the mass.
    sensor : float
        m, root of the intensity of the sensor noise.
    drift : float
        (m/s^2)^2/s, intensity of the random walk of the disturbance that gives MC its integral action.
    """

    disturbance: float
    sensor: float
    drift: float

    def __post_init__(self):
        for name in ("disturbance", "sensor", "drift"):
            require_number(name, getattr(self, name), above=0.0)

    def noise(self, mass: float) -> NoiseIntensities:
        """The same for a machine of `mass` (kg)."""
        return NoiseIntensities((self.disturbance * mass) ** 2, self.sensor**2)


def applications(added_damping: float, selectivity: float) -> dict[str, Application | None]:
    """PID alone, measurement compensation (MC), active damping (AD), and both."""
    damped = {"damping": added_damping, "selectivity": selectivity}
    return {
        "PID": None,
        "MC": Application(compensate=True),
        "AD": Application(**damped),
        "MC and AD": Application(compensate=True, **damped),
    }


def observer_settings(
    machine: Machine, application: Application | None, retained: int, intensities: Intensities
) -> tuple[int, NoiseIntensities, float | None]:
    """Modes in the observer, its noise, and the intensity of its noise model, which only MC has."""
    retained = min(require_count("retained", retained, at_least=2), len(machine.sensors[0].frequencies))
    compensates = application is not None and application.compensate
    drift = intensities.drift * machine.mass**2 if compensates else None
    return retained, intensities.noise(machine.mass), drift


@dataclass(frozen=True)
class Reached:
    """How far one use of the observer gets.

    Attributes
    ----------
    on_model, on_measurement : Bandwidth, optional
        None where no bandwidth is feasible, and without a measurement.
    extra_turns : int, optional
        Turns around -1 that the measured open loops make more than those of the model: 0 proves stability.
    loops : tuple of Loop
        One a sensor; on the measurement where there is one.
    reason : str
        Why no bandwidth was found; empty when one was.
    """

    on_model: Bandwidth | None
    on_measurement: Bandwidth | None
    extra_turns: int | None
    loops: tuple[Loop, ...]
    reason: str = ""

    @property
    def best(self) -> Bandwidth | None:
        """On the measurement where there is one."""
        return self.on_model if self.extra_turns is None and not self.reason else self.on_measurement

    @property
    def summary(self) -> dict[str, str]:
        """One row of a table, rounded; bandwidths from the lowest sensor to the highest."""
        row = {"on the model (Hz)": _span(self.on_model)}
        if self.on_measurement is not None or self.reason:
            row["on the measurement (Hz)"] = _span(self.on_measurement)
        if self.best is not None:
            sensitivity = {"input_sensitivity": "S_I", "output_sensitivity": "S_O"}
            name = sensitivity.get(self.best.function, self.best.function)
            row["stopped by"] = (
                f"{name} of sensor {self.best.loop + 1} at {self.best.peak.omega / (2 * np.pi):.0f} Hz"
            )
        if self.extra_turns is not None:
            row["extra turns"] = str(self.extra_turns)
        return row


def reach(
    machine: Machine,
    chosen: Mapping[str, Application | None],
    *,
    retained: int,
    intensities: Intensities,
    loop_hz: tuple[float, float] = (0.0, 0.0),
    search_hz: tuple[float, float] = (0.0, 0.0),
) -> dict[str, Reached]:
    """Largest bandwidth of every use that keeps both sensitivities of every sensor below 6 dB.

    Parameters
    ----------
    machine : Machine
    chosen : mapping of str to Application
        See `applications`.
    retained : int
        At most so many modes in the observer, the rigid body included; the others enter as compliance.
    intensities : Intensities
        For which the observer is made.
    loop_hz : tuple of float
        Band in which the measurement stands for the plant; (0, 0) for that of the fit.
    search_hz : tuple of float
        Range of the design parameter; (0, 0) for 1/40 of the first resonance to all of it.

    Raises
    ------
    InputError
        For bad settings. A use without any feasible bandwidth is a result, see `Reached.reason`.
    """
    band = None
    if machine.measured is not None:
        band = whole_band(machine.measured, loop_hz if any(loop_hz) else _ends(machine.fit))
    low, high = search_hz if any(search_hz) else (share * machine.resonances_hz[0] for share in SEARCH)
    family = PidFamily(machine.mass)
    limits = [PeakConstraint(name) for name in ("input_sensitivity", "output_sensitivity")]
    found = {}
    for name, application in chosen.items():
        settings = observer_settings(machine, application, retained, intensities)
        loops = observed_loops(machine.sensors, application, *settings)
        on_model, reason = _search(loops, family, limits, low, high, refine=True)
        on_data, turns = None, None
        if band is not None:
            loops = [
                on_measurement(loop, machine.measured, 1.0, band, mirror)
                for loop, mirror in zip(loops, machine.mirrored, strict=True)
            ]
            on_data, reason = _search(loops, family, limits, low, high, refine=False)
            if on_data is not None:
                turns = sum(abs(extra_turns(loop, on_data.controller)) for loop in loops)
        found[name] = Reached(on_model, on_data, turns, tuple(loops), reason)
    return found


def _search(loops, family, limits, low, high, *, refine) -> tuple[Bandwidth | None, str]:
    try:
        return maximise_bandwidth(
            loops, family, limits, low, high, tolerance_hz=1e-4 * low, refine=refine
        ), ""
    except InputError as error:
        return None, str(error)


def _span(bandwidth: Bandwidth | None) -> str:
    if bandwidth is None:
        return "none"
    low, high = (f"{pick(bandwidth.crossing_hz):.1f}" for pick in (np.min, np.max))
    return low if low == high else f"{low} to {high}"


def _ends(fit: ModalFit) -> tuple[float, float]:
    return float(fit.omega[0] / (2 * np.pi)), float(fit.omega[-1] / (2 * np.pi))
