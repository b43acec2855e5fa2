"""Noise of the measured coordinate."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from stillwork.base.checks import InputError, require_choice, require_count, require_number

KINDS = ("none", "gaussian", "logistic", "logistic-scale", "encoder")

# A logistic distribution of scale s has standard deviation s pi / sqrt(3).
LOGISTIC_DEVIATION = math.pi / math.sqrt(3)


@dataclass(frozen=True)
class Noise:
    """Noise of one kind; samples are independent."""

    # ``none``; ``gaussian`` and ``logistic``: `amplitude` is the standard deviation; ``logistic-scale``:
    # `amplitude` is the scale s, the standard deviation 1.814 s; ``encoder``: the position is rounded to a
    # multiple of `amplitude`
    kind: str = "none"
    amplitude: float = 0.0  # m

    def __post_init__(self):
        require_choice("noise kind", self.kind, KINDS)
        if self.kind == "none":
            require_number("noise amplitude", self.amplitude, at_least=0, at_most=0)
        else:
            require_number("noise amplitude", self.amplitude, above=0)

    @property
    def resolution(self) -> float:
        """Step of the encoder, m; 0 without one."""
        return self.amplitude if self.kind == "encoder" else 0.0

    @property
    def standard_deviation(self) -> float:
        """m; of an encoder that of an even spread over one step."""
        if self.kind == "logistic-scale":
            return self.amplitude * LOGISTIC_DEVIATION
        return self.amplitude / math.sqrt(12) if self.kind == "encoder" else self.amplitude

    def sample(self, rng: np.random.Generator, samples: int) -> Float64[np.ndarray, " samples"]:
        """What is added to the coordinate, m; zero for an encoder, whose error depends on the coordinate."""
        require_count("samples", samples)
        if self.kind == "gaussian":
            return self.amplitude * rng.standard_normal(samples)
        if self.kind.startswith("logistic"):
            return rng.logistic(0.0, self.standard_deviation / LOGISTIC_DEVIATION, samples)
        return np.zeros(samples)

    def sample_grid(self, rng: np.random.Generator) -> float:
        """Where a line of the encoder stands, m: anywhere in one step, so that runs differ; 0 without one."""
        return float(rng.uniform(0.0, self.resolution)) if self.resolution else 0.0

    def measure(
        self, position: Float64[np.ndarray, " samples"], rng: np.random.Generator
    ) -> Float64[np.ndarray, " samples"]:
        """The coordinate as measured, m."""
        measured = position + self.sample(rng, len(position))
        if not self.resolution:
            return measured
        grid = self.sample_grid(rng)
        return np.round((measured - grid) / self.resolution) * self.resolution + grid


def drop_samples(
    noise: Float64[np.ndarray, "*coordinates samples"], sample_time: float, every: float, length: float
) -> Float64[np.ndarray, "*coordinates samples"]:
    """The same noise with NaN, a lost signal, in the last `length` seconds of each `every` seconds; 0: none is lost."""
    require_number("lost_every", every, at_least=0)
    require_number("lost_for", length, at_least=0)
    if not (every and length):
        return noise
    if length > every - sample_time:
        raise InputError(f"lost_for is {length:g} s of every {every:g} s; leave a sample between two losses")
    period, lost = round(every / sample_time), round(length / sample_time)
    gone = np.arange(noise.shape[-1]) % period >= period - lost
    return np.where(gone, np.nan, noise)


def drop_at_random(
    noise: Float64[np.ndarray, " samples"], share: float, rng: np.random.Generator
) -> Float64[np.ndarray, " samples"]:
    """The same noise with NaN, a lost signal, in single samples drawn with this probability, not in the first one."""
    if not require_number("lost_share", share, at_least=0, below=1):
        return noise
    gone = rng.random(len(noise)) < share
    gone[0] = False
    return np.where(gone, np.nan, noise)
