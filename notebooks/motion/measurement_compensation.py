"""Measurement compensation: how fast a loop may be that is closed over a soft sensor (notebook 06)."""

import numpy as np

from experiments.motion.designs import DESIGNS, stage_loops, stage_observer
from experiments.motion.machines import stage, stage_mass
from stillwork.control.applications import soft_sensor
from stillwork.control.bandwidth import Loop, PeakConstraint, make_loop, maximise_bandwidth
from stillwork.control.pid import PidFamily
from stillwork.lti.state_space import StateModel


def soft_sensed_loop(sensor: int, performance: int) -> Loop:
    """Loop whose controller sees the soft sensor's position (3.21) of mass `performance`, measured at mass `sensor`."""
    plant, observer = stage(), stage_observer(sensor)
    shapes = plant.output_shapes[performance - 1 : performance, : len(observer.model.frequencies)]
    soft = soft_sensor(observer, shapes)
    nothing = np.zeros_like(soft.c)
    direct = np.vstack([np.zeros_like(soft.d), np.array([[0.0, 1.0]]) - soft.d])
    # A compensator gives y_flex, which is subtracted from y: here what the soft sensor takes off.
    block = StateModel(soft.a, soft.b, np.vstack([nothing, -soft.c]), direct)
    return make_loop(plant.at([0], [sensor - 1]), block)


def limit_hz(loops: list[Loop]) -> float:
    """Largest f_bw of (3.2), the constraint of the loop without observer: the sensitivity that the controller sees."""
    return maximise_bandwidth(loops, PidFamily(stage_mass()), [PeakConstraint("input_sensitivity")]).design_hz


def soft_sensed_limits(position: int) -> dict[str, float]:
    """Largest design parameters (Hz) with the true sensor and with a soft one, over the places that move.

    The performance output moves over the seven masses with the sensor at mass `position`; or the sensor moves and
    the performance output stays there (Remark 3.2.6).
    """
    masses, bare = range(1, 8), stage_loops(DESIGNS["PID"])
    return {
        "sensor moves, none": limit_hz(bare),
        "performance moves": limit_hz([soft_sensed_loop(position, each) for each in masses]),
        "fixed place, none": limit_hz([bare[position - 1]]),
        "sensor moves, soft": limit_hz([soft_sensed_loop(each, position) for each in masses]),
    }
