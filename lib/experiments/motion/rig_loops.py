"""Bandwidth of the rig: one diagonal discrete PID for four sensor positions, every MIMO sensitivity below 6 dB."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg

from experiments.motion.rig import EdgeDecoupling
from experiments.motion.rig_control import RigCompensator
from stillwork.base.algebra import squared_size
from stillwork.base.checks import InputError, require_choice, require_number
from stillwork.base.kernels import kernel, pasted_kernel
from stillwork.base.rounding import first_largest
from stillwork.control.bandwidth import SIX_DB
from stillwork.control.crossover import crossover
from stillwork.control.loops import closed_loop
from stillwork.control.pid import Pid
from stillwork.lti.discretisation import prewarped, tustin, zoh_modes, zoh_response
from stillwork.lti.modal import ModalModel
from stillwork.lti.peaks import resonance_grid
from stillwork.lti.state_space import StateModel, interconnect

# Section 6.1: both orders of the plant with the controller, at the controller and at the plant, and the true error.
MEASURES = ("singular values", "diagonal")  # what "peak below 6 dB" means for a matrix is not printed
FUNCTIONS = ("S_I", "S_I2", "S_O", "S_O2", "true_tracking")

RATIO = 1.1  # of the search, a step on its way up
TOLERANCE = 1e-3  # relative width at which its bisection stops


def sampled_controller(pids: Sequence[Pid], decoupling: EdgeDecoupling, sample_time: float) -> StateModel:
    """Gamma C_fb Upsilon, from the errors at the sensors to forces."""
    blocks = [tustin(pid.state_space(), sample_time) for pid in pids]
    return interconnect(blocks, np.zeros((3, 3)), decoupling.sensing, decoupling.actuation)


@dataclass(frozen=True)
class RigLoop:
    """One position: plant, compensator and decoupling, with their responses on a frequency grid."""

    plant: ModalModel  # three actuators, three sensors
    compensator: RigCompensator | None
    decoupling: EdgeDecoupling
    sample_time: float  # s
    omega: Float64[np.ndarray, " frequencies"] = field(repr=False)  # rad/s
    parts: Complex128[np.ndarray, "frequencies 8 3 3"] = field(repr=False)  # all but the controller, `_parts`

    @cached_property
    def warped(self) -> Float64[np.ndarray, " frequencies"]:
        """Where continuous controllers are evaluated for the grid: the same in every step of a search (rad/s)."""
        return prewarped(self.omega, self.sample_time)

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
        return closed_loop(zoh_modes(self.plant, self.sample_time), block, controller)

    def radius(self, pids: Sequence[Pid]) -> float:
        """Largest magnitude of the closed-loop poles; below 1 the loop is stable."""
        balanced, _ = linalg.matrix_balance(self.closed(pids).a, permute=False)
        return float(np.abs(linalg.eigvals(balanced)).max())


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
    if plant.feedthrough.shape != (3, 3):
        raise InputError("plant must have three inputs and three outputs; pick them with plant.at")
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


def peaks(
    loops: Sequence[RigLoop], pids: Sequence[Pid], measure: str = "singular values"
) -> Float64[np.ndarray, "loops functions"]:
    """Largest size of every loop function on the grid of every loop."""
    return np.array([sizes(loop, pids, measure).max(axis=1) for loop in loops])


def sizes(
    loop: RigLoop, pids: Sequence[Pid], measure: str = "singular values"
) -> Float64[np.ndarray, "functions frequencies"]:
    """Size of the five loop functions over frequency: largest singular value, or magnitude on the diagonal."""
    require_choice("measure", measure, MEASURES)
    return _sizes(*_arrays(loop, pids), measure == "diagonal")


def _arrays(loop: RigLoop, pids: Sequence[Pid]):
    """All but the controller, and the controller; of PIDs that differ in their gains alone one is evaluated."""
    control, alike = np.empty((len(loop.omega), len(pids)), complex), {}
    for k, pid in enumerate(pids):
        shape = (pid.integrator, pid.differentiator, pid.low_pass, pid.low_pass_damping, pid.notches)
        if shape not in alike:
            alike[shape] = pid.gain, pid.frequency_response(loop.warped)
        gain, response = alike[shape]
        control[:, k] = response * (pid.gain / gain)
    return loop.parts, control


class Infeasible(InputError):
    """No bandwidth passes: a loop function exceeds its limit however slow the controller is."""


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
            raise Infeasible(
                "there is no design, so none of its loop functions is the largest; take another case"
            )
        return FUNCTIONS[first_largest(self.peaks.max(axis=0))]


def no_bandwidth() -> RigBandwidth:
    """What stands for a design that there is not: all its numbers are NaN."""
    sizes = (2, (1, 3), (1, len(FUNCTIONS)), 1)
    design, crossing, peaks, radius = (np.full(size, np.nan) for size in sizes)
    return RigBandwidth(tuple(design), crossing, None, peaks, radius)


def maximise_rig_bandwidth(
    loops: Sequence[RigLoop],
    family: Callable[[float, float], tuple[Pid, Pid, Pid]],
    measure: str = "singular values",
    low_hz: float = 1.5,
    high_hz: float = 60.0,
) -> RigBandwidth:
    """Largest bandwidths for which every position is stable and every loop function stays below 6 dB.

    `family` gives the three PIDs from the design bandwidths of z and of both rotations (Hz).

    All directions are raised together first; then the rotations alone, then z alone, as far as each still can.
    Along the way no peak exceeds the limit, so no pole can cross the unit circle; the start and the end are
    checked by eigenvalues.
    """
    require_choice("measure", measure, MEASURES)
    if not loops:
        raise InputError("loops is empty; give at least one position")
    require_number("high_hz", high_hz, above=require_number("low_hz", low_hz, above=0.0))
    loops, start = list(loops), low_hz
    for _ in range(4):  # the grids gain points around the peaks that stop the search, until these stand
        order, hints = list(range(len(loops))), [0] * len(loops)  # looked at first: what was exceeded last

        def feasible(z_hz: float, rotation_hz: float, order=order, hints=hints, loops=loops) -> bool:
            pids = family(z_hz, rotation_hz)
            for k in order:
                found = _exceeded(*_arrays(loops[k], pids), measure == "diagonal", SIX_DB, hints[k])
                if found >= 0:
                    hints[k] = found
                    order.remove(k)
                    order.insert(0, k)
                    return False
            return True

        while not feasible(start, start):
            if start == low_hz:
                raise Infeasible(
                    f"a loop function exceeds the limit at low_hz = {low_hz:g} already; lower it"
                )
            start = max(start / RATIO, low_hz)
        z = rotation = _climb(lambda f: feasible(f, f), start, high_hz)
        start = z / RATIO
        rotation = _climb(lambda f, z=z: feasible(z, f), rotation, high_hz)
        z = _climb(lambda f, r=rotation: feasible(f, r), z, high_hz)
        pids = family(z, rotation)
        finer = [_refined(loop, pids, measure) for loop in loops]
        found = peaks(finer, pids, measure)
        if found.max() <= SIX_DB * (1 + 5 * TOLERANCE):
            break
        loops = finer
    if max(z, rotation) >= high_hz:
        raise InputError(f"all constraints hold even at high_hz = {high_hz:g}; raise it to find the limit")
    radius = np.array([loop.radius(pids) for loop in loops])
    if np.any(radius >= 1):
        raise InputError("the loop is unstable at low_hz already, although its peaks are low; lower low_hz")
    crossings = np.array([_crossings(loop, pids) for loop in loops])
    return RigBandwidth((z, rotation), crossings, pids, found, radius)


def _climb(feasible, low: float, high: float) -> float:
    """Step up from a feasible value until one is not, then bisect."""
    good, bad = low, low * RATIO
    while feasible(bad):
        good, bad = bad, bad * RATIO
        if good >= high:
            return good
    while bad > good * (1 + TOLERANCE):
        middle = np.sqrt(good * bad)
        good, bad = (middle, bad) if feasible(middle) else (good, middle)
    return float(good)


def _refined(loop: RigLoop, pids: Sequence[Pid], measure: str) -> RigLoop:
    """The loop on its grid with more points around every local maximum near the limit."""
    values = sizes(loop, pids, measure)
    inner = (values[:, 1:-1] >= values[:, :-2]) & (values[:, 1:-1] >= values[:, 2:])
    places = 1 + np.unique(np.nonzero(inner & (values[:, 1:-1] > 0.8 * SIX_DB))[1])
    if not len(places):
        return loop
    w = loop.omega
    extra = np.concatenate([np.linspace(w[k - 1], w[k + 1], 19)[1:-1] for k in places])
    more = loop.on(np.setdiff1d(extra, w))
    order = np.argsort(np.concatenate([w, more.omega]))
    return replace(
        loop,
        omega=np.concatenate([w, more.omega])[order],
        parts=np.concatenate([loop.parts, more.parts])[order],
    )


def _crossings(loop: RigLoop, pids: Sequence[Pid]) -> Float64[np.ndarray, "3"]:
    """First 0 dB crossing (Hz) of the diagonal entries of P_eq C_fb (Definition 1.2.1)."""
    upsilon, gamma = loop.decoupling.sensing, loop.decoupling.actuation

    def gain(w, k: int) -> Complex128[np.ndarray, " frequencies"]:
        # P_eq alone: a search asks for one point
        _, _, n, seen = _around(loop.plant, loop.compensator, loop.sample_time, w)
        control = pids[k].frequency_response(prewarped(w, loop.sample_time))
        return (upsilon @ seen @ (n @ gamma))[:, k, k] * control

    grid = loop.equivalent_plant()
    found = [
        crossover(partial(gain, k=k), loop.omega, np.abs(grid[k, k] * pid.frequency_response(loop.warped)))
        for k, pid in enumerate(pids)
    ]
    return np.array(found) / (2 * np.pi)


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


@kernel
def _exceeded(parts, control, entries, limit, first):
    """Index of a frequency where a loop function exceeds the limit, or -1."""
    count = parts.shape[0]
    work = np.empty((8, 3, 3), np.complex128)
    for i in range(count):
        k = (first + i) % count
        _functions(parts[k], control[k], work)
        for f in range(5):
            if entries:
                square = _largest_entry_square(work[f])
            else:
                square = _sum_of_squares(work[f])  # no singular value exceeds its root
                if not square <= limit * limit:
                    square = _largest_square(work[f])
            if not square <= limit * limit:
                return k
    return -1


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
def _sum_of_squares(a):
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += squared_size(a[i, j])
    return total


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
