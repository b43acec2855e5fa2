"""Identification of the rig as in section 6.2: four multisine experiments in closed loop, one modal model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex128, Float64

from experiments.motion.pictures import add_magnitude, paint_magnitudes, plain
from experiments.motion.rig import EdgeDecoupling, Geometry, assumed_geometry, decoupling, rig_model
from experiments.motion.rig_designs import RigSettings, frequencies, published_settings, rig_controllers
from experiments.motion.rig_loops import sampled_controller
from stillwork.control.loops import channel, closed_loop
from stillwork.estimation.observer import NoiseIntensities
from stillwork.identification.multisine import MultisineRecords, ResponseMatrix, joint_input_output
from stillwork.lti.discretisation import zoh_modes, zoh_response
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel
from workbook import figures

ALL = (0, 1, 2, 3)


@dataclass(frozen=True)
class Experiment:
    """All four actuators and sensors of the rig under a slow controller."""

    plant: ModalModel
    decoupling: EdgeDecoupling
    controller: StateModel  # from the errors at the sensors to forces
    noise: NoiseIntensities  # covariances a sample, N^2 and m^2

    def loop(self) -> StateModel:
        """From what is added to the force, w and d to f and y, as `run_multisine` takes it."""
        closed = closed_loop(zoh_modes(self.plant, self.controller.sample_time), None, self.controller)
        seen = channel(closed, ("u_ff", "w", "d"), ("f", "e_meas"), 4, 4)
        # Without a setpoint the measured error is minus the measurement.
        signs = np.repeat([[1.0], [-1.0]], 4, axis=0)
        return StateModel(seen.a, seen.b, signs * seen.c, signs * seen.d, seen.sample_time)

    def response(
        self, omega: Float64[np.ndarray, " lines"]
    ) -> Complex128[np.ndarray, "lines sensors actuators"]:
        """Sampled response of the rig at `omega` (rad/s)."""
        return np.moveaxis(zoh_response(self.plant, self.controller.sample_time, omega), -1, 0)

    def deviation(
        self, omega: Float64[np.ndarray, " lines"], rms: float, averages: int
    ) -> Float64[np.ndarray, "lines sensors actuators"]:
        """Standard deviation that `joint_input_output` must have: exactly what the noise leaves after averaging.

        The error of an experiment is (G w + d) over the excitation, turned by the inverse of the input responses,
        I + C G.
        """
        response = self.response(omega)
        turn = np.eye(4) + np.moveaxis(self.controller.frequency_response(omega), -1, 0) @ response
        seen = self.noise.process * (np.abs(response) ** 2).sum(axis=2) + self.noise.sensor
        return np.sqrt(seen[:, :, None] * (np.abs(turn) ** 2).sum(axis=1)[:, None, :] / (averages * rms**2))

    def bias(self, omega: np.ndarray, response: np.ndarray, top_hz: float) -> float:
        """Mean over the lines up to `top_hz` and over z, rx, ry of the relative error of the decoupled plant.

        Noise averages out of this mean, a bias stays.
        """
        slow = omega <= 2 * np.pi * top_hz
        d = self.decoupling
        ours, true = (
            np.diagonal(d.sensing @ each @ d.actuation, axis1=1, axis2=2)
            for each in (response[slow], self.response(omega[slow]))
        )
        return float(abs(np.mean(ours / true - 1)))

    def convergence(
        self, records: MultisineRecords, top_hz: float, counts: Sequence[int]
    ) -> dict[str, list[float]]:
        """`bias` of the joint and of the direct estimate from the first realisations."""
        found = {"joint input-output": [], "direct": []}
        for count in counts:
            kept = (each[:, :count] for each in (records.reference, records.inputs, records.outputs))
            part = MultisineRecords(records.omega, *kept)
            for name, response in (
                ("joint input-output", joint_input_output(part).response),
                ("direct", direct_response(part)),
            ):
                found[name].append(self.bias(part.omega, response, top_hz))
        return found


def rig_experiment(geometry: Geometry, settings: RigSettings, bandwidth_hz: float) -> Experiment:
    """The experiment with controllers of that design bandwidth in all directions."""
    directions = decoupling(geometry, ALL, ALL)
    pids = rig_controllers(directions.masses)(bandwidth_hz, bandwidth_hz)
    controller = sampled_controller(pids, directions, settings.sample_time)
    return Experiment(rig_model(geometry), directions, controller, settings.noise)


def direct_response(records: MultisineRecords) -> Complex128[np.ndarray, "lines sensors actuators"]:
    """Plant from inputs and outputs alone, S_yf S_ff^-1: biased in closed loop, for comparison."""
    inputs, outputs = records.inputs, records.outputs
    cross, power = (np.einsum("ermal,ermbl->lab", left, inputs.conj()) for left in (outputs, inputs))
    return cross @ np.linalg.inv(power)


def smoothed_deviation(estimate: ResponseMatrix) -> Float64[np.ndarray, " lines"]:
    """Deviation over frequency: root mean square over entries and over fifteen neighbouring lines."""
    power = (estimate.deviation**2).mean(axis=(1, 2))
    kernel = np.ones(15)
    sums = np.convolve(power, kernel, mode="same") / np.convolve(np.ones_like(power), kernel, mode="same")
    return np.sqrt(sums)


def paint_identified(omega: np.ndarray, measured: np.ndarray, model: np.ndarray, deviation: np.ndarray):
    """Actuator 1 to all sensors: measured, fitted, what is left, and what the noise explains: Fig. 6.4."""
    lines = {
        "measured": (measured, {"color": figures.GREEN, "linewidth": 1.6}),
        "model": (model, {"color": figures.BLUE, "linewidth": 0.8}),
        "difference": (measured - model, {"color": figures.GREY, "linewidth": 0.4}),
        "least from noise": (deviation, {"color": figures.BLACK, "linewidth": 0.8, "linestyle": "--"}),
    }
    panels = {
        f"sensor {k + 1}": {name: (omega, values[:, k, 0], style) for name, (values, style) in lines.items()}
        for k in range(4)
    }
    quantity = "actuator 1 to sensor\n(dB re 1 m/N)"
    figure, axes = paint_magnitudes(panels, quantity, rows=2, height=5.0, sharex=True, sharey=True)
    figures.legend_below(axes[0, 0], 4)
    return figure


def paint_identification(rms: float, averages: int, bandwidth_hz: float, sensor_exponent: float):
    """Explorer: response of the rig, and the deviation that an identification in closed loop leaves."""
    settings = published_settings()
    settings = replace(settings, noise=NoiseIntensities(settings.noise.process, 10**sensor_exponent))
    experiment = rig_experiment(assumed_geometry(), settings, bandwidth_hz)
    omega = frequencies(1.0, 1500.0, points=90, around=5)
    response, deviation = experiment.response(omega), experiment.deviation(omega, rms, averages)
    figure, axis = plain()
    add_magnitude(axis, omega, response[:, 2, 0], color=figures.BLUE, label="response")
    add_magnitude(axis, omega, deviation[:, 2, 0], ls="--", color=figures.BLACK, label="least deviation")
    axis.set(xlabel="frequency (Hz)", ylabel="actuator 1 to sensor 3 (dB re 1 m/N)")
    axis.legend()
    return figure
