"""True tracking errors of the rig on a levelling trajectory with noise, exactly and in the time domain."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg

from experiments.motion.rig import Geometry, assumed, scaled_inertia
from experiments.motion.rig_loops import RigLoop
from stillwork.base.checks import InputError, require_array, require_number
from stillwork.control.loops import channel
from stillwork.control.pid import Pid
from stillwork.estimation.observer import NoiseIntensities
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel


@dataclass(frozen=True)
class Levelling:
    """A periodic trajectory in z, rx and ry: sines at the lowest harmonics of its period, with random phases."""

    period: float  # s
    lines: Complex128[np.ndarray, "3 harmonics"]  # complex amplitudes of cosines; m, rad, rad

    def __post_init__(self):
        require_number("period", self.period, above=0.0)

    @property
    def omega(self) -> Float64[np.ndarray, " harmonics"]:
        """Frequencies of the lines (rad/s)."""
        return 2 * np.pi / self.period * np.arange(1, self.lines.shape[1] + 1)

    def samples(self, step: float) -> Float64[np.ndarray, "3 samples"]:
        """One period (m, rad, rad)."""
        time = np.arange(round(self.period / step)) * step
        return (self.lines @ np.exp(1j * np.outer(self.omega, time))).real


def levelling(rng: np.random.Generator) -> Levelling:
    """The assumed trajectory: lines of equal size up to 2 Hz, with the rms values of ``rig.toml``."""
    a = assumed()["levelling"]
    harmonics = int(np.floor(a["highest_hz"] * a["period"] + 1e-9))
    phases = np.exp(2j * np.pi * rng.random((3, harmonics)))
    sizes = np.array(a["amplitudes"]) * np.sqrt(2 / harmonics)
    return Levelling(a["period"], sizes[:, None] * phases)


def _to_error(loop: RigLoop, pids: Sequence[Pid], geometry: Geometry) -> StateModel:
    """From (v, w, d) at sensors and actuators to the true error in (z, rx, ry).

    Under the modified feedforward of Appendix A the setpoint acts like v, the original feedforward like w.
    """
    closed = loop.closed(pids)
    blocks = [channel(closed, name, "e_true", 3, 3) for name in ("v", "w", "d")]
    read = loop.decoupling.sensing / geometry.edges[:, None]
    model = StateModel(
        closed.a,
        np.hstack([block.b for block in blocks]),
        read @ blocks[0].c,
        read @ np.hstack([block.d for block in blocks]),
        closed.step,
    )
    balanced, (scale, _) = linalg.matrix_balance(model.a, permute=False, separate=True)
    return StateModel(balanced, model.b / scale[:, None], model.c * scale, model.d, model.step)


def _require_stable(model: StateModel) -> None:
    radius = np.abs(model.poles).max()
    if radius >= 1:
        raise InputError(f"the loop is unstable (a pole of magnitude {radius:.6f}); lower the bandwidth")


def _lines(
    trajectory: Levelling, loop: RigLoop, geometry: Geometry, mass_error: float
) -> Complex128[np.ndarray, "6 harmonics"]:
    """Amplitudes of (v, w): the trajectory at the sensors, and the rigid-body forces that would follow it.

    The force is held over a sample; the rigid body then passes through the trajectory at every sample.
    """
    turned = np.exp(1j * trajectory.omega * loop.step)
    held = loop.step**2 * (turned + 1) / (2 * (turned - 1) ** 2)
    scaled = geometry.edges[:, None] * trajectory.lines
    force = (1 + mass_error) * scaled_inertia(geometry)[:, None] * scaled / held
    at_sensors = np.linalg.solve(loop.decoupling.sensing, scaled)
    return np.vstack([at_sensors, loop.decoupling.actuation @ force])


def levelling_rms(
    loop: RigLoop,
    pids: Sequence[Pid],
    geometry: Geometry,
    trajectory: Levelling,
    noise: NoiseIntensities,
    mass_error: float = 0.0,
) -> Float64[np.ndarray, "3"]:
    """Expected rms of the true error in z (m), rx and ry (rad), in steady state: lines plus noise.

    The feedforward takes the rig for heavier by `mass_error`, relative.
    """
    model = _to_error(loop, pids, geometry)
    _require_stable(model)
    z = np.exp(1j * trajectory.omega * loop.step)
    drive = _lines(trajectory, loop, geometry, mass_error)
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


def levelling_error(
    loop: RigLoop,
    pids: Sequence[Pid],
    geometry: Geometry,
    trajectory: Levelling,
    noise: NoiseIntensities,
    rng: np.random.Generator,
    periods: int = 1,
) -> Float64[np.ndarray, "3 samples"]:
    """True error over the last period (m, rad, rad), simulated with noise after `periods` periods of settling."""
    model = _to_error(loop, pids, geometry)
    _require_stable(model)
    count = round(trajectory.period / loop.step)
    if abs(count * loop.step - trajectory.period) > 1e-9 * trajectory.period:
        raise InputError("period of the trajectory is not a multiple of the sample time; change one of them")
    time = np.arange((periods + 1) * count) * loop.step
    known = (_lines(trajectory, loop, geometry, 0.0) @ np.exp(1j * np.outer(trajectory.omega, time))).real
    sizes = np.sqrt(np.repeat([noise.process, noise.sensor], 3))
    random = sizes[:, None] * rng.standard_normal((6, len(time)))
    inputs = np.vstack([known[:3], known[3:] + random[:3], random[3:]])
    return simulate(model, require_array("inputs", inputs))[:, -count:]
