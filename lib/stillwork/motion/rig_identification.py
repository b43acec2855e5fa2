"""Identification of the rig as in section 6.2: four multisine experiments in closed loop, one modal model."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from stillwork.lti import StateModel, interconnect, zoh_modes
from stillwork.motion.loops import channel, closed_loop, no_observer
from stillwork.motion.multisine import MultisineRecords, run_multisine
from stillwork.motion.rig import Geometry, decoupling, rig_model
from stillwork.motion.rig_control import tustin, zoh_response
from stillwork.motion.rig_designs import RigSettings, rig_controllers

ALL = (0, 1, 2, 3)


def identification_loop(geometry: Geometry, settings: RigSettings, bandwidth_hz: float) -> StateModel:
    """All four actuators and sensors under a slow controller, as `run_multisine` takes it.

    Parameters
    ----------
    geometry : Geometry
    settings : RigSettings
    bandwidth_hz : float
        Design bandwidth of all three directions.
    """
    plant = zoh_modes(rig_model(geometry), settings.step)
    matrices = decoupling(geometry, ALL, ALL)
    pids = rig_controllers(geometry)(bandwidth_hz, bandwidth_hz)
    blocks = [tustin(pid.state_space(), settings.step) for pid in pids]
    controller = interconnect(blocks, np.zeros((3, 3)), matrices.sensors, matrices.actuators)
    closed = closed_loop(plant, replace(no_observer(plant), step=settings.step), controller)
    inputs = [channel(closed, name, "f", 4, 4) for name in ("u_ff", "w", "d")]
    outputs = [channel(closed, name, "e_meas", 4, 4) for name in ("u_ff", "w", "d")]
    # Without a setpoint the measured error is minus the measurement.
    return StateModel(
        closed.a,
        np.hstack([each.b for each in inputs]),
        np.vstack([inputs[0].c, -outputs[0].c]),
        np.vstack([np.hstack([each.d for each in inputs]), -np.hstack([each.d for each in outputs])]),
        closed.step,
    )


def rig_records(
    geometry: Geometry,
    settings: RigSettings,
    bandwidth_hz: float,
    rng: np.random.Generator,
    rms: float,
    realisations: int,
    periods: int = 2,
    samples: int = 16384,
) -> MultisineRecords:
    """Simulated records of the experiments of section 6.2, with force and sensor noise of (6.2)."""
    noise = settings.noise
    return run_multisine(
        identification_loop(geometry, settings, bandwidth_hz),
        4,
        4,
        (np.sqrt(noise.process), np.sqrt(noise.sensor)),
        rng,
        samples=samples,
        rms=rms,
        realisations=realisations,
        periods=periods,
    )


def true_response(
    geometry: Geometry, settings: RigSettings, omega: Float64[np.ndarray, " lines"]
) -> np.ndarray:
    """Sampled response of the rig at `omega` (rad/s), shape (lines, sensors, actuators)."""
    return np.moveaxis(zoh_response(rig_model(geometry), settings.step, omega), -1, 0)
