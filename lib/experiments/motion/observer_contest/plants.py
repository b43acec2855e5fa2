"""The machines of the contest: what the observers are told of each, and the higher modes that they are not told of."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from experiments.motion.machines import drive, parameters, stage, stage_mass
from experiments.motion.rig import assumed_geometry, published, rig_model
from experiments.motion.structure import as_stage, measured_accelerance
from stillwork.base.checks import require_choice
from stillwork.base.toml_files import read_numbers
from stillwork.identification.modal_fit import fit_modes
from stillwork.lti.modal import ModalModel
from workbook import paths

# Where a machine comes without noises it gets those of the thesis's stage over its forces and deflections:
# w = 0.01 N of 1250 N, and a sensor's 1.4 nm of the 19 um by which its first mode gives way.
PROCESS_RATIO, SENSOR_RATIO = 8e-6, 7.4e-5


@dataclass(frozen=True)
class ContestPlant:
    """A machine, how it is sampled and moved, and the noises on it."""

    model: ModalModel  # nominal, what the observers are told
    machine: ModalModel  # with the modes left out of it
    sample_time: float  # s
    acceleration: float  # of the first rigid-body coordinate, mass-normalised: largest of the move
    process: float  # standard deviation of w at every input, each sample anew
    sensor: float  # the same of the noise on every measurement

    @property
    def lowest_hz(self) -> float:
        """First flexible frequency."""
        return float(self.model.frequencies[self.model.rigid_modes] / (2 * np.pi))


def _plant(machine: ModalModel, retained: int, sample_time: float, acceleration: float, *noises: float):
    machine = replace(machine, feedthrough=np.zeros_like(machine.feedthrough))
    model = machine.modes(slice(0, retained))
    if not noises:
        force = acceleration / np.linalg.norm(model.input_shapes[0])
        noises = PROCESS_RATIO * force, SENSOR_RATIO * force * float(np.abs(model.compliance()).max())
    return ContestPlant(model, machine, sample_time, acceleration, *noises)


def _stage(_rng) -> ContestPlant:
    """Section 5.4.3 of the thesis: three modes, sensor at the far end, the move's 100 m/s^2."""
    noise = parameters("stage")["noise"]
    machine = stage().at([0], [6])
    sensor = float(np.hypot(noise["sensor"], noise["reference"]))
    acceleration = parameters("setpoint")["acceleration"] * np.sqrt(stage_mass())
    return _plant(machine, 3, 1e-4, acceleration, noise["process"], sensor)


def _drive(_rng) -> ContestPlant:
    """Table 3.8, angle across the rod, without the friction of its rigid body; a second flexible mode is assumed."""
    known = drive().modes()
    machine = replace(
        known,
        frequencies=np.append(known.frequencies, 4 * known.frequencies[1]),
        damping=np.append(known.damping, known.damping[1]),
        input_shapes=np.vstack([known.input_shapes, 0.3 * known.input_shapes[:1]]),
        output_shapes=np.hstack([known.output_shapes, 0.3 * known.output_shapes[:, :1]]),
    )
    return _plant(machine, 2, 2e-3, float(known.input_shapes[0, 0]))  # the move takes one ampere


def _plate(_rng) -> ContestPlant:
    """The over-actuated rig of chapter 6 with its three actuators and sensors: four of its flexible modes are told."""
    machine = rig_model(assumed_geometry(), higher_modes=0).at([0, 1, 2], [0, 1, 2])
    p = published()
    acceleration = 1.0 * np.sqrt(assumed_geometry().mass)  # the plate moves with 1 m/s^2, assumed
    noises = np.sqrt(p["process"]), np.sqrt(p["sensor"])
    return _plant(machine, 7, 1 / p["sample_rate_hz"], acceleration, *map(float, noises))


def _head(_rng) -> ContestPlant:
    """The voice coil of the hard-disk benchmark of IEE Japan: its modes below 10 kHz are told, ten more are there."""
    p = read_numbers(paths.data("motion", "hard_disk.toml"), lists=True)["voice_coil"]
    omega, share = 2 * np.pi * np.array(p["frequencies_hz"]), np.array(p["gains"])
    root = np.sqrt(p["gain"] * np.abs(share))
    machine = ModalModel(
        omega, np.array(p["damping"]), root[:, None], (np.sign(share) * root)[None], np.zeros((1, 1))
    )
    return _plant(machine, 6, 1 / p["sample_rate_hz"], float(root[0]))  # a unit of the coil's input


@cache
def _fitted() -> ModalModel:
    """Notebook 13's fit of the hammer records, with the stage's mass."""
    fit = fit_modes(
        measured_accelerance(2), [810.0, 824.0, 851.0, 900.0, 1519.0, 2640.0, 3007.0], (100.0, 3100.0)
    )
    return as_stage(fit, stage_mass())[0]


def _structure(_rng) -> ContestPlant:
    """The measured structure: rigid body and the four modes from 810 to 900 Hz are told."""
    return _plant(_fitted(), 5, 5e-5, 10.0 * np.sqrt(stage_mass()))


def _random(rng: np.random.Generator) -> ContestPlant:
    """A machine of its own for every seed: a rigid body and three flexible modes, and two more that are not told."""
    first, ratios = 2 * np.pi * 10 ** rng.uniform(2, 3), rng.uniform(1.2, 2.0, 4)
    omega = np.concatenate([[0.0], first * np.cumprod(np.concatenate([[1.0], ratios]))])
    damping = np.concatenate([[0.0], 10 ** rng.uniform(-3, -1.7, 5)])
    size, signs = rng.uniform(0.3, 1.5, (2, 6)), rng.choice([-1.0, 1.0], (2, 6))
    shapes = size * signs
    shapes[:, 0] = 1.0
    machine = ModalModel(omega, damping, shapes[0][:, None], shapes[1][None], np.zeros((1, 1)))
    return _plant(machine, 4, 2 * np.pi / omega[3] / 12, 1.0)


PLANTS: Mapping[str, Callable[[np.random.Generator], ContestPlant]] = {
    "stage": _stage,
    "drive": _drive,
    "plate": _plate,
    "hard disk": _head,
    "measured structure": _structure,
    "random machine": _random,
}


def sample_plant(name: str, rng: np.random.Generator) -> ContestPlant:
    """The plant of this name; of the random family, one that `rng` gives."""
    require_choice("plant", name, PLANTS)
    return PLANTS[name](rng)
