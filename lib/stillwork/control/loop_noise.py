"""Sensor noise at a controller's output, up to half of the rate."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillwork.base.bounds import Positive
from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.bandwidth import Bandwidth, Loop
from stillwork.control.pid import Pid
from stillwork.lti.discretisation import continuous_poles
from stillwork.lti.norms import h2_norm
from stillwork.lti.peaks import Peak, resonance_grid
from stillwork.lti.state_space import StateModel, interconnect

NOISE = "noise at the output"  # as what stops a bandwidth
SHARE = 0.05  # of the limit that the noise of the sensor may take, root mean square
RATIO = 30.0  # where noise or limit are not known; PID by the rules of the bandwidth has about 6 to 10
DESIGNS = 1.02  # ratio of two bandwidths that are tried on the way down
RESOLVED = 1e-4  # of a bandwidth


@by_value
@dataclass(frozen=True)
class NoiseBound:
    """Allowed output of a controller due to white sensor noise, both as root mean squares.

    Attributes
    ----------
    gain : float
        Largest gain from noise to output, in units of the output over those of the position.
    ratio : float
        Largest ratio of the output to the product of the controller's gain at the crossover and the noise below the crossover:
        the same at every rate, and in every unit.
    """

    gain: Positive = np.inf
    ratio: Positive = np.inf

    def __post_init__(self):
        check_fields(self, infinite=("gain", "ratio"))

    @checked
    def words(self, units: tuple[str, str]) -> list[str]:
        """The same in words, for a machine whose position and drive are in `units`."""
        bounds = []
        if self.gain < np.inf:
            bounds.append(f"at most {self.gain:.3g} {units[1]}/{units[0]}")
        if self.ratio < np.inf:
            bounds.append(
                f"at most {self.ratio:g} times what the gain at the crossing makes of the noise below it"
            )
        return [f"noise of the sensor at the output, rms over rms: {' and '.join(bounds)}"] if bounds else []

    @checked
    def excess(self, loop: Loop, controller: Pid) -> float:
        """The noise at the output over the allowed one; above 1 it is too large."""
        if min(self.gain, self.ratio) == np.inf or not loop.sample_time:
            return 0.0
        gain = noise_gain(loop, controller)
        excess = gain / self.gain
        if self.ratio < np.inf:
            excess = max(
                excess, gain / max(self.ratio * crossing_noise(loop, controller), np.finfo(float).tiny)
            )
        return float(excess)

    @checked(infinite=True)
    def lowered(
        self, loops: Sequence[Loop], family: Callable[[float], Pid], found: Bandwidth
    ) -> tuple[Bandwidth | None, str]:
        """The bandwidth found, or the largest one below it for which the noise of all loops is allowed; or why there is none."""

        def excess(design_hz: float) -> float:
            return max(self.excess(loop, family(design_hz)) for loop in loops)

        bad, most = found.design_hz, excess(found.design_hz)
        if most <= 1:
            return found, ""
        low = found.lowest_hz or found.design_hz / 100
        good = None
        for design_hz in np.geomspace(bad, low, 2 + int(np.log(bad / low) / np.log(DESIGNS)))[1:]:
            if excess(design_hz) <= 1:
                good = float(design_hz)
                break
            bad = float(design_hz)
        if good is None:
            return (
                None,
                f"{NOISE} is {most:.2g} times what is allowed at {found.design_hz:.3g} Hz, and too much below",
            )
        while bad - good > RESOLVED * good:
            middle = (good + bad) / 2
            good, bad = (middle, bad) if excess(middle) <= 1 else (good, middle)
        controller = family(good)
        crossings = np.array([loop.crossing_hz(controller) for loop in loops])
        number = int(np.argmax([self.excess(loop, controller) for loop in loops]))
        lowered = replace(found, design_hz=good, crossing_hz=crossings, controller=controller)
        return replace(lowered, function=NOISE, loop=number, peak=Peak(1.0, 2 * np.pi * good)), ""


UNBOUNDED, USUAL = NoiseBound(), NoiseBound(ratio=RATIO)


@checked
def noise_gain(loop: Loop, controller: Pid) -> float:
    """Root mean square of the output of a closed, sampled loop over that of white noise on its measurement.

    Computed on the loop's grid, which is dense at every mode of plant and observer.
    """
    if not loop.sample_time:
        raise InputError(
            "loop is in continuous time, where white noise has no end; give one with a sample_time"
        )
    response, omega = loop.at(controller), loop.omega
    power = np.abs(response.output_controller * response.output_sensitivity) ** 2
    top = np.pi / loop.sample_time
    area = power[0] * omega[0] + np.trapezoid(power, omega) + power[-1] * (top - omega[-1])
    return float(np.sqrt(area / top))


@checked
def crossing_noise(loop: Loop, controller: Pid) -> float:
    """Likewise for the controller's gain at the first crossing of 0 dB, applied to the noise below it; 0 if there is none."""
    try:
        crossing = loop.crossing_hz(controller)
    except InputError:  # it does not fall through 0 dB
        return 0.0
    gain = np.abs(loop.at(controller, np.array([2 * np.pi * crossing])).output_controller[0])
    return float(gain * np.sqrt(2 * crossing * loop.sample_time))


@checked
def written_noise(written: StateModel, plant: StateModel) -> tuple[float, float]:
    """Root mean square of the output over that of white noise, and its largest at any frequency, of a written controller.

    For a controller's linear map from the error to the output, and a plant, both sampled: the first by a Lyapunov
    equation, the second on a grid.
    """
    loop = interconnect(
        [written, plant],
        np.array([[0.0, -1.0], [1.0, 0.0]]),
        np.array([[-1.0], [0.0]]),
        np.array([[1.0, 0.0]]),
    )
    omega = np.linspace(0, np.pi, 4001)[1:] / loop.sample_time
    omega = np.unique(np.concatenate([omega, np.abs(np.angle(loop.poles)) / loop.sample_time]))
    largest = float(np.abs(loop.frequency_response(omega[omega > 0])[0, 0]).max())
    try:
        return h2_norm(loop), largest
    except (
        InputError
    ):  # its Lyapunov equation has lost its digits, as in small units: an integral over a grid then
        poles = continuous_poles(loop.poles, loop.sample_time)
        top = np.pi / loop.sample_time
        low = max(float(np.abs(poles).min()), 1e-6 * top) / 100
        omega = resonance_grid(poles[poles.imag >= 0], low / (2 * np.pi), 0.999 * top / (2 * np.pi), 2000, 60)
        power = np.abs(loop.frequency_response(omega)[0, 0]) ** 2
        return float(np.sqrt(np.trapezoid(power, omega) / top)), largest
