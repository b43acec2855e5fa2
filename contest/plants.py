"""The machines of the contest, each with its kind and source: what observers are given, and the modes they are not.

Their numbers are those of ``data/motion/contest_plants.json``, which `contest.machines` makes from the sources.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from stillwork.base.checks import require_choice
from stillwork.lti.modal import ModalModel
from workbook import paths

FILE = paths.data("motion", "contest_plants.json")
SHAPES = ("frequencies", "damping", "input_shapes", "output_shapes")
NUMBERS = ("acceleration", "process", "sensor")


@dataclass(frozen=True)
class ContestPlant:
    """A machine, how it is sampled and moved, and the noises on it."""

    model: ModalModel  # nominal, what the observers are given
    machine: ModalModel  # with the modes left out of it
    sample_time: float  # s
    acceleration: float  # of the first rigid-body coordinate, mass-normalised: largest of the move
    process: float  # standard deviation of w at every input, each sample anew
    sensor: float  # the same of the noise on every measurement

    @property
    def lowest_hz(self) -> float:
        """First flexible frequency."""
        return float(self.model.frequencies[self.model.rigid_modes] / (2 * np.pi))


class Machine(NamedTuple):
    """A machine of the contest: its kind, and where it is from."""

    kind: str
    source: str


PLANTS: Mapping[str, Machine] = {
    "stage": Machine("stage", "the thesis, section 5.4.3"),
    "plate": Machine("stage", "the thesis, chapter 6"),
    "gantry": Machine("stage", "form: García-Herreros and others 2013; numbers assumed"),
    "drive": Machine("mass chain", "the thesis, table 3.8"),
    "two masses": Machine("mass chain", "Wie and Bernstein 1992"),
    "four disks": Machine("mass chain", "Cannon and Rosenthal 1984"),
    "five masses": Machine("mass chain", "the thesis, example 2.3.1"),
    "beam": Machine("beam", "the thesis, section 4.3; shapes of a free beam"),
    "slewing beam": Machine("beam", "form: Cannon and Schmitz 1984; numbers assumed"),
    "hard disk": Machine("hard disk", "Atsumi 2022, IEE Japan"),
    "hard disk 2006": Machine("hard disk", "Hirata and Hara 2006, HDD benchmark 1.0"),
    "measured structure": Machine("measured", "pyFRF's hammer records, shipped"),
    "suspension": Machine("suspension", "form: KAGRA's type B; numbers assumed"),
}


@cache
def _numbers() -> dict:
    return json.loads(FILE.read_text(encoding="utf-8"))


@cache
def plant_of(name: str) -> ContestPlant:
    """The plant of this name."""
    require_choice("plant", name, PLANTS)
    numbers = _numbers()[name]
    shapes = [np.array(numbers[shape], dtype=float) for shape in SHAPES]
    machine = ModalModel(*shapes, np.zeros((len(shapes[3]), shapes[2].shape[1])))
    model = machine.modes(slice(0, numbers["given_modes"]))
    return ContestPlant(model, machine, *(numbers[each] for each in ("sample_time", *NUMBERS)))
