r"""The force that would track a setpoint without error, and what a real feedforward leaves of it (section 4.2.5)."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg

from stillwork.base.checks import InputError
from stillwork.base.validation import checked
from stillwork.control.feedforward import Feedforward
from stillwork.control.setpoint import Setpoint
from stillwork.lti.discretisation import zoh, zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.simulation import simulate
from stillwork.lti.state_space import StateModel

# Relative error of the partial fractions above which they are refused; they leave about 1e-12.
WORST_ERROR = 1e-8
FAINT = 1e-12  # what is left of a zero's motion where it is cut off


@dataclass(frozen=True)
class Inverse:
    r"""Partial fractions of :math:`1/(s^2P(s)) = \sum_i d_is^i + \sum_j e_j/(s - z_j)`, from acceleration to force."""

    polynomial: Float64[np.ndarray, "3"]  # d, kg s^i
    zeros: Complex128[np.ndarray, " zeros"]  # z of the plant, rad/s
    residues: Complex128[np.ndarray, " zeros"]  # e, kg rad/s

    @property
    def lead(self) -> float:
        """Time (s) before the move in which the force must begin: required by zeros in the right half-plane."""
        right = self.zeros.real[self.zeros.real > 0]
        return float(-np.log(FAINT) / right.min()) if len(right) else 0.0


@checked
def invert(plant: ModalModel) -> Inverse:
    """Inverse of a machine with one rigid-body mode, one input and one position output.

    A zero on the imaginary axis is refused (its force would ring for ever), and an inverse that differentiates the
    snap.
    """
    w, z = plant.frequencies, plant.damping
    residues = plant.output_shapes[0] * plant.input_shapes[:, 0]

    def below(s):
        return s[:, None] * (s[:, None] + 2 * z * w) + w**2

    def response(s):
        return (residues / below(s)).sum(axis=1) + plant.feedthrough[0, 0]

    def slope(s):
        return -(residues * 2 * (s[:, None] + z * w) / below(s) ** 2).sum(axis=1)

    zeros = plant.state_space().zeros
    for _ in range(3):  # what the eigenvalues of the pencil left
        zeros = zeros - response(zeros) / slope(zeros)
    if np.any(np.abs(zeros.real) < 1e-9 * np.abs(zeros)):
        raise InputError("plant has a zero on the imaginary axis; give its modes some damping")
    parts = 1 / (slope(zeros) * zeros**2)
    scale = np.abs(zeros).max() if len(zeros) else w[-1]
    s = 1j * scale * np.geomspace(1e-3, 3, 200)
    wanted = 1 / (s**2 * response(s))
    rest = wanted - (parts / (s[:, None] - zeros)).sum(axis=1)
    powers = (s[:, None] / scale) ** np.arange(3) / np.abs(wanted)[:, None]
    stacked, goal = (np.concatenate([each.real, each.imag]) for each in (powers, rest / np.abs(wanted)))
    found, *_ = np.linalg.lstsq(np.asarray_chkfinite(stacked), np.asarray_chkfinite(goal), rcond=None)
    error = np.abs(stacked @ found - goal).max()
    if error > WORST_ERROR:
        raise InputError(
            f"plant has an inverse that differentiates the snap (error {error:.1e}); use fewer modes or a "
            "smoother setpoint"
        )
    return Inverse(found / scale ** np.arange(3), zeros, parts)


@dataclass(frozen=True)
class Force:
    r"""A force :math:`f = hx` whose states follow :math:`\dot x = Gx` from sample to sample, so exactly known between.

    It may begin before the move, whose start is time zero. Its last four states are the setpoint's velocity,
    acceleration, jerk and snap, on which a feedforward acts: as they are, or held over each sample (G = 0).
    """

    time: Float64[np.ndarray, " samples"]  # s
    states: Float64[np.ndarray, "states samples"]  # x at the start of every sample
    generator: Float64[np.ndarray, "states states"]  # G, 1/s
    row: Float64[np.ndarray, " states"]  # h

    @property
    @checked
    def values(self) -> Float64[np.ndarray, " samples"]:
        """Force at the samples, N."""
        return self.row @ self.states


@checked
def ideal_force(inverse: Inverse, setpoint: Setpoint) -> Force:
    """The force under which the plant follows the setpoint exactly: stable inversion.

    Zeros in the left half-plane are run forwards in time, those in the right half-plane backwards from rest at
    the end. Between samples the snap is constant, so nothing is approximated.
    """
    sample_time = setpoint.sample_time
    ahead = int(np.ceil(inverse.lead / sample_time))
    moved = np.pad(setpoint.derivatives[1:], ((0, 0), (ahead, 0)))  # velocity to snap
    one = inverse.zeros.imag >= 0
    blocks, rows, drives, reads = [], [], [], []
    for zero, residue in zip(inverse.zeros[one], inverse.residues[one], strict=True):
        x = _filtered(zero, moved[1:], sample_time)
        size = 2 if zero.imag else 1  # of a pair, or of a real zero alone
        blocks.append(np.array([[zero.real, -zero.imag], [zero.imag, zero.real]])[:size, :size])
        rows += [x.real, x.imag][:size]
        drives += [1.0, 0.0][:size]
        reads += [size * residue.real, -size * residue.imag][:size]
    n = len(rows)
    generator = linalg.block_diag(*blocks, np.eye(4, k=1))
    generator[:n, n + 1] = drives  # every filter is driven by the acceleration
    row = np.concatenate([reads, [0.0], inverse.polynomial])
    time = (np.arange(moved.shape[1]) - ahead) * sample_time
    return Force(time, np.vstack([*rows, moved]) if rows else moved, generator, row)


def _filtered(zero: complex, rows: np.ndarray, sample_time: float) -> np.ndarray:
    """Bounded solution of x' = zero x + acceleration, for acceleration, jerk and snap at the samples."""
    from scipy.signal import lfilter

    chain = np.diag([zero, 0, 0, 0]) + np.diag([1.0, 1.0, 1.0], k=1)
    held = linalg.expm(chain * sample_time)[0]
    driven = held[1:] @ rows[:, :-1]
    x = np.zeros(rows.shape[1], dtype=complex)
    if zero.real < 0:
        x[1:] = lfilter([1.0], [1.0, -held[0]], driven)
    else:
        x[:-1] = lfilter([-1 / held[0]], [1.0, -1 / held[0]], driven[::-1])[::-1]
    return x


