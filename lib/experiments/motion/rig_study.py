"""The rig on a levelling trajectory, and over geometries that are not published: one trial of the study behind Tables 6.2 to 6.4."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg

from experiments.motion.rig import Geometry, assumed, assumed_geometry, excitation, published
from experiments.motion.rig_designs import (
    CASES,
    RigSettings,
    bandwidths,
    model_errors,
    rig_controllers,
    rig_loops,
)
from experiments.motion.rig_loops import MEASURES, RigLoop
from stillwork.base.checks import InputError
from stillwork.base.validation import checked
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


def _to_error(loop: RigLoop, pids: Sequence[Pid]) -> StateModel:
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


def _lines(
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
    model = _to_error(loop, pids)
    z = np.exp(1j * trajectory.omega * loop.sample_time)
    drive = _lines(trajectory, loop, mass_error)
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
    trajectory: Levelling,
    noise: NoiseIntensities,
    rng: np.random.Generator,
    periods: int = 1,
) -> Float64[np.ndarray, "3 samples"]:
    """True error over the last period (m, rad, rad), simulated with noise after `periods` periods of settling."""
    model = _to_error(loop, pids)
    count = round(trajectory.period / loop.sample_time)
    if abs(count * loop.sample_time - trajectory.period) > 1e-9 * trajectory.period:
        raise InputError("period of the trajectory is not a multiple of the sample time; change one of them")
    time = np.arange((periods + 1) * count) * loop.sample_time
    known = (_lines(trajectory, loop) @ np.exp(1j * np.outer(trajectory.omega, time))).real
    sizes = np.sqrt(np.repeat([noise.process, noise.sensor], 3))
    random = sizes[:, None] * rng.standard_normal((6, len(time)))
    inputs = np.vstack([known[:3], known[3:] + random[:3], random[3:]])
    return simulate(model, inputs)[:, -count:]


PRINTED_HZ = {"Original": (6.0, 8.0), "MC": (9.0, 11.0), "AD": (12.0, 13.0), "MC and AD": (17.0, 21.0)}


def sample_geometry(rng: np.random.Generator) -> Geometry:
    """A geometry from the ranges of ``rig.toml``; the length stays, since only ratios of lengths matter."""
    ranges, known = assumed()["ranges"], assumed_geometry()
    return replace(
        known,
        mass=float(np.exp(rng.uniform(*np.log(ranges["mass"])))),
        width=known.length * rng.uniform(*ranges["aspect"]),
        actuators=rng.uniform(*ranges["actuators"]),
        sensors=(rng.uniform(*ranges["sensors"]), rng.uniform(*ranges["sensors"])),
    )


class FlexiblePeaks(NamedTuple):
    """What is flexible in a decoupled plant, over the four positions."""

    peaks: Float64[np.ndarray, "8"]  # m/N, largest singular value near every published mode
    coupling: float  # m/N, mean magnitude of the off-diagonal entries at a tenth of the first mode


def flexible_peaks(loops: list[RigLoop]) -> FlexiblePeaks:
    """Peaks of the difference between the equivalent plant and the rigid body (motions of the edges)."""
    modes = 2 * np.pi * np.array(published()["frequencies_hz"])
    middle = np.sqrt(modes[1:] * modes[:-1])
    # Within 5 % of each mode, and no nearer to another one; further away the tails of lower modes are larger.
    low = np.maximum(0.95 * modes, np.append(0.0, middle))
    high = np.minimum(1.05 * modes, np.append(middle, np.inf))
    found, coupling = [], []
    for loop in loops:
        rigid = held_mass(loop.omega, loop.sample_time)
        seen = np.moveaxis(loop.equivalent_plant(), -1, 0)
        bands = np.array([(loop.omega >= a) & (loop.omega <= b) for a, b in zip(low, high, strict=True)])
        used = bands.any(axis=0)
        apart = seen[used] - rigid[used, None, None] * np.diag(1 / loop.decoupling.masses)
        sizes = np.linalg.norm(apart, 2, axis=(1, 2))
        found.append([sizes[band].max() for band in bands[:, used]])
        slow = np.abs(seen[np.searchsorted(loop.omega, modes[0] / 10)])
        coupling.append(slow[~np.eye(3, dtype=bool)].mean())
    return FlexiblePeaks(np.max(found, axis=0), float(np.mean(coupling)))


def printed_controllers(loop: RigLoop) -> dict[str, tuple[Pid, Pid, Pid]]:
    """The controllers of all cases at the bandwidths of Table 6.2."""
    family = rig_controllers(loop.decoupling.masses)
    return {case: family(*hz) for case, hz in PRINTED_HZ.items()}


def levelling_errors(
    loops: Mapping[str, Sequence[RigLoop]],
    pids: Mapping[str, Sequence[Pid] | None],
    trajectory: Levelling,
    noise: NoiseIntensities,
    mass_error: float = 0.0,
) -> Float64[np.ndarray, "2 cases 3"]:
    """`levelling_rms` at the first position, with the original's and with each case's own controllers.

    NaN where there is no controller, or the loop is unstable.
    """

    def rms(case: str, owner: str) -> Float64[np.ndarray, "3"]:
        if pids[owner] is not None:
            with suppress(InputError):  # of an unstable loop
                return levelling_rms(loops[case][0], pids[owner], trajectory, noise, mass_error)
        return np.full(3, np.nan)

    with_original = [rms(case, "Original") for case in CASES]
    return np.array([with_original, [with_original[0], *(rms(case, case) for case in CASES[1:])]])


@checked
def rig_trial(rng: np.random.Generator, settings: RigSettings) -> dict[str, np.ndarray]:
    """One geometry, one draw of model errors, all four cases, under both readings of "peaks below 6 dB".

    With one entry a reading (`MEASURES`) in front: ``crossing`` (cases, 3) in Hz, mean over positions;
    ``peaks`` (cases, functions); ``original`` and ``redesigned`` (cases, 3), rms errors in m and rad at the
    first position with the original and with the redesigned controllers; all NaN where no bandwidth passes.
    Then ``printed`` (2, cases, 3), the same errors with the bandwidths of Table 6.2, and ``edges`` (3,) in m. Besides ``flexible`` (cases, modes) and ``coupling`` (cases,) in m/N, and the drawn ``mass``, ``aspect``,
    ``actuators`` and ``sensors``, and ``excitation`` (2, modes), the largest of four and of three actuators.
    """
    geometry = sample_geometry(rng)
    loops = rig_loops(geometry, settings, model_errors(rng))
    trajectory = levelling(rng)
    found = [bandwidths(loops, measure).values() for measure in MEASURES]
    pids = [{case: each.pids for case, each in zip(CASES, designs, strict=True)} for designs in found]
    errors = [levelling_errors(loops, pid, trajectory, settings.noise) for pid in pids]
    original, redesigned = np.swapaxes(errors, 0, 1)
    flexible = [flexible_peaks(loop) for loop in loops.values()]
    printed = printed_controllers(loops["Original"][0])
    excited = [excitation(geometry, used) for used in ((0, 1, 2, 3), geometry.used)]
    return {
        "crossing": np.array([[design.crossing_hz.mean(axis=0) for design in designs] for designs in found]),
        "peaks": np.array([[each.peaks.max(axis=0) for each in designs] for designs in found]),
        "original": original,
        "redesigned": redesigned,
        "printed": levelling_errors(loops, printed, trajectory, settings.noise),
        "edges": geometry.edges,
        "flexible": np.array([each.peaks for each in flexible]),
        "coupling": np.array([each.coupling for each in flexible]),
        "mass": np.array(geometry.mass),
        "aspect": np.array(geometry.width / geometry.length),
        "actuators": np.array(geometry.actuators),
        "sensors": np.array(geometry.sensors),
        "excitation": np.abs(excited).max(axis=2),
    }
