"""Noise of numerical differentiation: what this notebook alone needs."""

import numpy as np
from jaxtyping import Bool, Float64

from experiments.fixedpoint import statements as said
from experiments.fixedpoint.choices import PRINTED_NOISE, SAMPLE_TIME, Values, trajectory
from experiments.fixedpoint.differentiation import difference_quotient, quotient_trial, rejects_gaussian
from experiments.fixedpoint.noise import Noise
from workbook.studies import mean_interval, run_study


def encoder_rejected(
    motion: Float64[np.ndarray, " samples"], encoder: Noise, sample_time: float, records: int, seed: int
) -> Bool[np.ndarray, " records"]:
    """In which records, each with another offset of the grid, a differentiated encoder's error is not Gaussian."""
    streams = [np.random.default_rng(stream) for stream in np.random.SeedSequence(seed).spawn(records)]
    errors = (encoder.measure(motion, stream) - motion for stream in streams)
    return np.array([rejects_gaussian(difference_quotient(error, sample_time)) for error in errors])


def differentiation(
    *,
    noise_law: str,
    record_samples: int,
    encoder_step: float,
    trajectory_shape: str,
    trajectory_frequency: float,
    seed: int,
) -> Values:
    """(20), (21) and what is said of the noises, in 40 records as in notebook 05."""
    records, deviation = 40, PRINTED_NOISE["large"]
    study = run_study(
        quotient_trial, records, seed, progress=False, noise=Noise(noise_law, deviation), samples=record_samples,
        sample_time=SAMPLE_TIME,
    )  # fmt: skip
    found: Values = {
        f"fixedpoint.{claim}": (study[quantity].mean(), mean_interval(study[quantity]))
        for claim, quantity in (("eq-20.mean", "mean"), ("eq-21.variance", "variance"))
    }
    beyond = np.abs(study["correlation"]) > 10 / np.sqrt(record_samples)
    motion = trajectory(trajectory_shape, trajectory_frequency, 1.0).position[:record_samples]
    rejected = encoder_rejected(motion, Noise("encoder", encoder_step), SAMPLE_TIME, records, seed)
    return found | {
        "fixedpoint.section-2c.not-independent": said.fraction(beyond),
        "fixedpoint.section-4.encoder-not-gaussian": said.fraction(rejected),
    }
