"""How the contest's machines follow from their sources.

``python -m contest.machines`` writes the file of numbers that the contest runs on.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from contest.plants import FILE, NUMBERS, SHAPES, ContestPlant
from experiments.motion.beam import beam_parameters, published_beam
from experiments.motion.machines import (
    as_stage,
    chain,
    chain_matrix,
    drive,
    measured_accelerance,
    parameters,
    stage,
    stage_mass,
)
from experiments.motion.rig import assumed_geometry, published, rig_model
from stillwork.base.toml_files import read_numbers
from stillwork.identification.modal_fit import fit_modes
from stillwork.lti.modal import ModalModel, modal_model
from workbook import paths

# Where a machine comes without noises it gets those of the thesis's stage over its forces and deflections:
# w = 0.01 N of 1250 N, and a sensor's 1.4 nm of the 19 um by which its first mode gives way.
PROCESS_RATIO, SENSOR_RATIO = 8e-6, 7.4e-5
SAMPLES_A_PERIOD = 12  # of the highest mode that is given, where a source names no sample time


def _plant(
    machine: ModalModel, retained: int, sample_time: float = 0.0, acceleration: float = 1.0, *noises: float
):
    machine = replace(machine, feedthrough=np.zeros_like(machine.feedthrough))
    model = machine.modes(slice(0, retained))
    sample_time = sample_time or 2 * np.pi / model.frequencies[-1] / SAMPLES_A_PERIOD
    if not noises:
        force = acceleration / np.linalg.norm(model.input_shapes[0])
        noises = PROCESS_RATIO * force, SENSOR_RATIO * force * float(np.abs(model.compliance()).max())
    return ContestPlant(model, machine, sample_time, acceleration, *noises)


def _stage() -> ContestPlant:
    noise = parameters("stage")["noise"]
    machine = stage().at([0], [6])  # the sensor at the far end
    sensor = float(np.hypot(noise["sensor"], noise["reference"]))
    acceleration = parameters("setpoint")["acceleration"] * np.sqrt(stage_mass())
    return _plant(machine, 3, 1e-4, acceleration, noise["process"], sensor)


def _plate() -> ContestPlant:
    machine = rig_model(assumed_geometry(), higher_modes=0).at([0, 1, 2], [0, 1, 2])
    p = published()
    acceleration = 1.0 * np.sqrt(assumed_geometry().mass)  # the plate moves with 1 m/s^2, assumed
    noises = np.sqrt(p["process"]), np.sqrt(p["sensor"])
    return _plant(machine, 7, 1 / p["sample_rate_hz"], acceleration, *map(float, noises))


def _gantry() -> ContestPlant:
    """Forces on and positions of both carriages; a head rides off the beam's middle, which bends under it."""
    p = _catalogue("gantry")
    half, head = p["span"] / 2, p["head_place"]
    beam_inertia = p["beam_mass"] * p["span"] ** 2 / 12
    # Coordinates: middle of the beam, its yaw, and the head's deflection.
    places = np.array([[1, half, 0], [1, -half, 0], [1, head, 1]])
    mass = places.T @ np.diag([p["carriage_mass"], p["carriage_mass"], p["head_mass"]]) @ places
    mass += np.diag([p["beam_mass"], beam_inertia, 0.0])
    stiffness = np.diag([0.0, p["yaw_stiffness"], p["bending_stiffness"]])
    return _plant(modal_model(mass, stiffness, places[:2].T, places[:2], p["damping_ratio"]), 3)


def _drive() -> ContestPlant:
    """Angle across the rod, without the friction of its rigid body; a second flexible mode is assumed."""
    known = drive().modes()
    machine = replace(
        known,
        frequencies=np.append(known.frequencies, 4 * known.frequencies[1]),
        damping=np.append(known.damping, known.damping[1]),
        input_shapes=np.vstack([known.input_shapes, 0.3 * known.input_shapes[:1]]),
        output_shapes=np.hstack([known.output_shapes, 0.3 * known.output_shapes[:, :1]]),
        drag=0.0,
    )
    return _plant(machine, 2, 2e-3, float(known.input_shapes[0, 0]))  # the move takes one ampere


def _five_masses() -> ContestPlant:
    """Example 2.3.1: the force on the first mass, the sensor at the last."""
    return _plant(chain([parameters("chain")["mass"]] * 5).at([0], [4]), 4)


