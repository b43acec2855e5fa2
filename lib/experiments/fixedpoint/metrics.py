"""What a run is judged by, and the Monte Carlo over noise seeds."""

from collections.abc import Sequence

import numpy as np

from experiments.fixedpoint.noise import Noise, drop_at_random, drop_samples
from experiments.fixedpoint.published import INTEGRATION
from stillwork.base.checks import InputError, require_number
from stillwork.control.controlled_run import ControlledRun
from stillwork.control.fixed_point import Controller, simulate
from stillwork.control.trajectory import Trajectory, asin_trajectory
from stillwork.estimation.plant import Plant
from workbook.studies import Study, run_study

QUANTITIES = ("position", "velocity", "roughness", "velocity_roughness", "position_shift", "velocity_shift")


def judge(run: ControlledRun, settle: float = 2.0) -> dict[str, float]:
    """Numbers of one run, from `settle` seconds on; all are infinite when the run diverged.

    position, velocity: RMS tracking error, m and m/s. roughness: RMS change of the true acceleration
    from sample to sample, m/s^2: what noisy means here, and the opposite of smooth. velocity_roughness: the
    same of the velocity's error, m/s. position_shift, velocity_shift: by how many seconds the filter's estimate
    runs ahead of the truth (behind: negative): regression of its error on the true velocity, and on the deformed
    acceleration, which is what the controller's model believes the acceleration to be; both averaged over 50
    samples against the noise.
    """
    first = round(require_number("settle", settle, at_least=0) / run.trajectory.sample_time)
    if first > len(run.position) - 51:
        raise InputError(f"settle is {settle:g} s, the run lasts {run.time[-1]:g} s; leave 51 samples")
    if run.diverged_at is not None:
        return dict.fromkeys(QUANTITIES, np.inf)
    part = slice(first, None)
    return {
        "position": _rms(run.position_error[part]),
        "velocity": _rms(run.velocity_error[part]),
        "roughness": _rms(np.diff(run.acceleration[part])),
        "velocity_roughness": _rms(np.diff(run.velocity_error[part])),
        "position_shift": _shift(run.position_estimate - run.position, run.velocity, part),
        "velocity_shift": _shift(run.velocity_estimate - run.velocity, run.deformed, part),
    }


def compare(
    plant: Plant,
    controllers: dict[str, Controller],
    trajectory: Trajectory,
    noise: Noise,
    *,
    runs: int,
    seed: int,
    **options,
) -> dict[str, Study]:
    """Judge every controller over the same `runs` noise records: a study a controller, with the quantities of `judge`.

    The options are those of `noisy_run`. Without noise all records are one, which is run once.
    """
    drawn = 1 if noise.kind == "none" else runs
    settings = {"plant": plant, "trajectory": trajectory, "noise": noise, "progress": False, **options}
    studies = {}
    for name, controller in controllers.items():
        found = run_study(trial, drawn, seed, controller=controller, **settings).values
        repeated = {quantity: np.repeat(each, runs // drawn) for quantity, each in found.items()}
        studies[name] = Study(seed, repeated)
    return studies


def trial(rng: np.random.Generator, **settings) -> dict[str, float]:
    """One run of `noisy_run` with noise from `rng`, judged."""
    return judge(noisy_run(rng=rng, **settings))


def noisy_run(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    noise: Noise,
    rng: np.random.Generator | np.random.SeedSequence | int,
    *,
    lost_every: float = 0.0,
    lost_for: float = 0.0,
    lost_share: float = 0.0,
    **options,
) -> ControlledRun:
    """One run with noise from a generator or a seed, and other options of `control.simulate`.

    Signals are lost as in `noise.drop_samples`, and one by one as in `noise.drop_at_random`.
    """
    rng = np.random.default_rng(rng)
    added = drop_samples(
        noise.sample(rng, len(trajectory.position)), trajectory.sample_time, lost_every, lost_for
    )
    encoder = {"resolution": noise.resolution, "grid": noise.sample_grid(rng)}
    added = drop_at_random(added, lost_share, rng)
    options = {"integration": INTEGRATION, **options}
    return simulate(plant, controller, trajectory, added, **encoder, **options)


def sweep(
    plant: Plant,
    controllers: dict[str, Controller],
    noise: Noise,
    frequencies_hz: Sequence[float],
    *,
    runs: int,
    seed: int,
) -> list[dict[str, Study]]:
    """`compare` on the default trajectory at several frequencies."""
    return [
        compare(plant, controllers, asin_trajectory(frequency_hz=f), noise, runs=runs, seed=seed)
        for f in frequencies_hz
    ]


def _rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _shift(error, derivative, part) -> float:
    error, derivative = _averaged(error[part]), _averaged(derivative[part])
    return float(error @ derivative / (derivative @ derivative))


def _averaged(values):
    return values[: len(values) // 50 * 50].reshape(-1, 50).mean(axis=1)