def sampled_ideal_force(plant: ModalModel, setpoint: Setpoint) -> Force:
    r"""The held force under which the plant meets the setpoint at every sample: stable inversion in discrete time.

    The zero-order hold adds zeros of its own; those outside the unit circle are run backwards. Solved by Fourier
    transformation of :math:`(z-1)^2r = (z-1)^2P(z)f` over a record so long that nothing is left at its ends.
    """
    sample_time = setpoint.sample_time
    sampled = zoh_modes(plant, sample_time)
    distance = np.log(np.abs(sampled.zeros))
    if np.any(np.abs(distance) < 1e-6):
        raise InputError("plant has a zero on the unit circle at this sample time; take another one")
    longest = -np.log(FAINT) / np.abs(distance)
    ahead = int(np.ceil(longest[distance > 0].max(initial=0)))
    moved = np.pad(setpoint.derivatives[1:], ((0, 0), (ahead, 0)))
    size = moved.shape[1]
    # Second differences of the position, from the first ones: those of the positions themselves would be rounding.
    steps = np.append(sample_time ** np.arange(1, 5) / [1, 2, 6, 24] @ moved, 0.0)
    whole = 1 << int(np.ceil(np.log2(size + longest.max())))
    angle = 2 * np.pi * np.fft.rfftfreq(whole)
    z = np.exp(1j * angle)
    rigid = plant.output_shapes[0, 0] * plant.input_shapes[0, 0] * sample_time**2 / 2
    flexible = zoh_modes(plant.modes(slice(1, None)), sample_time)
    gain = rigid * (z + 1) + (z - 1) ** 2 * flexible.frequency_response(angle / sample_time)[0, 0]
    values = np.fft.irfft(np.fft.rfft(np.diff(steps), whole) / gain, whole)
    states = np.vstack([values[:size], moved])
    return Force((np.arange(size) - ahead) * sample_time, states, np.zeros((5, 5)), np.eye(5)[0])


@checked
def feedforward_error(ideal: Force, feedforward: Feedforward) -> Force:
    """Ideal force less the applied one: what the loop must reject (Fig. 4.9)."""
    row = ideal.row.copy()
    row[-4:] -= feedforward.gains
    return replace(ideal, row=row)


def respond(model: StateModel, force: Force) -> Float64[np.ndarray, "outputs samples"]:
    """Outputs of a continuous model driven by the force alone, exact at the samples."""
    n, size = len(model.a), len(force.generator)
    chain = np.zeros((n + size, n + size))
    chain[:n, :n], chain[:n, n:], chain[n:, n:] = model.a, model.b * force.row, force.generator
    sample_time = float(force.time[1] - force.time[0])
    none = np.zeros((n + size, 0))
    held = zoh(StateModel(chain, none, none.T, np.zeros((0, 0))), sample_time).a
    exact = StateModel(held[:n, :n], held[:n, n:], model.c, model.d * force.row, sample_time)
    return simulate(exact, force.states)
