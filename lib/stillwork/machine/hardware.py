"""What the model leaves out of a controller's machine: sensor noise and the precision of the processor."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import signal

from stillwork.base.checks import InputError, require_number
from stillwork.control.bandwidth import Loop
from stillwork.control.digital import DigitalController
from stillwork.control.loop_noise import RATIO, SHARE, NoiseBound, crossing_noise, written_noise
from stillwork.control.pid import Pid
from stillwork.machine.single_precision import in_single_precision

ALLOWED_DB = 6.01  # of a loop that is written; the search keeps 6 dB
QUANTISED = 1 / np.sqrt(12)  # rms of the rounding to whole counts
OF_CROSSING = "the output of the gain at the crossover for the noise below it"
ROUNDED = 1.02  # times a bound: the written coefficients are judged by another method than the search


class SensorNoise(NamedTuple):
    """A sensor's noise and what is allowed of it at the output, in the controller's units."""

    rms: float  # of one sample; 0: not known
    basis: str  # of that number, in words
    limit: float  # of the output
    share: float  # of the limit, allowed
    ratio: float  # see `NoiseBound`

    def bound(self, position: float, drive: float) -> NoiseBound:
        """For a machine in other units: `position` and `drive` are the controller's units per unit of the machine."""
        gain = np.inf
        if self.judged_by_limit:
            gain = self.share * self.limit / self.rms * position / drive
        return NoiseBound(float(gain), self.ratio)

    @property
    def judged_by_limit(self) -> bool:
        """Whether noise and limit are both known."""
        return self.rms > 0 and bool(np.isfinite(self.limit))


def sensor_noise(unit: str, limit: float, noise: float, share: float, ratio: float) -> SensorNoise:
    """From the arguments of `design_file`; `ratio` 0: `RATIO` if noise or limit is unknown, else no bound."""
    for name, value in (("noise", noise), ("noise_ratio", ratio)):
        require_number(name, value, at_least=0.0)
    require_number("noise_share", share, above=0.0)
    basis = f"{noise:g} {unit} rms per sample, given" if noise else "unknown: give --noise or --counts"
    if not noise and unit == "count":
        noise, basis = QUANTISED, "rounding to whole counts, 0.289 count rms, white: an assumption"
    found = SensorNoise(noise, basis, limit, share, np.inf)
    ratio = ratio or (np.inf if found.judged_by_limit else RATIO)
    return found._replace(ratio=ratio)


def noise_rows(
    noise: SensorNoise,
    controllers: Sequence[DigitalController],
    loops: Sequence[Loop],
    pid: Pid,
    units: tuple[str, str],
    scales: tuple[float, float],
) -> list[list[str]]:
    """What the written controllers, in their own `units`, make of noise in the closed loop, and what was allowed.

    A unit of the loops' position and drive hold so many of the controllers' as `scales` says; shown is the controller
    with most.

    Raises
    ------
    InputError
        When it is more than what was allowed.
    """
    position, drive = scales
    found = []
    for controller, loop in zip(controllers, loops, strict=True):
        plant = loop.sampled_plant
        plant = replace(plant, b=plant.b / drive, c=plant.c * position, d=plant.d * position / drive)
        gain, largest = written_noise(controller.linear, plant)
        ratio = gain * position / drive / crossing_noise(loop, pid)
        found.append((gain, largest, ratio, abs(float(controller.linear.d[0, 0]))))
    gain, largest, ratio, jump = max(found)
    unit = f"{units[1]}/{units[0]}"
    makes = f"{gain:.3g} {unit} (rms over rms); {ratio:.3g} times {OF_CROSSING}"
    rows = [["noise of the sensor", noise.basis], ["white noise to the output", makes]]
    rows.append(["largest gain", f"{largest:.3g} {unit} at any frequency, {jump:.3g} {unit} within a sample"])
    share = 0.0
    if noise.rms:
        share = gain * noise.rms / noise.limit
        size = f"{gain * noise.rms:.3g} {units[1]} rms"
        rows.append(["noise at the output", size + (f", {100 * share:.2g} % of the limit" if share else "")])
    allowed = []
    if noise.judged_by_limit:
        allowed.append(f"{100 * noise.share:g} % of the limit (--noise-share)")
    if noise.ratio < np.inf:
        allowed.append(f"{noise.ratio:g} times {OF_CROSSING} (--noise-ratio)")
    rows.append(["allowed noise, an assumption", " and ".join(allowed)])
    if (noise.judged_by_limit and share > ROUNDED * noise.share) or ratio > ROUNDED * noise.ratio:
        raise InputError(
            f"noise: white noise passes the written controller with a gain of {makes}; allowed are "
            f"{' and '.join(allowed)}: allow more, or sample faster"
        )
    if share > ROUNDED * SHARE or ratio > ROUNDED * RATIO:
        rows.append(["warning", "this noise is high for an actuator: heat, sound and wear"])
    return rows


def single_rows(
    written: Sequence[DigitalController],
    judged: Sequence[Sequence[tuple[Loop, DigitalController]]],
    scales: tuple[float, float],
) -> list[list[str]]:
    """What single precision changes of the written controllers, each in its own units, and of the peaks of its loops.

    Raises
    ------
    InputError
        When a peak is then above 6 dB, or the error of the output is too large.
    """
    position, drive = scales
    found = [in_single_precision(each) for each in written]
    peaks = [
        peak_with(loop, own, each.rounded.frequency_response(loop.omega)[0, 0] * position / drive)
        for each, pairs in zip(found, judged, strict=True)
        for loop, own in pairs
    ]
    if not max(peaks) <= ALLOWED_DB:
        raise InputError(
            f"precision: with coefficients in single precision the loop peaks at {max(peaks):.3f} dB; use double"
        )
    worst = max(found, key=lambda each: each.error)
    words = f"error of the output {worst.error:.1e} of its rms (states {worst.form}); peaks at most {max(peaks):.3f} dB"
    return [["single precision", words]]


def own_functions(loop: Loop, controller: DigitalController) -> np.ndarray:
    """S_I and S_O with a controller's own matrices, on the loop's grid: shape (2, frequencies)."""
    _, k_y, k_f = controller.model.frequency_response(loop.omega)[0]
    (o_uu, o_uy), _ = loop.compensator_response
    plant = loop.plant_response
    turn = 1 - k_f - k_y * plant  # f = K_r r + K_y y + K_f f + u_ff
    return np.array([1 - o_uu - o_uy * plant, 1 - k_f]) / turn


def peak_with(loop: Loop, controller: DigitalController, response: np.ndarray) -> float:
    """Larger peak of both on the loop's grid, dB, were the controller's response from the error to the output another."""
    _, k_y, k_f = controller.model.frequency_response(loop.omega)[0]
    turn = 1 - k_y / (1 - k_f) * loop.plant_response
    changed = turn / (1 + response * loop.plant_response)
    return float(20 * np.log10(np.abs(own_functions(loop, controller) * changed).max()))


def section_response(sections: np.ndarray, loop: Loop) -> np.ndarray:
    """Response of biquads on the loop's grid."""
    return signal.sosfreqz(sections, loop.omega * loop.sample_time)[1]
