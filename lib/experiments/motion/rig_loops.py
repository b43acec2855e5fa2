"""Bandwidth of the rig: one diagonal discrete PID for four sensor positions, every MIMO sensitivity below 6 dB."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg

from experiments.motion.rig import EdgeDecoupling
from experiments.motion.rig_control import RigCompensator
from stillwork.base.algebra import squared_size
from stillwork.base.checks import InputError
from stillwork.base.kernels import kernel, pasted_kernel
from stillwork.base.rounding import first_largest
from stillwork.base.validation import checked
from stillwork.control.bandwidth import SIX_DB, Bandwidth, PeakConstraint, maximise_bandwidth
from stillwork.control.crossover import crossover
from stillwork.control.loops import channel, closed_loop
from stillwork.control.pid import Pid
from stillwork.lti.discretisation import continuous_poles, prewarped, tustin, zoh_modes, zoh_response
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.state_space import StateModel, constant, interconnect

# Section 6.1: both orders of the plant with the controller, at the controller and at the plant, and the true error.
MEASURES = ("singular values", "diagonal")  # what "peak below 6 dB" means for a matrix is not printed
FUNCTIONS = {
    "S_I": "input_sensitivity",
    "S_I2": "input_sensitivity_2",
    "S_O": "output_sensitivity",
    "S_O2": "output_sensitivity_2",
    "true_tracking": "true_tracking",
}
LIMITS = tuple(PeakConstraint(name) for name in FUNCTIONS.values())  # 6 dB

LOWEST_HZ, HIGHEST_HZ, TOLERANCE_HZ = 1.5, 60.0, 2e-3  # of a design
PEAK_TOLERANCE = 1e-4  # relative, by which a peak may grow between the points of the last grid


def sampled_controller(pids: Sequence[Pid], decoupling: EdgeDecoupling, sample_time: float) -> StateModel:
    """Gamma C_fb Upsilon, from the errors at the sensors to forces."""
    blocks = [_sampled(pid, sample_time) for pid in pids]
    return interconnect(blocks, np.zeros((3, 3)), decoupling.sensing, decoupling.actuation)


@lru_cache(maxsize=64)  # one controller closes the loop at every position
def _sampled(pid: Pid, sample_time: float) -> StateModel:
    return tustin(pid.state_space(), sample_time)


@dataclass(frozen=True)
class RigLoop:
    """One position: plant, compensator and decoupling, with their responses on a frequency grid."""

    plant: ModalModel  # three actuators, three sensors
    compensator: RigCompensator | None
    decoupling: EdgeDecoupling
    sample_time: float  # s
    omega: Float64[np.ndarray, " frequencies"] = field(repr=False)  # rad/s
    parts: Complex128[np.ndarray, "frequencies 8 3 3"] = field(repr=False)  # all but the controller, `_parts`
    measure: str = "singular values"  # largest one over directions, or "diagonal": largest entry on it

    def controlled(self, pids: Sequence[Pid]) -> Complex128[np.ndarray, "frequencies 3"]:
        """Responses of the controllers; of those that differ in their gains alone one is evaluated."""
        found, alike = np.empty((len(self.omega), len(pids)), complex), {}
        for k, pid in enumerate(pids):
            shape = (pid.integrator, pid.differentiator, pid.low_pass, pid.low_pass_damping, pid.notches)
            if shape not in alike:
                alike[shape] = pid.gain, pid.frequency_response(self._warped)
            gain, response = alike[shape]
            found[:, k] = response * (pid.gain / gain)
        return found

    @cached_property
    def _warped(self) -> Float64[np.ndarray, " frequencies"]:
        return prewarped(self.omega, self.sample_time)

    @checked
    def at(self, pids: Sequence[Pid], omega: np.ndarray | None = None) -> "Sizes":
        """Sizes of the loop functions on the grid, or at other frequencies (rad/s)."""
        return (self if omega is None else self.on(omega)).sizes(pids)

    def sizes(self, pids: Sequence[Pid]) -> "Sizes":
        """As of `at`, on the grid, of controllers that are known to be such."""
        return Sizes(*_sizes(self.parts, self.controlled(pids), self.measure == "diagonal"))

    def within(self, pids: Sequence[Pid], part: slice) -> "Sizes":
        """Sizes on a part of the grid."""
        return replace(self, omega=self.omega[part], parts=self.parts[part]).sizes(pids)

    def denser(self, values: Float64[np.ndarray, "functions frequencies"]) -> "RigLoop":
        """The loop on its grid with more points around every local maximum of these sizes that is near the limit."""
        w = self.omega
        inner = (values[:, 1:-1] >= values[:, :-2]) & (values[:, 1:-1] >= values[:, 2:])
        places = 1 + np.unique(np.nonzero(inner & (values[:, 1:-1] > 0.8 * SIX_DB))[1])
        if not len(places):
            return self
        extra = np.concatenate([np.linspace(w[k - 1], w[k + 1], 19)[1:-1] for k in places])
        more = self.on(np.setdiff1d(extra, w))
        order = np.argsort(np.concatenate([w, more.omega]))
        parts = np.concatenate([self.parts, more.parts])[order]
        return replace(self, omega=np.concatenate([w, more.omega])[order], parts=parts)

    def on(self, omega: Float64[np.ndarray, " frequencies"]) -> "RigLoop":
        """The same loop on another grid (rad/s)."""
        return make_rig_loop(self.plant, self.compensator, self.decoupling, self.sample_time, omega)

    def equivalent_plant(self) -> Complex128[np.ndarray, "3 3 frequencies"]:
        """Decoupled plant that the controller sees, u to q_comp: of Figs 6.3 and 6.5 to 6.9 (scaled directions)."""
        return np.moveaxis(self.parts[:, 0], 0, -1)

    def closed(self, pids: Sequence[Pid]) -> StateModel:
        """Closed loop in discrete time; its signals are `stillwork.control.loops.INPUTS` and ``OUTPUTS``."""
        block = None if self.compensator is None else self.compensator.realised
        controller = sampled_controller(pids, self.decoupling, self.sample_time)
        return closed_loop(self._held, block, controller)

    @cached_property  # one plant is closed with every controller
    def _held(self) -> StateModel:
        return zoh_modes(self.plant, self.sample_time)

    @checked
    def poles(self, pids: Sequence[Pid]) -> Complex128[np.ndarray, " states"]:
        """Closed-loop poles, rad/s."""
        blocks = [self._seen, *(_sampled(pid, self.sample_time) for pid in pids)]
        joined, none = np.kron([[0, 1], [1, 0]], np.eye(3)), np.zeros((6, 0))
        return continuous_poles(interconnect(blocks, joined, none, none.T).poles, self.sample_time)

    @cached_property  # what every controller meets, from its forces to its errors
    def _seen(self) -> StateModel:
        block = None if self.compensator is None else self.compensator.realised
        open_loop = closed_loop(self._held, block, constant(np.zeros((3, 3)), self.sample_time))
        loop = channel(open_loop, "u_ff", "e_meas", 3, 3)
        upsilon, gamma = self.decoupling.sensing, self.decoupling.actuation
        return replace(loop, b=loop.b @ gamma, c=upsilon @ loop.c, d=upsilon @ loop.d @ gamma)

    def radius(self, pids: Sequence[Pid]) -> float:
        """Largest magnitude of the closed-loop poles in discrete time; below 1 the loop is stable."""
        return _radius(self.poles(pids), self.sample_time)

    @checked
    def crossing_hz(self, pids: Sequence[Pid]) -> Float64[np.ndarray, "3"]:
        """First 0 dB crossing of the diagonal entries of P_eq C_fb (Definition 1.2.1), Hz."""
        upsilon, gamma = self.decoupling.sensing, self.decoupling.actuation

        def gain(w, k: int) -> Complex128[np.ndarray, " frequencies"]:
            # P_eq alone: a search asks for one point
            _, _, n, seen = _around(self.plant, self.compensator, self.sample_time, w)
            control = pids[k].frequency_response(prewarped(w, self.sample_time))
            return (upsilon @ seen @ (n @ gamma))[:, k, k] * control

        grid = np.abs(np.diagonal(self.parts[:, 0], axis1=1, axis2=2) * self.controlled(pids))
        return np.array([crossover(partial(gain, k=k), self.omega, grid[:, k]) for k in range(3)]) / (
            2 * np.pi
        )


class Sizes(NamedTuple):
    """Largest singular value, or entry on the diagonal, of the loop functions over frequency, in the order of `FUNCTIONS`."""

    input_sensitivity: Float64[np.ndarray, " frequencies"]
    input_sensitivity_2: Float64[np.ndarray, " frequencies"]
    output_sensitivity: Float64[np.ndarray, " frequencies"]
    output_sensitivity_2: Float64[np.ndarray, " frequencies"]
    true_tracking: Float64[np.ndarray, " frequencies"]


def make_rig_loop(
    plant: ModalModel,
    compensator: RigCompensator | None,
    decoupling: EdgeDecoupling,
    sample_time: float,
    omega: Float64[np.ndarray, " frequencies"] | None = None,
) -> RigLoop:
    """Prepare one position: three actuators to three sensors.

    The grid (rad/s) goes by default up to the Nyquist frequency, dense around every mode of the plant and every
    lightly damped pole of the observer.
    """
    if omega is None:
        poles = plant.poles
        if compensator is not None:
            observer = compensator.observer
            sampled = linalg.eigvals(observer.a - observer.a @ observer.gain @ observer.c)
            own = np.log(sampled[np.abs(sampled) > 1e-3].astype(complex)) / sample_time
            poles = np.concatenate([poles, own[np.abs(own.real) < 0.1 * np.abs(own)]])
        omega = resonance_grid(poles, 0.3, 0.499 / sample_time, 80, 8)
    around = _around(plant, compensator, sample_time, omega)
    return RigLoop(plant, compensator, decoupling, sample_time, omega, _parts(*around, decoupling))


def _around(plant: ModalModel, compensator: RigCompensator | None, sample_time: float, omega):
    """Plant P and compensator O of every frequency, and N = (I - O_uu - O_uy P)^-1 and Z = (I - O_yy) P - O_yu."""
    p = np.moveaxis(zoh_response(plant, sample_time, omega), -1, 0)
    o = np.zeros((len(omega), 6, 6), complex)
    if compensator is not None:
        o = np.moveaxis(compensator.frequency_response(omega), -1, 0)
    o_uu, o_uy, o_yu, o_yy = o[:, :3, :3], o[:, :3, 3:], o[:, 3:, :3], o[:, 3:, 3:]
    one = np.eye(3)
    return p, o, np.linalg.inv(one - o_uu - o_uy @ p), (one - o_yy) @ p - o_yu


def _parts(p, o, n, seen, decoupling: EdgeDecoupling) -> Complex128[np.ndarray, "frequencies 8 3 3"]:
    """What the loop functions are made of.

    The plant's input is f = N Gamma u, so that P_eq = Upsilon Z N Gamma. Noise at the sensors enters q_comp by
    V = Upsilon (Z N O_uy + I - O_yy).
    """
    gamma, upsilon = decoupling.actuation, decoupling.sensing
    o_uy, o_yy = o[:, :3, 3:], o[:, 3:, 3:]
    one = np.eye(3)
    force = n @ gamma
    v = upsilon @ (seen @ n @ o_uy + one - o_yy)
    damped = n @ o_uy
    terms = (
        upsilon @ seen @ force,  # P_eq
        upsilon @ p @ force,  # u to the true q
        one + p @ damped,
        p @ force,
        v,
        one + damped @ p,
        force,
        v @ p,
    )
    return np.ascontiguousarray(np.stack(np.broadcast_arrays(*terms), axis=1))


class RigBandwidth(NamedTuple):
    """The largest feasible design of the rig."""

    design_hz: tuple[float, float]  # of z and of the rotations
    crossing_hz: Float64[np.ndarray, "loops 3"]  # first 0 dB crossing of each direction's own loop
    pids: tuple[Pid, Pid, Pid] | None
    peaks: Float64[np.ndarray, "loops functions"]  # at that design, refined
    radius: Float64[np.ndarray, " loops"]  # of the closed-loop poles

    @property
    def active(self) -> str:
        """The loop function with the largest peak; the first of those that are equal but for rounding."""
        if self.pids is None:
            raise InputError(
                "there is no design, so none of its loop functions is the largest; take another case"
            )
        return list(FUNCTIONS)[first_largest(self.peaks.max(axis=0))]


def no_bandwidth() -> RigBandwidth:
    """What stands for a design that there is not: all its numbers are NaN."""
    sizes = (2, (1, 3), (1, len(FUNCTIONS)), 1)
    design, crossing, peaks, radius = (np.full(size, np.nan) for size in sizes)
    return RigBandwidth(tuple(design), crossing, None, peaks, radius)


def maximise_rig_bandwidth(
    loops: Sequence[RigLoop],
    family: Callable[[float, float], tuple[Pid, Pid, Pid]],
    measure: str = "singular values",
) -> RigBandwidth:
    """Largest bandwidths for which every position is stable and every loop function stays below 6 dB.

    `family` gives the three PIDs from the design bandwidths of z and of both rotations (Hz).

    All directions are raised together first; then the rotations alone, then z alone, as far as each still can.
    """
    loops = [replace(loop, measure=measure) for loop in loops]
    family = cache(family)

    def raised(along: Callable[[float], tuple[Pid, ...]], start: float) -> Bandwidth:
        found = maximise_bandwidth(
            [Positions(loops)],
            along,
            LIMITS,
            start,
            HIGHEST_HZ,
            tolerance_hz=TOLERANCE_HZ,
            refine=False,
            lowest=True,
            ratio=1.1,
        )
        if found.function == "the end of the search":
            raise InputError(
                f"all constraints hold even at {HIGHEST_HZ:g} Hz, where the search ends; raise HIGHEST_HZ"
            )
        return found

    for _ in range(6):  # the grids gain points around the peaks that stop the search, until these stand
        together = raised(lambda hz: family(hz, hz), LOWEST_HZ).design_hz
        rotation = raised(lambda hz, z=together: family(z, hz), together).design_hz
        last = raised(lambda hz, turned=rotation: family(hz, turned), together)
        pids = last.controller
        loops = [loop.denser(np.array(loop.sizes(pids))) for loop in loops]
        found = np.array([np.array(loop.sizes(pids)).max(axis=1) for loop in loops])
        if found.max() <= SIX_DB * (1 + PEAK_TOLERANCE):
            break
    else:
        raise InputError(
            "the peaks between the points of a grid do not settle; give loops with more frequencies"
        )
    radii = np.array([loop.radius(pids) for loop in loops])
    crossings = np.array([loop.crossing_hz(pids) for loop in loops])
    return RigBandwidth((last.design_hz, rotation), crossings, pids, found, radii)


def _radius(poles: np.ndarray, sample_time: float) -> float:
    """Largest magnitude in discrete time of poles in rad/s."""
    return float(np.exp(poles.real.max() * sample_time))


class Positions:
    """All positions as one loop of the search: one call of a kernel in place of one for each, no crossing on the way."""

    def __init__(self, loops: Sequence[RigLoop]):
        omega, parts = (
            np.concatenate([getattr(loop, name) for loop in loops]) for name in ("omega", "parts")
        )
        self.loops, self.omega = loops, omega
        self._all = replace(loops[0], omega=omega, parts=parts)  # sizes need neither plant nor observer

    def at(self, pids: tuple[Pid, ...], omega: np.ndarray | None = None) -> Sizes:
        assert omega is None, "positions have no grid in common"
        return self._all.sizes(pids)

    def within(self, pids: tuple[Pid, ...], part: slice) -> Sizes:
        return self._all.within(pids, part)

    def poles(self, pids: tuple[Pid, ...]) -> np.ndarray:
        return np.concatenate([loop.poles(pids) for loop in self.loops])

    def crossing_hz(self, pids: tuple[Pid, ...]) -> np.ndarray:
        return np.zeros(len(pids))


@kernel
def _sizes(parts, control, entries):
    count = parts.shape[0]
    found = np.empty((5, count))
    work = np.empty((8, 3, 3), np.complex128)
    for k in range(count):
        _functions(parts[k], control[k], work)
        for f in range(5):
            square = _largest_entry_square(work[f]) if entries else _largest_square(work[f])
            found[f, k] = np.sqrt(square)
    return found


@pasted_kernel
def _functions(part, control, work):
    """S_I, S_I2, S_O, S_O2 and r to e_true at one frequency, in the first five places of `work`."""
    turned, product = work[5], work[6]
    for i in range(3):
        for j in range(3):
            product[i, j] = part[0, i, j] * control[j]
        product[i, i] += 1
    _inverse(product, work[0])
    for i in range(3):
        for j in range(3):
            turned[i, j] = control[i] * work[0, i, j]  # C S_I = S_I2 C
            work[1, i, j] = turned[i, j] / control[j]
    _times(part[1], turned, work[4])
    for k in range(2):  # S_O and S_O2
        _times(part[2 + 3 * k + 1], turned, product)
        _times(product, part[2 + 3 * k + 2], work[2 + k])
        for i in range(3):
            for j in range(3):
                work[2 + k, i, j] = part[2 + 3 * k, i, j] - work[2 + k, i, j]
    for i in range(3):
        for j in range(3):
            work[4, i, j] = (1.0 if i == j else 0.0) - work[4, i, j]


@pasted_kernel
def _times(a, b, out):
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@pasted_kernel
def _inverse(a, out):
    """Inverse of a 3 x 3 matrix by cofactors."""
    for i in range(3):
        m, n = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            out[j, i] = a[m, p] * a[n, q] - a[m, q] * a[n, p]
    determinant = a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] /= determinant


@pasted_kernel
def _largest_entry_square(a):
    """Square of the largest magnitude on the diagonal."""
    largest = 0.0
    for k in range(3):
        size = squared_size(a[k, k])
        if not size <= largest:
            largest = size
    return largest


@pasted_kernel
def _largest_square(a):
    """Square of the largest singular value: the largest root of the cubic of A^H A."""
    h00, h11, h22 = 0.0, 0.0, 0.0
    h01, h02, h12 = 0j, 0j, 0j
    for k in range(3):
        x, y, z = a[k, 0], a[k, 1], a[k, 2]
        h00 += squared_size(x)
        h11 += squared_size(y)
        h22 += squared_size(z)
        h01 += x.conjugate() * y
        h02 += x.conjugate() * z
        h12 += y.conjugate() * z
    mean = (h00 + h11 + h22) / 3
    s01, s02, s12 = squared_size(h01), squared_size(h02), squared_size(h12)
    d0, d1, d2 = h00 - mean, h11 - mean, h22 - mean
    spread = np.sqrt((d0 * d0 + d1 * d1 + d2 * d2 + 2 * (s01 + s02 + s12)) / 6)
    if not spread > 1e-15 * mean:
        return mean
    triple = h01 * h12 * h02.conjugate()
    half = (d0 * (d1 * d2 - s12) - s01 * d2 - s02 * d1 + 2 * triple.real) / (2 * spread**3)
    return mean + 2 * spread * np.cos(np.arccos(min(1.0, max(-1.0, half))) / 3)
