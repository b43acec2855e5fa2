"""Simulations that the convergence analysis is held against."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stillwork.fixedpoint.convergence import limit_cycles, strongest_oscillation
from stillwork.fixedpoint.linear import linear_loop
from stillwork.fixedpoint.loop import Controller, simulate
from stillwork.fixedpoint.metrics import noisy_run
from stillwork.fixedpoint.noise import Noise
from stillwork.fixedpoint.plant import Plant
from stillwork.fixedpoint.trajectory import Trajectory
from stillwork.fixedpoint.transformation import FlowTransformation


def at_rest(samples: int, time_step: float) -> Trajectory:
    """A nominal motion that stands still at zero."""
    return Trajectory(time_step, *np.zeros((3, samples)))


def cycles_over_gain(
    plant: Plant, controller: Controller, strengths: Sequence[float], width: float, time_step: float
) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Predicted and simulated limit cycle for each -A: frequency in Hz, amplitude in m/s^2; NaN without one."""
    loop, predicted, simulated = linear_loop(plant, controller, time_step), [], []
    for strength in strengths:
        transformation = FlowTransformation(-strength, width)
        stable = [cycle for cycle in limit_cycles(loop, transformation) if cycle.stable]
        predicted.append((stable[0].frequency_hz, stable[0].iteration_error) if stable else (np.nan, np.nan))
        moved = replace(controller, transformation=transformation)
        run = simulate(plant, moved, at_rest(8000, time_step), start=(0.0, 1e-3))
        tail = slice(4000, None)
        found = strongest_oscillation(run.acceleration_estimate[tail] - run.desired[tail], time_step)
        simulated.append((found.frequency_hz, found.amplitude))
    return predicted, simulated


def divergence_by_noise(
    plant: Plant, controller: Controller, deviations: Sequence[float], runs: int, seed: int
) -> list[float]:
    """Fraction of runs of 12 s at rest that diverge, for each standard deviation of Gaussian noise."""
    still = at_rest(12_000, 1e-3)

    def diverges(stream, deviation) -> bool:
        noise = Noise("gaussian", deviation)
        run = noisy_run(plant, controller, still, noise, np.random.default_rng(stream))
        return run.diverged_at is not None

    streams = np.random.SeedSequence(seed).spawn(runs)
    return [sum(diverges(stream, deviation) for stream in streams) / runs for deviation in deviations]


def response_noise(plant: Plant, controller: Controller, deviation: float, seed: int) -> float:
    """Standard deviation of response - desired at rest in Gaussian noise, m/s^2."""
    run = noisy_run(plant, controller, at_rest(6000, 1e-3), Noise("gaussian", deviation), seed)
    return float(np.std((run.acceleration_estimate - run.desired)[1000:]))
