"""The experiment of section 3.6 in simulation: observer, loops and identification of the two-inertia drive."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from experiments.motion.machines import Drive
from stillwork.control.applications import Application, compensator
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import PidFamily
from stillwork.estimation.observer import Observer
from stillwork.estimation.riccati import continuous_gain
from stillwork.identification.frequency_response import Identified, closed_loop_response
from stillwork.lti.discretisation import zoh
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel

# Section 3.6: Q = diag(.1, .1, 1, 1) and R, in rad and rad/s; here by (theta1, theta2, speed1, speed2).
SENSOR = 5e-5
WEIGHTS = {"angles first": (0.1, 0.1, 1.0, 1.0), "inertia by inertia": (0.1, 1.0, 0.1, 1.0)}


def drive_observer(drive: Drive, weights: str = "angles first") -> Observer:
    """Kalman observer of section 3.6, in modal states (sum and difference of the angles)."""
    states = drive.modal_states()
    shape = 1 / np.sqrt(2 * drive.inertia)
    # (theta1, theta2, speed1, speed2) of the modal states (eta1, speed of eta1, eta2, speed of eta2)
    physical = shape * np.array([[1, 0, 1, 0], [1, 0, -1, 0], [0, 1, 0, 1], [0, 1, 0, -1]], dtype=float)
    solved = continuous_gain(states.a, np.linalg.inv(physical), states.c, np.diag(WEIGHTS[weights]), SENSOR)
    return Observer(drive.modes(), states.a, states.b, states.c, solved.gain, solved.residual)


def drive_applications(damping: float) -> dict[str, Application | None]:
    """The four cases of Fig. 3.36, with this added damping ratio for AD."""
    return {
        "no observer": None,
        "MC": Application(compensate=True),
        "AD": Application(damping=damping),
        "MC and AD": Application(compensate=True, damping=damping),
    }


def drive_loop(
    plant: Drive,
    model: Drive,
    application: Application | None,
    bandwidth_hz: float,
    weights: str = "angles first",
) -> StateModel:
    """Closed loop of a drive with an observer made for `model`, angle measured across the rod."""
    block = None if application is None else compensator(drive_observer(model, weights), application)
    inertia = 2 * plant.inertia / plant.motor_constant  # what the controller's rules call the mass
    return closed_loop(plant.modal_states(), block, PidFamily(inertia)(bandwidth_hz).state_space())


def seen_by_controller(loop: StateModel, omega: Float64[np.ndarray, " frequencies"]) -> np.ndarray:
    """Exact response that the controller sees, u to the compensated output, from a `closed_loop`."""
    measured, force = channel(loop, "u_ff", ("e_meas", "u")).frequency_response(omega)[:, 0]
    return -measured / force


def identify(
    loop: StateModel,
    rng: np.random.Generator,
    *,
    sample_time: float,
    samples: int,
    segment: int,
    excitation: float,
    sensor_noise: float,
    imbalance: float,
    turns_hz: float,
) -> Identified:
    """The experiment: white current on the plant input, sensor noise, and the imbalance of the turning inertias.

    `excitation` (A) and `sensor_noise` (rad) are standard deviations, `imbalance` an amplitude (A at the motor).
    """
    noise = excitation * rng.standard_normal(samples)
    swing = imbalance * np.sin(2 * np.pi * turns_hz * sample_time * np.arange(samples))
    sensor = sensor_noise * rng.standard_normal(samples)
    chosen = channel(loop, ("u_ff", "w", "d"), ("u", "e_meas"))
    u, e = simulate(zoh(chosen, sample_time), np.array([noise, swing, sensor]))
    return closed_loop_response(noise, u, -e, sample_time, segment)


def rigid_response(plant: Drive, omega: Float64[np.ndarray, " frequencies"]) -> np.ndarray:
    """Response of the drive if its rod were stiff."""
    return plant.motor_constant / (1j * omega * (2j * omega * plant.inertia + 2 * plant.friction))


def statements(levels: Mapping[str, np.ndarray]) -> dict[str, bool]:
    """What section 3.6 says of Fig. 3.36, from each case's level over the rigid body (dB) around the resonance.

    A notch is as far from the rigid body as a peak.
    """
    away = {name: float(np.abs(level).max()) for name, level in levels.items()}
    return {
        "compensation-reduces": away["MC"] < away["no observer"],
        "residual-peak": bool(levels["MC"].max() > -levels["MC"].min()),
        "damping-reduces-less": away["MC"] < away["AD"] < away["no observer"],
        "combination-best": away["MC and AD"] < min(away["MC"], away["AD"]),
    }


def residual_trial(
    rng: np.random.Generator,
    plant: Drive,
    applications: dict[str, Application | None],
    bandwidth_hz: float,
    error: float,
) -> dict[str, float]:
    """What is left of the resonance by a model wrong by up to `error`: its peak over the rigid body (ratio), by case.

    And the largest distance from the rigid body, up or down (dB), by ``<case>, distance``.
    """
    names = ("stiffness", "inertia", "damper")
    wrong = replace(
        plant, **{name: getattr(plant, name) * (1 + rng.uniform(-error, error)) for name in names}
    )
    omega = plant.resonance * np.linspace(0.5, 1.6, 800)
    found = {}
    for name, each in applications.items():
        seen = seen_by_controller(drive_loop(plant, wrong, each, bandwidth_hz), omega)
        ratio = np.abs(seen / rigid_response(plant, omega))
        found[name] = float(ratio.max())
        found[f"{name}, distance"] = float(np.abs(20 * np.log10(ratio)).max())
    return found
