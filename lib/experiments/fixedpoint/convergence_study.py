"""Simulations that the convergence analysis is compared with."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from experiments.fixedpoint.metrics import noisy_run
from experiments.fixedpoint.noise import Noise
from experiments.fixedpoint.published import INTEGRATION
from stillwork.control.fixed_point import Controller, simulate
from stillwork.control.fixed_point_convergence import limit_cycles, strongest_oscillation
from stillwork.control.fixed_point_linear import linear_loop
from stillwork.control.trajectory import Trajectory
from stillwork.control.transformation import FlowTransformation
from stillwork.estimation.plant import Plant


def at_rest(samples: int, sample_time: float) -> Trajectory:
    """A nominal motion that stands still at zero."""
    return Trajectory(sample_time, *np.zeros((3, samples)))


def cycles_over_gain(
    plant: Plant, controller: Controller, strengths: Sequence[float], width: float, sample_time: float
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Predicted and simulated limit cycle for each -A: frequency in Hz, amplitude in m/s^2; NaN without one."""
    predicted, simulated = [], []
    loop = linear_loop(plant, controller, sample_time, integration=INTEGRATION)
    for strength in strengths:
        transformation = FlowTransformation(-strength, width)
        stable = [cycle for cycle in limit_cycles(loop, transformation) if cycle.stable]
        predicted.append((stable[0].frequency_hz, stable[0].iteration_error) if stable else (np.nan, np.nan))
        moved = replace(controller, transformation=transformation)
        still = at_rest(round(8 / sample_time), sample_time)
        run = simulate(plant, moved, still, start=(0.0, 1e-3), integration=INTEGRATION)
        tail = slice(round(4 / sample_time), None)
        found = strongest_oscillation(run.acceleration_estimate[tail] - run.desired[tail], sample_time)
        simulated.append((found.frequency_hz, found.amplitude))
    return predicted, simulated


def remaining_motion(plant: Plant, controller: Controller, kick: float, sample_time: float) -> float:
    """Largest velocity in the last of 8 s at rest after a kick (m/s), over the kick; infinite when it diverged."""
    still = at_rest(round(8 / sample_time), sample_time)
    run = simulate(plant, controller, still, start=(0.0, kick), integration=INTEGRATION)
    if run.diverged_at is not None:
        return np.inf
    return float(np.abs(run.velocity[round(7 / sample_time) :]).max() / kick)


def divergence_by_noise(
    plant: Plant,
    controller: Controller,
    deviations: Sequence[float],
    runs: int,
    seed: int,
    sample_time: float = 1e-3,
) -> list[float]:
    """Fraction of runs of 12 s at rest that diverge, for each standard deviation of Gaussian noise."""
    still, streams = at_rest(round(12 / sample_time), sample_time), np.random.SeedSequence(seed).spawn(runs)

    def diverges(stream, deviation) -> bool:
        noise = Noise("gaussian", deviation)
        return noisy_run(plant, controller, still, noise, stream).diverged_at is not None

    return [sum(diverges(stream, deviation) for stream in streams) / runs for deviation in deviations]


def response_noise(
    plant: Plant, controller: Controller, deviation: float, seed: int, sample_time: float = 1e-3
) -> float:
    """Standard deviation of response - desired at rest in Gaussian noise, m/s^2; 5 s after the first."""
    still = at_rest(round(6 / sample_time), sample_time)
    run = noisy_run(plant, controller, still, Noise("gaussian", deviation), seed)
    return float(np.std((run.acceleration_estimate - run.desired)[round(1 / sample_time) :]))
