r"""Observer and controller of the stage in one optimisation, the first recommendation of chapter 7, as a processor runs it.

The structure is the published one: the PID controller (3.1), the Kalman observer with a noise model, compensation and
damping through one band-pass a mode. All of it is sampled, and the whole control force is late: what sample k commands
acts from `delay` samples later on, held for one. The observer is told which force acts when, and predicts the
velocities that it damps to the moment at which its force begins.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from scipy import linalg

from experiments.motion.designs import COMPENSATED, RETAINED
from experiments.motion.machines import published_noise, stage, stage_mass
from stillwork.base.checks import require_array, require_number
from stillwork.control.applications import filtered_estimates
from stillwork.control.digital import observed_controller
from stillwork.control.feedback import band_pass, damping_gain
from stillwork.control.pid import Pid
from stillwork.estimation.riccati import discrete_gain
from stillwork.lti.delays import delayed
from stillwork.lti.discretisation import prewarped, tustin, zoh_modes
from stillwork.lti.modal import ModalModel
from stillwork.lti.reduction import truncate
from stillwork.lti.state_space import StateModel

SAMPLE_TIME, DELAY = 1e-4, 1.5  # s, as in notebook 11; samples from command to force
CONTROLLER = ("bandwidth_hz", "integrator", "differentiator", "low_pass", "low_pass_damping")
OBSERVER = ("process", "noise_model", "damping", "selectivity")
NUMBERS = CONTROLLER + OBSERVER


@dataclass(frozen=True)
class JointDesign:
    """All numbers of an observer and its controller; the defaults are the published ones."""

    bandwidth_hz: float = 77.7  # f, design parameter of (3.1): Kp = M (2 pi f)^2/3
    integrator: float = 1.0  # over the 2 pi f / 9 of Table 3.3
    differentiator: float = 1 / 3  # over 2 pi f
    low_pass: float = 3.0  # over 2 pi f
    low_pass_damping: float = 0.7
    process: float = 1.0  # Q over the published one
    noise_model: float = 1e3  # Q_nu, N^2/s
    damping: tuple[float, ...] = (0.035, 0.035, 0.035)  # increase of each mode's ratio
    selectivity: tuple[float, ...] = (2.0, 2.0, 2.0)  # Q of each band-pass

    def __post_init__(self):
        for name in ("damping", "selectivity"):
            require_array(name, np.array(getattr(self, name)), shape=(RETAINED - 1,))
        for name in NUMBERS:
            for value in np.atleast_1d(getattr(self, name)):
                require_number(name, value, above=0.0)

    @property
    def controller(self) -> Pid:
        """The PID controller."""
        w = 2 * np.pi * self.bandwidth_hz
        rates = self.integrator * w / 9, self.differentiator * w, self.low_pass * w
        return Pid(_mass() * w**2 / 3, *rates, self.low_pass_damping)


_mass, _noise = cache(stage_mass), cache(published_noise)  # a search asks for them thousands of times


class Late(NamedTuple):
    """A model of modes whose force is held and late: x+ = a x + new f(k-n) + old f(k-n-1), n whole samples of delay."""

    a: Float64[np.ndarray, "states states"]
    new: Float64[np.ndarray, " states"]
    old: Float64[np.ndarray, " states"]
    whole: int
    shapes: Float64[np.ndarray, "outputs modes"]


def late(model: ModalModel, delay: float = DELAY) -> Late:
    """Exact sampled modes of a model with one input; the delay in samples need not be whole."""
    whole = int(delay)
    part = delay - whole
    full, rest = zoh_modes(model, SAMPLE_TIME), zoh_modes(model, (1 - part) * SAMPLE_TIME)
    old = rest.a @ zoh_modes(model, part * SAMPLE_TIME).b[:, 0] if part else np.zeros(len(full.a))
    return Late(full.a, rest.b[:, 0], old, whole, model.output_shapes)


def late_response(moved: Late, omega: np.ndarray) -> Complex128[np.ndarray, "outputs frequencies"]:
    """From the command to all outputs at some frequencies (rad/s), mode by mode in closed form."""
    z = np.exp(1j * omega * SAMPLE_TIME)
    rows = np.arange(0, len(moved.a), 2)
    # The trace near 2 and the determinant near 1 cancel at low frequencies: write them as differences from 1.
    first, second = moved.a[rows, rows, None] - 1, moved.a[rows + 1, rows + 1, None] - 1
    cross, lifted = moved.a[rows, rows + 1, None], z - 1
    determinant = lifted**2 - lifted * (first + second) + first * second
    determinant -= cross * moved.a[rows + 1, rows, None]
    force = moved.new[:, None] + moved.old[:, None] / z
    position = ((lifted - second) * force[::2] + cross * force[1::2]) / determinant
    return moved.shapes @ (position / z**moved.whole)


def late_plant(moved: Late, mass: int) -> StateModel:
    """The plant as the processor meets it, measured at one mass: from the command to the position."""
    n, kept = len(moved.a), moved.whole + 1
    forces = np.zeros((n, kept + 1))  # f(k), ... f(k-n-1)
    forces[:, -2], forces[:, -1] = moved.new, moved.old
    a = np.block([[moved.a, forces[:, 1:]], [np.zeros((kept, n)), np.eye(kept, k=-1)]])
    b = np.vstack([forces[:, :1], np.eye(kept, 1)])
    c = np.zeros((1, n + kept))
    c[0, :n:2] = moved.shapes[mass - 1]
    return StateModel(a, b, c, np.zeros((1, 1)), SAMPLE_TIME)


@cache
def _observed() -> ModalModel:
    """What the observers know: the retained modes of the nominal stage, and what the others add at rest."""
    return truncate(stage(), RETAINED, COMPENSATED)


class Estimator(NamedTuple):
    """Observer of one mass, x+ = a x + by y + new f(k-n) + old f(k-n-1); it reads c x + dy y + dold f(k-n-1) + ..."""

    a: np.ndarray
    drive: np.ndarray  # (states, 1 + n + 1): of y, f(k-1), ... f(k-n-1), and of f(k) before them where n = 0
    c: np.ndarray  # (4, states): what the modes put into the measurement, and three velocities ahead
    direct: np.ndarray  # (4, 1 + n + 1)
    modal: tuple[np.ndarray, ...]  # eigenvalues of a, drive and c in its eigenvectors


@lru_cache(maxsize=8)  # a search moves the other numbers far more often
def estimators(process: float, noise_model: float, delay: float) -> tuple[Estimator, ...]:
    """The sampled Kalman observers of all seven masses."""
    model = _observed()
    whole, part = int(delay), delay - int(delay)
    modes, moved = zoh_modes(model, SAMPLE_TIME), late(model, delay)
    n = len(modes.a)

    def walked(a, b):  # a constant force, the noise model, pushes along
        return np.block([[a, b], [np.zeros((1, n)), np.ones((1, 1))]])

    a, drive = walked(modes.a, modes.b), linalg.block_diag(modes.b, 1.0)
    ahead = np.eye(n + 1)
    forces = np.zeros((n + 1, whole + 2))  # of f(k), ... f(k-n-1) on the state ahead
    for k in range(whole):
        ahead, forces = a @ ahead, a @ forces
        forces[:n, whole - k] += moved.new
        forces[:n, whole - k + 1] += moved.old
    if part:
        short = zoh_modes(model, part * SAMPLE_TIME)
        tail = walked(short.a, short.b)
        ahead, forces = tail @ ahead, tail @ forces
        forces[:n, 1] += short.b[:, 0]
    rows = np.eye(n + 1)[[3, 5, 7]]
    variances = np.diag([process * _noise().process / SAMPLE_TIME, noise_model * SAMPLE_TIME])
    found = []
    for shape, compliance in zip(model.output_shapes, model.feedthrough[:, 0], strict=True):
        c, flexible = np.zeros((1, n + 1)), np.zeros((1, n + 1))
        c[0, :n:2], flexible[0, 2:n:2] = shape, shape[1:]
        gain = discrete_gain(a, drive, c, variances, _noise().sensor / SAMPLE_TIME).filter_gain
        kept = np.eye(n + 1) - gain @ c
        # The compliance shows the force that acts when the sample is taken, f(k-n-1).
        acts = np.zeros((1, whole + 2))
        acts[0, -1] = compliance
        updated = np.hstack([gain, -gain @ acts])  # of y, f(k), ... f(k-n-1)
        into = a @ updated
        into[:n, 1 + whole] += moved.new
        into[:n, 2 + whole] += moved.old
        direct = np.vstack([flexible @ updated, rows @ ahead @ updated])
        direct[1:, 1:] += rows @ forces
        transition, read = a @ kept, np.vstack([flexible, rows @ ahead]) @ kept
        values, vectors = linalg.eig(transition)
        modal = values, linalg.solve(vectors, into), read @ vectors
        found.append(Estimator(transition, into, read, direct, modal))
    return tuple(found)


def sampled_compensator(design: JointDesign, mass: int, delay: float = DELAY) -> StateModel:
    """The block from (f, y) to (u_d, y_flex), see `stillwork.control.loops.closed_loop`."""
    found = estimators(design.process, design.noise_model, delay)[mass - 1]
    n, kept = len(found.a), int(delay) + 1
    a = np.block([[found.a, found.drive[:, 2:]], [np.zeros((kept, n)), np.eye(kept, k=-1)]])
    b = np.zeros((n + kept, 2))
    b[:n], b[n, 0] = found.drive[:, 1::-1], 1.0
    c, d = np.hstack([found.c, found.direct[:, 2:]]), found.direct[:, 1::-1]
    estimator, gain = StateModel(a, b, c, d, SAMPLE_TIME), _unit_gain() * design.damping
    centres = _observed().frequencies[1:].tolist()
    filters = [
        tustin(band_pass(w, q), SAMPLE_TIME, w) for w, q in zip(centres, design.selectivity, strict=True)
    ]
    return filtered_estimates(estimator, filters, gain[None])


@cache
def _unit_gain() -> np.ndarray:
    return damping_gain(_observed(), np.ones(RETAINED - 1))[0, 3::2]


def closed_poles(
    design: JointDesign,
    plants: Sequence[ModalModel],
    delay: float = DELAY,
    alone: int = 0,
    told: float | None = None,
) -> Complex128[np.ndarray, "plants masses states"]:
    """Poles z of the loops of all masses on every plant, by the eigenvalues of plant and controller together.

    `alone` (samples) delays the controller's output by itself, before the damping force is added; `told` is the delay
    that the observer knows of, by default `delay`.
    """
    told = delay if told is None else told
    controller, found = delayed(tustin(design.controller.state_space(), SAMPLE_TIME), alone), []
    moved = [late(plant, delay) for plant in plants]
    for mass in range(1, 8):
        seen = observed_controller(controller, sampled_compensator(design, mass, told))  # from r, y and f
        into, direct = seen.b[:, 2:], seen.d[:, 1:2]
        a, b = seen.a + into @ seen.c, seen.b[:, 1:2] + into @ direct
        met = [late_plant(each, mass) for each in moved]
        found.append([np.block([[p.a + p.b @ direct @ p.c, p.b @ seen.c], [b @ p.c, a]]) for p in met])
    return np.swapaxes(np.linalg.eigvals(np.array(found)), 0, 1).astype(complex)


class Compensated(NamedTuple):
    """What a design puts around any plant, the masses and frequencies last."""

    feedback: Complex128[np.ndarray, "masses frequencies"]  # C_y, from -y to f
    reference: Complex128[np.ndarray, "masses frequencies"]  # C_r, from r to f
    share: Complex128[np.ndarray, "masses frequencies"]  # S_I is (share - seen P) S_O
    seen: Complex128[np.ndarray, "masses frequencies"]


def compensated(
    design: JointDesign, omega: np.ndarray, delay: float = DELAY, alone: int = 0, masses: slice = slice(None)
) -> Compensated:
    """The design's responses at some frequencies (rad/s), with an observer that is told of `delay`."""
    z = np.exp(1j * omega * SAMPLE_TIME)
    estimates = _estimates(design.process, design.noise_model, delay, omega.tobytes())[:, masses]
    s = prewarped(omega, SAMPLE_TIME)
    w, q = _observed().frequencies[1:, None], np.array(design.selectivity)[:, None]
    warped = 1j * s * w * SAMPLE_TIME / 2 / np.tan(w * SAMPLE_TIME / 2)
    band = (_unit_gain() * design.damping)[:, None] * (w / q) * warped / (warped**2 + (w / q) * warped + w**2)
    (o_yy, o_yu) = estimates[:, :, 0]
    o_uy, o_uu = np.einsum("impf,pf->imf", estimates[:, :, 1:], band)
    pid = design.controller.frequency_response(s) / z**alone
    turn = 1 - pid * o_yu - o_uu
    return Compensated((pid * (1 - o_yy) - o_uy) / turn, pid / turn, (1 - o_uu) / turn, o_uy / turn)


@lru_cache(maxsize=8)
def _estimates(process: float, noise_model: float, delay: float, omega: bytes) -> np.ndarray:
    """From y and from f: y_flex and the velocities ahead, (2, masses, 4, frequencies), by the observers' eigenvectors."""
    z = np.exp(1j * np.frombuffer(omega) * SAMPLE_TIME)
    past = z ** -np.arange(int(delay) + 2)[:, None]
    out = []
    for each in estimators(process, noise_model, delay):
        values, drive, read = each.modal
        turn = 1 / (z - values[:, None])
        by_output = read @ (turn * drive[:, :1]) + each.direct[:, :1]
        by_force = read @ (turn * (drive[:, 1:] @ past)) + each.direct[:, 1:] @ past
        out.append((by_output, by_force))
    return np.swapaxes(np.array(out), 0, 1)