def _row(name: str, retained: int) -> ContestPlant:
    """Masses in a row; the force on the first, the sensor at the last."""
    p = _catalogue(name)
    ends = np.eye(len(p["masses"]))
    model = modal_model(
        np.diag(p["masses"]), chain_matrix(p["springs"]), ends[:, :1], ends[-1:], p["damping_ratio"]
    )
    return _plant(model, retained)


def _suspension() -> ContestPlant:
    """Pendulums in a row under an inverted pendulum that is taken as free: each wire's spring is its load over length."""
    p = _catalogue("suspension")
    masses = np.array(p["masses"])
    load = 9.81 * (masses[::-1].cumsum()[::-1])[1:]
    ends = np.eye(len(masses))
    springs = chain_matrix(load / np.array(p["wires"]))
    return _plant(modal_model(np.diag(masses), springs, ends[:, :1], ends[-1:], p["damping_ratio"]), 4)


def _beam() -> ContestPlant:
    return _plant(published_beam(), 4, 0.0, np.sqrt(beam_parameters().table("assumed")["mass"]))


def _slewing_beam() -> ContestPlant:
    """A torque on the hub of a uniform pinned beam, the sensor at its tip: mode shapes in closed form."""
    p = _catalogue("slewing_beam")
    roots = np.array([3.92660231, 7.06858275, 10.21017612, 13.35176878])  # of tan z = tanh z
    omega = 2 * np.pi * p["first_hz"] * (roots / roots[0]) ** 2
    # Unit mass and length: sin(z x)/sin z + sinh(z x)/sinh z at the tip is 2, and its square has the integral 1
    # to the accuracy of 1/sinh^2; at the hub its slope is z (1/sin z + 1/sinh z).
    slopes = roots * (1 / np.sin(roots) + 1 / np.sinh(roots))
    return _plant(
        ModalModel(
            np.append(0.0, omega),
            np.append(0.0, np.full(4, p["damping_ratio"])),
            np.append(np.sqrt(3), slopes)[:, None],
            np.append(np.sqrt(3), np.full(4, 2.0))[None],
            np.zeros((1, 1)),
        ),
        4,
    )


def _disk(name: str, retained: int) -> ContestPlant:
    """Modes gain * gains / (s^2 + 2 z w s + w^2), the first of them taken as free."""
    p = read_numbers(paths.data("motion", "hard_disk.toml"), lists=True)[name]
    omega = 2 * np.pi * np.array(p["frequencies_hz"])
    share, order = np.array(p["gains"]), np.argsort(omega)
    root = np.sqrt(p["gain"] * np.abs(share))
    shapes = root[order, None], (np.sign(share) * root)[None, order]
    machine = ModalModel(omega[order], np.array(p["damping"])[order], *shapes, np.zeros((1, 1)))
    return _plant(machine, retained, 1 / p["sample_rate_hz"], float(root[0]))  # a unit of the coil's input


def _structure() -> ContestPlant:
    """Notebook 13's fit of the hammer records, with the stage's mass: four modes from 810 to 900 Hz are given."""
    fit = fit_modes(
        measured_accelerance(2), [810.0, 824.0, 851.0, 900.0, 1519.0, 2640.0, 3007.0], (100.0, 3100.0)
    )
    return _plant(as_stage(fit, stage_mass())[0], 5, 5e-5, 10.0 * np.sqrt(stage_mass()))


def _catalogue(name: str) -> dict:
    return read_numbers(paths.data("motion", "contest_machines.toml"), lists=True)[name]


BUILDERS: Mapping[str, Callable[[], ContestPlant]] = {
    "stage": _stage,
    "plate": _plate,
    "gantry": _gantry,
    "drive": _drive,
    "two masses": lambda: _row("two_masses", 2),
    "four disks": lambda: _row("four_disks", 3),
    "five masses": _five_masses,
    "beam": _beam,
    "slewing beam": _slewing_beam,
    "hard disk": lambda: _disk("voice_coil", 6),
    "hard disk 2006": lambda: _disk("voice_coil_2006", 5),
    "measured structure": _structure,
    "suspension": _suspension,
}


def machine_numbers(name: str) -> dict:
    """All that a scan needs of a machine: modes, how many of them are given, sampling, move and noises."""
    built = BUILDERS[name]()
    given = {"given_modes": len(built.model.frequencies), "sample_time": built.sample_time}
    shapes = {shape: getattr(built.machine, shape).tolist() for shape in SHAPES}
    return given | shapes | {number: float(getattr(built, number)) for number in NUMBERS}


def main() -> None:
    """Write the file."""
    lines = [f'"{name}": {json.dumps(machine_numbers(name))}' for name in BUILDERS]
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
