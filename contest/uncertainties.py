"""What an observer may be wrong about: errors of the model, changes under way, and a worse sensor."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float64

from contest.plants import ContestPlant
from stillwork.base.toml_files import read_numbers
from stillwork.lti.discretisation import zoh_modes
from workbook import paths

PIECES = 20  # of a record, over each of which the machine stays as it is


@dataclass(frozen=True)
class Uncertainty:
    """Largest relative errors of the modal parameters and what else the observer is not told.

    Its law is uniform, or Student's with three degrees of freedom and the same variance.
    """

    frequency: float = 0.0
    damping: float = 0.0
    gain: float = 0.0  # of every mode's input shape, those of the rigid body too
    shape: float = 0.0  # of the flexible modes at every sensor
    student: bool = False
    cases: bool = False  # the hard disk's nine: cold, room or hot, each with the gain as it is, high or low
    drift: float = 0.0  # of the frequencies along the record, up or down
    jump: float = 0.0  # the same at once, half-way
    truncated: bool = False  # the higher modes are there
    noise: float = 1.0  # factor on the sensor's noise, of which the observer is told
    outliers: float = 0.0  # share of the measurements with thirty times their noise, of which it is not
    lost: float = 0.0  # share of the measurements that are NaN
    delay: int = 0  # samples


def _all(size: float) -> Uncertainty:
    return Uncertainty(size, size, size, size)


TWO = _all(0.02)
UNCERTAINTIES: Mapping[str, Uncertainty] = {
    "none": Uncertainty(),
    "frequency 0.5 %": Uncertainty(frequency=0.005),
    "frequency 2 %": Uncertainty(frequency=0.02),
    "frequency 10 %": Uncertainty(frequency=0.1),
    "damping 10 %": Uncertainty(damping=0.1),
    "gain 10 %": Uncertainty(gain=0.1),
    "shape 10 %": Uncertainty(shape=0.1),
    "all 0.5 %": _all(0.005),
    "all 2 %": TWO,
    "all 5 %": _all(0.05),
    "all 10 %": _all(0.1),
    "temperature and gain": Uncertainty(cases=True),
    "truncation": Uncertainty(truncated=True),
    "drift 5 %": Uncertainty(drift=0.05),
    "jump 5 %": Uncertainty(jump=0.05),
    "Student 2 %": replace(TWO, student=True),
    "outliers": replace(TWO, outliers=0.05),
    "noise x10": replace(TWO, noise=10.0),
    "noise x100": replace(TWO, noise=100.0),
    "noise x1000": replace(TWO, noise=1000.0),
    "lost 20 %": replace(TWO, lost=0.2),
    "delay": replace(TWO, delay=1),
}


def hidden_seed(public: str, *names: object) -> int:
    """Seed that a public number gives; nobody knows it before the number is out, everybody can check it after."""
    text = ":".join(map(str, (public, *names)))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")


@dataclass(frozen=True)
class Truth:
    """The machine as it is, in pieces of a record, and what befalls its measurements."""

    a: Float64[np.ndarray, "pieces states states"]
    b: Float64[np.ndarray, "pieces states inputs"]
    c: Float64[np.ndarray, "outputs states"]
    process: Float64[np.ndarray, "samples inputs"]
    sensor: Float64[np.ndarray, "samples outputs"]
    lost: np.ndarray  # (samples,) of bool
    delay: int


@cache
def _nine_cases() -> dict[str, list[float]]:
    """Factors on frequencies, damping and gains in the hard disk's benchmark."""
    return read_numbers(paths.data("motion", "hard_disk.toml"), lists=True)["cases"]


def sample_truth(plant: ContestPlant, doubt: Uncertainty, samples: int, rng: np.random.Generator) -> Truth:
    """A machine that the nominal one may be mistaken for, and its noises, from `rng`."""
    model = plant.machine if doubt.truncated else plant.model
    rigid, inputs, outputs = model.rigid_modes, model.input_shapes.shape[1], len(model.output_shapes)
    told = len(plant.model.frequencies)
    draws = rng.uniform(-1, 1, (3 + outputs, told))
    if doubt.student:
        draws = rng.standard_t(3, draws.shape) / 3  # a variance of a third, the uniform law's
    sizes = np.array([doubt.frequency, doubt.damping, doubt.gain, *[doubt.shape] * outputs])
    factors = np.ones((3 + outputs, len(model.frequencies)))
    factors[:, :told] = np.maximum(1 + sizes[:, None] * draws, 0.3)  # Student's tail would turn a sign
    factors[[0, 1, *range(3, 3 + outputs)], :rigid] = 1.0
    case, direction = rng.integers(9), rng.choice([-1.0, 1.0])
    if doubt.cases:
        nine = _nine_cases()
        temperature, gain = divmod(case, 3)
        factors[0, rigid:] *= nine["frequencies"][temperature]
        factors[1, rigid:] *= nine["damping"][temperature]
        factors[2] *= nine["gains"][gain]
    place = np.arange(PIECES) / (PIECES - 1)
    change = 1 + direction * (doubt.drift * place + doubt.jump * (place > 0.5))
    true = replace(
        model,
        damping=np.minimum(model.damping * factors[1], 0.9),
        input_shapes=model.input_shapes * factors[2][:, None],
        output_shapes=model.output_shapes * factors[3:],
    )
    sampled = []
    different, piece = np.unique(change, return_inverse=True)
    for each in different:
        # Ascending order is the model's rule and nothing to physics: modes that change places go back to theirs.
        frequencies = model.frequencies * factors[0] * each
        step = zoh_modes(true.moved(frequencies), plant.sample_time)
        back = np.argsort(np.argsort(frequencies, kind="stable"))
        states = np.stack([2 * back, 2 * back + 1], axis=1).ravel()
        sampled.append((step.a[np.ix_(states, states)], step.b[states], step.c[:, states]))
    a, b, c = (np.array(x)[piece] for x in zip(*sampled, strict=True))
    process = plant.process * rng.standard_normal((samples, inputs))
    sensor = plant.sensor * doubt.noise * rng.standard_normal((samples, outputs))
    sensor *= np.where(rng.uniform(size=(samples, 1)) < doubt.outliers, 30.0, 1.0)
    return Truth(a, b, c[0], process, sensor, rng.uniform(size=samples) < doubt.lost, doubt.delay)
