"""Multisine experiments on a plant in closed loop, and its frequency response matrix without the loop's bias."""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from stillwork.base.bounds import Count, Positive, at_least
from stillwork.base.checks import InputError, pluralise
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel


@checked
def random_phase_multisine(
    rng: np.random.Generator, samples: Annotated[int, at_least(4)], rms: Positive
) -> Float64[np.ndarray, " samples"]:
    """One period of a multisine with equal amplitudes and random phases on every line up to the Nyquist frequency."""
    if samples % 2:
        raise InputError(f"samples is {samples}; give an even number")
    spectrum = np.zeros(samples // 2 + 1, complex)
    lines = samples // 2 - 1
    spectrum[1:-1] = np.exp(2j * np.pi * rng.random(lines))
    return np.fft.irfft(spectrum) * (samples * rms / np.sqrt(2 * lines))


@by_value
@dataclass(frozen=True)
class MultisineRecords:
    """Spectra of the measured periods; one experiment an actuator, several realisations of the phases each."""

    omega: Float64[np.ndarray, " lines"]  # rad/s, of the excited lines
    reference: Complex128[np.ndarray, "experiments realisations lines"]  # what was added to one actuator
    inputs: Complex128[np.ndarray, "experiments realisations periods actuators lines"]
    outputs: Complex128[np.ndarray, "experiments realisations periods sensors lines"]

    def __post_init__(self):
        check_fields(self)
        experiments, realisations, _, actuators, _ = self.inputs.shape
        if experiments != actuators:
            raise InputError(
                f"inputs holds {pluralise(experiments, 'experiment')} for {pluralise(actuators, 'actuator')}; give one each"
            )
        if realisations < 2:
            raise InputError("inputs holds one realisation; a variance takes at least 2")


@checked
def run_multisine(
    loop: StateModel,
    actuators: int,
    sensors: int,
    deviations: tuple[float, float],
    rng: np.random.Generator,
    *,
    samples: int = 16384,
    rms: float = 1.0,
    realisations: Count = 10,
    periods: Count = 2,
    settling: Count = 2,
) -> MultisineRecords:
    """Excite one actuator after the other in closed loop; keep the periods after the settling.

    The discrete loop leads from added force, unmeasured force at the plant (both one an actuator) and sensor noise to
    the commanded forces and the measured outputs; `deviations` are those of the unmeasured force (N) and of the
    sensor noise (m) a sample. For every one of the `realisations` the phases are drawn anew.
    """
    if loop.d.shape != (actuators + sensors, 2 * actuators + sensors):
        raise InputError(
            f"loop has shape {loop.d.shape}; give {actuators + sensors} outputs and the three inputs"
        )
    if not loop.is_stable:
        raise InputError("loop is unstable; identify it with a controller that stabilises it")
    sizes = np.repeat(deviations, [actuators, sensors])
    lines = slice(1, samples // 2)
    reference, inputs, outputs = [], [], []
    for actuator in range(actuators):
        for _ in range(realisations):
            one = random_phase_multisine(rng, samples, rms)
            signals = np.zeros((2 * actuators + sensors, (settling + periods) * samples))
            signals[actuator] = np.tile(one, settling + periods)
            signals[actuators:] = sizes[:, None] * rng.standard_normal(
                (actuators + sensors, signals.shape[1])
            )
            measured = simulate(loop, signals)[:, settling * samples :]
            spectra = np.fft.rfft(measured.reshape(len(measured), periods, samples), axis=2)[:, :, lines]
            reference.append(np.fft.rfft(one)[lines])
            inputs.append(np.moveaxis(spectra[:actuators], 0, 1))
            outputs.append(np.moveaxis(spectra[actuators:], 0, 1))
    shape = (actuators, realisations)
    return MultisineRecords(
        2 * np.pi * np.fft.rfftfreq(samples, loop.sample_time)[lines],
        np.array(reference).reshape(*shape, -1),
        np.array(inputs).reshape(*shape, *inputs[0].shape),
        np.array(outputs).reshape(*shape, *outputs[0].shape),
    )


class ResponseMatrix(NamedTuple):
    """An estimated frequency response matrix."""

    omega: Float64[np.ndarray, " lines"]  # rad/s
    response: Complex128[np.ndarray, "lines sensors actuators"]
    deviation: Float64[np.ndarray, "lines sensors actuators"]  # standard deviation of the complex error


@checked
def joint_input_output(records: MultisineRecords) -> ResponseMatrix:
    r"""Plant from the responses of inputs *and* outputs to the excitation: :math:`G = T_{yr}T_{fr}^{-1}`.

    Every period is averaged at the excited lines and divided by the known excitation. What the loop feeds back of
    the noise is independent of that excitation and averages out of both, so no bias of the loop remains; the
    realisations give the variance.
    """
    t_f, t_y = (
        np.einsum("ermal,erl->rlae", spectra, 1 / records.reference) / spectra.shape[2]
        for spectra in (records.inputs, records.outputs)
    )
    turn = np.linalg.inv(t_f.mean(axis=0))
    response = t_y.mean(axis=0) @ turn
    errors = (t_y - response @ t_f) @ turn
    count = len(errors)
    return ResponseMatrix(
        records.omega, response, np.sqrt((np.abs(errors) ** 2).sum(axis=0) / (count * (count - 1)))
    )
