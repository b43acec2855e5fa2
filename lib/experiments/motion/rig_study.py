"""The rig on a levelling trajectory, and over geometries that are not published: one trial of the study behind Tables 6.2 to 6.4."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg

from experiments.motion.rig import assumed
from experiments.motion.rig_loops import RigLoop
from stillwork.base.checks import InputError
from stillwork.control.loops import channel
from stillwork.control.pid import Pid
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.state_space import StateModel


@dataclass(frozen=True)
class Levelling:
    """A periodic trajectory in z, rx and ry: sines at the lowest harmonics of its period, with random phases."""

    period: float  # s
    lines: Complex128[np.ndarray, "3 harmonics"]  # complex amplitudes of cosines; m, rad, rad

    @property
    def omega(self) -> Float64[np.ndarray, " harmonics"]:
        """Frequencies of the lines (rad/s)."""
        return 2 * np.pi / self.period * np.arange(1, self.lines.shape[1] + 1)

    def samples(self, sample_time: float) -> Float64[np.ndarray, "3 samples"]:
        """One period (m, rad, rad)."""
        time = np.arange(round(self.period / sample_time)) * sample_time
        return (self.lines @ np.exp(1j * np.outer(self.omega, time))).real


def levelling(rng: np.random.Generator) -> Levelling:
    """The assumed trajectory: lines of equal size up to 2 Hz, with the rms values of ``rig.toml``."""
    a = assumed()["levelling"]
    harmonics = int(np.floor(a["highest_hz"] * a["period"] + 1e-9))
    phases = np.exp(2j * np.pi * rng.random((3, harmonics)))
    sizes = np.array(a["amplitudes"]) * np.sqrt(2 / harmonics)
    return Levelling(a["period"], sizes[:, None] * phases)


def to_error(loop: RigLoop, pids: Sequence[Pid]) -> StateModel:
    """From (v, w, d) at sensors and actuators to the true error in (z, rx, ry).

    Under the modified feedforward of Appendix A the setpoint acts like v, the original feedforward like w.
    """
    seen = channel(loop.closed(pids), ("v", "w", "d"), "e_true", 3, 3)
    read = loop.decoupling.sensing / loop.decoupling.edges[:, None]
    balanced, (scale, _) = linalg.matrix_balance(seen.a, permute=False, separate=True)
    b, c = seen.b / scale[:, None], read @ seen.c * scale
    model = StateModel(balanced, b, c, read @ seen.d, seen.sample_time)
    if (radius := np.abs(model.poles).max()) >= 1:
        raise InputError(f"the loop is unstable (a pole of magnitude {radius:.6f}); lower the bandwidth")
    return model


def held_mass(omega: Float64[np.ndarray, " frequencies"], sample_time: float) -> np.ndarray:
    """Response of a mass of 1 kg to a force that is held over each sample."""
    turned = np.exp(1j * omega * sample_time)
    return sample_time**2 * (turned + 1) / (2 * (turned - 1) ** 2)


def lines_of(
    trajectory: Levelling, loop: RigLoop, mass_error: float = 0.0
) -> Complex128[np.ndarray, "6 harmonics"]:
    """Amplitudes of (v, w): the trajectory at the sensors, and the rigid-body forces that would follow it.

    The force is held over a sample; the rigid body then passes through the trajectory at every sample.
    """
    directions = loop.decoupling
    edges = directions.edges[:, None] * trajectory.lines
    masses = (1 + mass_error) * directions.masses[:, None]
    force = masses * edges / held_mass(trajectory.omega, loop.sample_time)
    return np.vstack([np.linalg.solve(directions.sensing, edges), directions.actuation @ force])


def levelling_rms(
    loop: RigLoop,
    pids: Sequence[Pid],
    trajectory: Levelling,
    noise: NoiseIntensities,
    mass_error: float = 0.0,
) -> Float64[np.ndarray, "3"]:
    """Expected rms of the true error in z (m), rx and ry (rad), in steady state: lines plus noise.

    The feedforward takes the rig for heavier by `mass_error`, relative.
    """
    model = to_error(loop, pids)
    z = np.exp(1j * trajectory.omega * loop.sample_time)
    drive = lines_of(trajectory, loop, mass_error)
    periodic = np.zeros(3)
    for point, amplitudes in zip(z, drive.T, strict=True):
        state = np.linalg.solve(point * np.eye(len(model.a)) - model.a, model.b[:, :6] @ amplitudes)
        periodic += np.abs(model.c @ state + model.d[:, :6] @ amplitudes) ** 2 / 2
    sizes = np.sqrt(np.repeat([noise.process, noise.sensor], 3))
    random = output_variance(model.a, model.b[:, 3:] * sizes, model.c, model.d[:, 3:] * sizes)
    return np.sqrt(periodic + random)


def output_variance(a, b, c, d) -> Float64[np.ndarray, " outputs"]:
    """Variance of every output of a stable discrete model driven by unit white noise.

    The state covariance is the sum over all past samples, doubled in length at every turn, so that only
    positive terms are added.
    """
    covariance, power = b @ b.T, np.array(a)
    for _ in range(60):
        more = power @ covariance @ power.T
        covariance = covariance + more
        power = power @ power
        if np.abs(more).max() < 1e-14 * np.abs(covariance).max():
            return np.einsum("ij,jk,ik->i", c, covariance, c) + (d**2).sum(axis=1)
    raise InputError("a: the model is not stable enough for its noise to settle; lower the bandwidth")
