"""What an observer is given before a scan, and what one of ours is made of."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from contest.plants import ContestPlant
from stillwork.lti.discretisation import zoh_modes
from stillwork.lti.modal import ModalModel


@dataclass(frozen=True)
class NominalModel:
    """The nominal machine: x_k = A x_{k-1} + B (u_{k-1} + w), y_k = C x_k + v; position and velocity of each mode."""

    a: Float64[np.ndarray, "states states"]
    b: Float64[np.ndarray, "states inputs"]
    c: Float64[np.ndarray, "outputs states"]
    frequencies: Float64[np.ndarray, " modes"]  # rad/s; zero for a rigid body, these first
    damping: Float64[np.ndarray, " modes"]  # ratio to critical
    input_shapes: Float64[np.ndarray, "modes inputs"]
    output_shapes: Float64[np.ndarray, "outputs modes"]

    @property
    def rigid_modes(self) -> int:
        """Number of modes of zero frequency."""
        return self.machine.rigid_modes

    @property
    def machine(self) -> ModalModel:
        """In continuous time."""
        shapes = self.input_shapes, self.output_shapes
        return ModalModel(self.frequencies, self.damping, *shapes, np.zeros((len(self.c), self.b.shape[1])))


@dataclass(frozen=True)
class NominalNoise:
    """Covariances a sample."""

    process: Float64[np.ndarray, "inputs inputs"]  # of w
    sensor: Float64[np.ndarray, "outputs outputs"]  # of v


def nominal_of(plant: ContestPlant, noise: float) -> tuple[NominalModel, NominalNoise]:
    """What all entrants are given of a plant whose sensor is `noise` times as noisy as it comes."""
    m = plant.model
    sampled = zoh_modes(m, plant.sample_time)
    model = NominalModel(
        sampled.a, sampled.b, sampled.c, m.frequencies, m.damping, m.input_shapes, m.output_shapes
    )
    sensor = (plant.sensor * noise) ** 2
    return model, NominalNoise(plant.process**2 * np.eye(sampled.b.shape[1]), sensor * np.eye(len(sampled.c)))


class TuningParameter(NamedTuple):
    """A number that is tuned, and where it may stand."""

    name: str
    low: float
    high: float
    default: float  # where its paper or habit has it


class CompiledObserver(NamedTuple):
    """A designed observer: a kernel per sample, its parameters, and its state.

    ``advance(data, memory, inputs, measurements, estimates)`` fills one row of `estimates` a sample.
    """

    advance: Callable
    data: tuple
    memory: tuple


class Baseline(NamedTuple):
    """One of ours: ``design(model, noise, sample_time, *settings)``, its knobs and its source."""

    design: Callable[..., CompiledObserver]
    knobs: tuple[TuningParameter, ...]
    source: str


class OwnObserver:
    """An entrant with its knobs set, as the bench runs it; anybody's observer has `start` and `step` alike."""

    def __init__(
        self, entrant: Baseline, settings: tuple[float, ...] | None = None, designs: dict | None = None
    ):
        self.entrant = entrant
        self.settings = tuple(knob.default for knob in entrant.knobs) if settings is None else settings
        # Of what it was given before: many scans are given the same.
        self.designs: dict[tuple, CompiledObserver] = {} if designs is None else designs

    def start(self, model: NominalModel, noise: NominalNoise, sample_time: float) -> None:
        """Design it, and let it forget all scans."""
        key = (model.a.tobytes(), model.b.tobytes(), model.c.tobytes(), noise.sensor.tobytes())
        if key not in self.designs:
            self.designs[key] = self.entrant.design(model, noise, sample_time, *self.settings)
        self.states, self.made = len(model.a), self.designs[key]
        self.memory = tuple(each.copy() for each in self.made.memory)

    def step(self, input: np.ndarray, measurement: np.ndarray, *_) -> np.ndarray:
        """The estimate at the sample of this measurement."""
        return self.run(input[None], measurement[None])[0]

    def run(self, inputs: np.ndarray, measurements: np.ndarray) -> np.ndarray:
        """Estimates of many samples in one call: what `step` gives sample by sample."""
        out = np.empty((len(inputs), self.states))
        self.made.advance(self.made.data, self.memory, inputs, measurements, out)
        return out
