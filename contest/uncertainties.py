"""What an observer is not given: errors of the model, changes during a scan, and a worse sensor."""

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
    """Largest relative errors of the modal parameters, uniformly distributed, and what else the observer is not given."""

    frequency: float = 0.0
    damping: float = 0.0
    gain: float = 0.0  # of every mode's input shape, those of the rigid body too
    shape: float = 0.0  # of the flexible modes at every sensor
    cases: bool = False  # the hard disk's nine: cold, room or hot, each with the gain as it is, high or low
    drift: float = 0.0  # of the frequencies along the record, up or down
    jump: float = 0.0  # the same at once, half-way
    truncated: bool = False  # the higher modes are there
    noise: float = 1.0  # factor on the sensor's noise, which the observer is given
    outliers: float = 0.0  # share of the measurements with thirty times their noise, which it is not
    lost: float = 0.0  # share of the measurements that are NaN
    delay: int = 0  # samples


def _all(size: float) -> Uncertainty:
    return Uncertainty(size, size, size, size)


TWO = _all(0.02)
UNCERTAINTIES: Mapping[str, Uncertainty] = {
    "none": Uncertainty(),
    "all 2 %": TWO,
    "all 5 %": _all(0.05),
    "all 10 %": _all(0.1),
    "temperature and gain": Uncertainty(cases=True),
    "truncation": Uncertainty(truncated=True),
    "drift 5 %": Uncertainty(drift=0.05),
    "jump 5 %": Uncertainty(jump=0.05),
    "outliers": replace(TWO, outliers=0.05),
    "noise x30": replace(TWO, noise=30.0),
    "lost 20 %": replace(TWO, lost=0.2),
    "delay": replace(TWO, delay=1),
}


def hidden_seed(public: str, *names: object) -> int:
    """Seed that a public number gives; unknown before the number is published, and checkable afterwards."""
    text = ":".join(map(str, (public, *names)))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")


@dataclass(frozen=True)
class Truth:
    """The machine as it is, in pieces of a record, and faults of its measurements."""

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


def sample_truth(
    plant: ContestPlant, uncertainty: Uncertainty, samples: int, rng: np.random.Generator
) -> Truth:
    """A machine that the nominal one may be mistaken for, and its noises, from `rng`."""
    model = plant.machine if uncertainty.truncated else plant.model
    rigid, inputs, outputs = model.rigid_modes, model.input_shapes.shape[1], len(model.output_shapes)
    given = len(plant.model.frequencies)
    draws = rng.uniform(-1, 1, (3 + outputs, given))
    sizes = np.array(
        [uncertainty.frequency, uncertainty.damping, uncertainty.gain, *[uncertainty.shape] * outputs]
    )
    factors = np.ones((3 + outputs, len(model.frequencies)))
    factors[:, :given] = 1 + sizes[:, None] * draws
    factors[[0, 1, *range(3, 3 + outputs)], :rigid] = 1.0
    case, direction = rng.integers(9), rng.choice([-1.0, 1.0])
    if uncertainty.cases:
        nine = _nine_cases()
        temperature, gain = divmod(case, 3)
        factors[0, rigid:] *= nine["frequencies"][temperature]
        factors[1, rigid:] *= nine["damping"][temperature]
        factors[2] *= nine["gains"][gain]
    place = np.arange(PIECES) / (PIECES - 1)
    change = 1 + direction * (uncertainty.drift * place + uncertainty.jump * (place > 0.5))
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
    sensor = plant.sensor * uncertainty.noise * rng.standard_normal((samples, outputs))
    sensor *= np.where(rng.uniform(size=(samples, 1)) < uncertainty.outliers, 30.0, 1.0)
    return Truth(a, b, c[0], process, sensor, rng.uniform(size=samples) < uncertainty.lost, uncertainty.delay)
