"""A controller as run by a processor: sampled, with limits and anti-windup, and with bumpless transfer."""

import json
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64
from numpy.typing import ArrayLike
from scipy import linalg, signal

from stillwork.base.bounds import Natural, Positive
from stillwork.base.checks import (
    Converted,
    InputError,
    pluralise,
    require_array,
    require_choice,
    require_number,
    short_repr,
)
from stillwork.base.toml_files import Table, read_toml
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.feedforward import Feedforward, Motion
from stillwork.control.pid import Pid, series
from stillwork.control.setpoint import MoveLimits
from stillwork.lti.discretisation import tustin
from stillwork.lti.state_space import StateModel, interconnect

FORMAT = "stillwork controller 1"
AT_ONE = 1e-9  # a pole closer to 1 than this is an integrator: it would forget in a thousand million samples
# Of its file; what else stands there goes along with it.
KEPT = (
    *("format", "sample_time_s", "inputs", "outputs", "state_space", "low", "high", "anti_windup"),
    *("delay_samples", "patience_samples", "start", "motion", "interface"),
)
# Flags of a sample, as the C returns them.
SATURATED, HELD, INVALID = 1, 2, 4
PATIENCE = 10  # samples for which a missing input is held
INTERFACE = {
    "law": "v = C x + D e + u; f = v between low and high; next x = A x + B_e e + B_f (f - u) + anti_windup (f - v)",
    "state_space": "b and d: columns of the inputs e, then of f - u where there are more columns",
    "e": "inputs; of a motion controller the setpoint less the measurement, in the unit of its name",
    "u": "what is fed forward, in the unit of the output; the inputs are deviations from the motion that it makes",
    "start": "x for bumpless transfer: start times (e, f - u)",
    "delay_samples": "by which f leaves late",
    "patience_samples": "for which a missing input is held; then f and x stay until it is back",
    "motion": "u = velocity v + acceleration a + jerk j + snap s + coulomb sign(v) of the setpoint, lag_s before its position",
    "call_order": "once start; then each sample: measure, setpoint, e and u, step, output",
}
ALIKE = 1e-3  # to which sections must respond like the controller that they stand for: 0.009 dB of a peak
SAME = 1e-6  # to which a pole at zero and a zero must agree to cancel


@by_value
@dataclass(frozen=True)
class DigitalController:
    r"""A sampled controller, :math:`v = Cx + De + u`, :math:`f = \mathrm{sat}(v)`,
    :math:`x^+ = Ax + B_ee + B_f(f - u) + L(f - v)`, with a known force u that is fed forward.

    Attributes
    ----------
    model : StateModel
        In discrete time, from the inputs e to the command v; inputs behind those that have a name are the limited
        output f, which an observer needs. They must not reach v within the sample.
    inputs, outputs : tuple of str
        Their names with units, e.g. ``y (m)``.
    low, high : array_like, shape (outputs,)
        Limits of the output, or one for all; infinite by default.
    anti_windup : array_like, shape (states, outputs)
        L; see `anti_windup`. Zero by default.
    delay : int
        Delay of f in samples; a model that is fed back must delay it itself.
    patience : int
        Number of consecutive samples for which a missing input (NaN) is held; after them output and states are frozen.
    motion : Motion, optional
        Feedforward and setpoint of a controller of one error and one output, see `error_driven`.
    about : dict
        Further contents of its file: gains, provenance.

    Raises
    ------
    InputError
        When names and limits do not fit the model, or it winds up without a stable correction.

    References
    ----------
    Åström and Wittenmark, Computer-Controlled Systems (1997).

    Examples
    --------
    >>> pid = lti.tustin(control.PidFamily(10.0)(50.0).state_space(), 1e-4)
    >>> limited = control.DigitalController(pid, ("e (m)",), ("f (N)",), low=[-20.0], high=[20.0])
    >>> limited.run(np.full((1, 3), 1e-3))[0]  # N: an error of 1 mm is too much for it
    array([20., 20., 20.])
    """

    model: StateModel
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    low: Converted = -np.inf
    high: Converted = np.inf
    anti_windup: Converted = 0.0
    delay: Natural = 0
    about: dict = field(default_factory=dict)
    patience: Natural = PATIENCE
    motion: Motion | None = None

    @checked
    def __post_init__(self):
        check_fields(self)
        states, outputs = len(self.model.a), len(self.outputs)
        if not self.model.sample_time:
            raise InputError("model is in continuous time; discretise it first")
        if not self.inputs or len(self.model.c) != outputs or self.fed_back not in (0, outputs):
            raise InputError(
                f"inputs and outputs name {len(self.inputs)} and {outputs} signals for a model of "
                f"{self.model.d.shape[1]} and {len(self.model.c)}; name each, the limited outputs behind the "
                "inputs excepted"
            )
        if np.any(self.model.d[:, len(self.inputs) :]):
            raise InputError(
                "model: its output follows from the limited output of the same sample; delay that"
            )
        for name, shape in (("low", (outputs,)), ("high", (outputs,)), ("anti_windup", (states, outputs))):
            value = require_array(name, getattr(self, name), infinite=name != "anti_windup")
            if value.ndim and value.shape != shape:
                raise InputError(f"{name} has shape {value.shape}; give {shape} numbers, or one for all")
            object.__setattr__(self, name, np.broadcast_to(value, shape).copy())
        if not np.all(self.low < self.high):
            raise InputError("low is not below high; give the limits of each output")
        if self.limited and np.any(np.abs(linalg.eigvals(self._at_limit)) > 1 + AT_ONE):
            raise InputError(
                "anti_windup: the controller is unstable while its output is limited; give one that "
                "stabilises A - LC"
            )
        if self.motion is not None:
            self._require_motion(self.motion)

    def _require_motion(self, motion: Motion) -> None:
        if (len(self.inputs), len(self.outputs)) != (1, 1):
            raise InputError(
                f"motion is for a controller of one error and one output; this has {pluralise(len(self.inputs), 'input')} "
                f"and {pluralise(len(self.outputs), 'output')}"
            )
        motion.require_within(min(self.high[0], -self.low[0]))

    @property
    def fed_back(self) -> int:
        """Number of limited outputs that are inputs of the model."""
        return self.model.d.shape[1] - len(self.inputs)

    @property
    def limited(self) -> bool:
        """Whether there is any limit."""
        return bool(np.isfinite(self.low).any() or np.isfinite(self.high).any())

    @property
    def _back(self) -> np.ndarray:
        """From the limited outputs to the states' change: zeros where the model does not take them in."""
        m = self.model
        return m.b[:, len(self.inputs) :] if self.fed_back else np.zeros((len(m.a), len(m.c)))

    @property
    def _at_limit(self) -> np.ndarray:
        return self.model.a - self.anti_windup @ self.model.c

    @property
    def linear(self) -> StateModel:
        """From the inputs to the outputs while no limit is reached, without `delay`."""
        m, n, back = self.model, len(self.inputs), self._back
        return StateModel(m.a + back @ m.c, m.b[:, :n] + back @ m.d[:, :n], m.c, m.d[:, :n], m.sample_time)

    @property
    @checked
    def start(self) -> Float64[np.ndarray, "states signals"]:
        """Rows that map inputs and desired outputs to a state that gives them, a stationary one if there is any.

        Among the states with Cx + De = f, the one that changes least with e and f held.
        """
        m, outputs = self.model, len(self.outputs)
        states = len(m.a)
        held = np.hstack([m.b[:, : len(self.inputs)], self._back])
        wanted = np.hstack([-m.d[:, : len(self.inputs)], np.eye(outputs)])
        scale = linalg.matrix_balance(m.a, permute=False, separate=True)[1][0] if states else np.ones(0)
        c = m.c * scale
        meets = np.linalg.pinv(c)
        rest = (m.a - np.eye(states)) * scale / scale[:, None]
        free = linalg.null_space(c) if states else np.zeros((0, 0))
        left = -(held / scale[:, None] + rest @ meets @ wanted)
        return scale[:, None] * (meets @ wanted + free @ np.linalg.pinv(rest @ free) @ left)

    @checked
    def run(
        self, inputs: ArrayLike, first: ArrayLike | None = None, known: ArrayLike | None = None
    ) -> Float64[np.ndarray, "outputs samples"]:
        """Outputs of the processor, sample by sample.

        Parameters
        ----------
        inputs : ndarray, shape (inputs, samples)
            e, in the units of their names; NaN: missing.
        first : array_like, shape (outputs,), optional
            Output that acts when it is switched on (bumpless transfer); without it, the state starts at zero.
        known : array_like, shape (outputs, samples), optional
            u, the feedforward; the inputs are then deviations from the motion due to it.

        Returns
        -------
        ndarray, shape (outputs, samples)
            f, limited and delayed by `delay`.

        Raises
        ------
        InputError
            When there is not one row per input, or not one first output each.

        Examples
        --------
        >>> pid = lti.tustin(control.PidFamily(10.0)(50.0).state_space(), 1e-4)
        >>> started = control.DigitalController(pid, ("e (m)",), ("f (N)",)).run(np.zeros((1, 3)), first=[5.0])
        >>> started.round(9)  # N: bumpless transfer
        array([[5., 5., 5.]])
        """
        return self.trace(inputs, first, known).outputs

    @checked
    def trace(
        self, inputs: ArrayLike, first: ArrayLike | None = None, known: ArrayLike | None = None
    ) -> "Trace":
        """As `run`, with the flags of each sample.

        Parameters
        ----------
        inputs : ndarray, shape (inputs, samples)
        first : array_like, shape (outputs,), optional
        known : array_like, shape (outputs, samples), optional

        Returns
        -------
        Trace
            Outputs, and sums of `SATURATED`, `HELD` and `INVALID`.

        Raises
        ------
        InputError
            As `run`.

        Examples
        --------
        >>> twice = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[2.0]]), 1e-3)
        >>> limited = control.DigitalController(twice, ("e (m)",), ("f (N)",), high=5.0)
        >>> limited.trace([[1.0, np.nan, 3.0]]).flags  # nothing, held, saturated
        array([0, 2, 1])
        """
        m, n, outputs = self.model, len(self.inputs), len(self.outputs)
        inputs = require_array("inputs", inputs, shape=(n, None), missing=True)
        samples = inputs.shape[1]
        if known is None:
            known = np.zeros((outputs, samples))
        known = require_array("known", known, shape=(outputs, samples), missing=True)
        e, u, last, x = np.zeros(n), np.zeros(outputs), np.zeros(outputs), np.zeros(len(m.a))
        if first is not None:
            last = np.clip(require_array("first", first, shape=last.shape), self.low, self.high)
            e, u = inputs[:, 0], known[:, 0]
            if not np.isfinite([*e, *u]).all():
                raise InputError("inputs: the first sample is missing; start at a sample that is not")
            x = self.start @ np.concatenate([e, last - u])
        ring = [last] * self.delay
        found, flags = np.empty((outputs, samples)), np.zeros(samples, dtype=int)
        back, missing = self._back, 0
        for k in range(samples):
            given, fed = inputs[:, k], known[:, k]
            if np.isfinite(given).all() and np.isfinite(fed).all():
                missing = 0
            else:
                missing += 1
                flags[k] |= HELD
            e, u = np.where(np.isfinite(given), given, e), np.where(np.isfinite(fed), fed, u)
            with np.errstate(over="ignore", invalid="ignore"):
                command = m.c @ x + m.d[:, :n] @ e + u
                limited = np.clip(command, self.low, self.high)
                wound = self.anti_windup @ (limited - command)
                following = m.a @ x + m.b[:, :n] @ e + back @ (limited - u) + wound
            if missing > self.patience or not np.isfinite([*following, *command]).all():
                flags[k] |= INVALID
            else:
                x = following
                flags[k] |= SATURATED * bool(np.any(limited != command))
                ring.append(limited)
                last = ring.pop(0)
            found[:, k] = last
        return Trace(found, flags)

    def as_dict(self) -> dict[str, Any]:
        """Contents of its file; an infinite limit is null.

        Returns
        -------
        dict
            Lists and numbers, as in JSON.

        Examples
        --------
        >>> pid = lti.tustin(control.PidFamily(10.0)(50.0).state_space(), 1e-4)
        >>> limited = control.DigitalController(pid, ("e (m)",), ("f (N)",), low=[-20.0])
        >>> limited.as_dict()["low"], limited.as_dict()["high"]  # N
        ([-20.0], [None])
        """
        limits = {
            name: [None if np.isinf(x) else x for x in getattr(self, name).tolist()]
            for name in ("low", "high")
        }
        return self.about | {
            "format": FORMAT,
            "sample_time_s": self.model.sample_time,
            "inputs": list(self.inputs),
            "outputs": list(self.outputs),
            "state_space": {name: getattr(self.model, name).tolist() for name in "abcd"},
            **limits,
            "anti_windup": self.anti_windup.tolist(),
            "delay_samples": self.delay,
            "patience_samples": self.patience,
            "start": self.start.tolist(),
            "motion": self.motion and _motion_entries(self.motion),
            "interface": INTERFACE,
        }


class Trace(NamedTuple):
    """Outputs and flags of a controller, sample by sample."""

    outputs: np.ndarray  # (outputs, samples)
    flags: np.ndarray  # (samples,), sums of SATURATED, HELD and INVALID


def _motion_entries(motion: Motion) -> dict[str, Any]:
    limits = motion.limits and {
        name: None if value == np.inf else value for name, value in asdict(motion.limits).items()
    }
    return {"feedforward": asdict(motion.feedforward), "lag_s": motion.lag, "limits": limits}


def _read_motion(table: Table, lag: float) -> Motion:
    """From the entries of a file; `lag` is that of the controller's own delay."""

    def read(kind: type, name: str):
        entries = table.table(name)
        for entry in entries:
            require_choice(f"{entries.where}: {entry}", entry, [field.name for field in fields(kind)])
        return entries

    gains = read(Feedforward, "feedforward") if "feedforward" in table else {}
    limits = None
    if table.get("limits") is not None:
        given = read(MoveLimits, "limits")
        needed = {name: given[name] for name in ("velocity", "acceleration", "jerk")}
        snap = given.get("snap")
        limits = MoveLimits(**needed, snap=np.inf if snap is None else snap)
    return Motion(Feedforward(**gains), table.get("lag_s", lag), limits)


@checked(infinite=True)
def error_driven(controller: DigitalController, motion: Motion | None = None) -> DigitalController:
    """A controller of r and y as one of the error e = r - y, with which an observer needs no modified feedforward.

    A machine that follows r under the force u that is fed forward has y = r and f = u. A copy of the controller that
    runs on those, (A.7) and its Fig. A.2, subtracts from what the loop adds; linear as both are, their difference is
    one controller of r - y and f - u. The size of r does not matter to it: single precision suffices for an error.

    Parameters
    ----------
    controller : DigitalController
        With inputs r and y, one output, and optionally that output fed back.
    motion : Motion, optional
        In units of the controller.

    Returns
    -------
    DigitalController
        With the input e, without states that do not reach the output.

    Raises
    ------
    InputError
        When it has other inputs or more outputs, or `motion` may need more than its limits.

    References
    ----------
    Verkerk, Improved accuracy of flexible systems by state estimation, thesis (2018), appendix A.

    Examples
    --------
    >>> twice = lti.StateModel(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[2.0, -2.0]]), 1e-3)
    >>> of_error = control.error_driven(control.DigitalController(twice, ("r (m)", "y (m)"), ("f (N)",)))
    >>> of_error.inputs, of_error.run([[1.0, 0.5]], known=[[0.0, 3.0]])
    (('e (m)',), array([[2., 4.]]))
    """
    m = controller.model
    names = [name.partition(" ")[0] for name in controller.inputs]
    if names != ["r", "y"] or len(controller.outputs) != 1:
        raise InputError(f"controller has the inputs {', '.join(names)}; give one of r and y, and one output")
    model = replace(m, b=np.hstack([-m.b[:, 1:2], m.b[:, 2:]]), d=np.hstack([-m.d[:, 1:2], m.d[:, 2:]]))
    return without_dead_states(
        replace(controller, model=model, inputs=(f"e{controller.inputs[1][1:]}",), motion=motion)
    )


@checked(infinite=True)
def tied_to_error(controller: DigitalController) -> DigitalController:
    """A controller of r and y in which r counts as y does, as in its `error_driven` form, with all of its states."""
    b, d = (np.hstack([-each[:, 1:2], each[:, 1:]]) for each in (controller.model.b, controller.model.d))
    return replace(controller, model=replace(controller.model, b=b, d=d))


@checked(infinite=True)
def of_reference(controller: DigitalController) -> DigitalController:
    """A controller of the error as one of r and y, which count alike, as the functions of a loop take it."""
    m = controller.model
    b, d = (np.hstack([each[:, :1], -each[:, :1], each[:, 1:]]) for each in (m.b, m.d))
    names = tuple(f"{name}{controller.inputs[0][1:]}" for name in "ry")
    return replace(controller, model=replace(m, b=b, d=d), inputs=names, motion=None)


@checked(infinite=True)
def without_dead_states(controller: DigitalController) -> DigitalController:
    """Leave out states that no input reaches or that do not reach the output."""
    m, winds = controller.model, controller.anti_windup
    kept = _alive(m.a, np.hstack([m.b, winds]), m.c)
    if kept.all():
        return controller
    model = replace(m, a=m.a[np.ix_(kept, kept)], b=m.b[kept], c=m.c[:, kept])
    return replace(controller, model=model, anti_windup=winds[kept])


@checked
def observed_controller(controller: StateModel, compensator: StateModel) -> StateModel:
    """Feedback with an observer's compensator as one model: from (r, y, f), with f the applied force, to the command.

    Of one input and one output; the states of the controller are the last ones.
    """
    feedback = np.array([[0.0, 0, 0], [0, 0, 0], [0, 1, 0]])  # e_meas takes y_flex
    outside = np.array([[0.0, 0, 1], [0, 1, 0], [1, -1, 0]])
    return interconnect([compensator, controller], feedback, outside, np.array([[1.0, 0, 1]]))


@checked(infinite=True)
def runnable(
    pid: Pid,
    compensator: StateModel,
    limit: float | ArrayLike,
    about: dict,
    units: tuple[str, str] = ("m", "N"),
) -> DigitalController:
    """A sampled loop's controller as run by a processor: Tustin's PID with the compensator, and limits of both signs.

    The integrator tracks a limited force within the root of integral and differential time; the observer uses the limited force.
    The compensator is that of a sampled `bandwidth.Loop`, the limit, N, may be infinite. `units` are those of the
    position and of the force.
    """
    limit = require_array("limit", limit, shape=(), infinite=True)
    sample_time = compensator.sample_time
    feedback = tustin(pid.state_space(), sample_time)
    tracking_time = 1 / np.sqrt(pid.integrator * pid.differentiator)
    winding = np.vstack([np.zeros((len(compensator.a), 1)), anti_windup(feedback, tracking_time)])
    return DigitalController(
        observed_controller(feedback, compensator),
        tuple(f"{name} ({units[0]})" for name in "ry"),
        (f"f ({units[1]})",),
        -limit,
        limit,
        winding,
        about=about,
    )


@checked(infinite=True)
def in_units(
    controller: DigitalController, position: Positive, drive: Positive, units: tuple[str, str]
) -> DigitalController:
    """A controller of `runnable` in other units; `position` and `force` are the new units per old unit."""
    m, n = controller.model, len(controller.inputs)
    b = np.hstack([m.b[:, :n] / position, m.b[:, n:] / drive])
    model = StateModel(m.a, b, m.c * drive, m.d * drive / position, m.sample_time)
    return replace(
        controller,
        model=model,
        inputs=tuple(f"{name} ({units[0]})" for name in "ry"),
        outputs=(f"f ({units[1]})",),
        low=controller.low * drive,
        high=controller.high * drive,
        anti_windup=controller.anti_windup / drive,
    )


@checked
def anti_windup(model: StateModel, tracking_time: Positive) -> Float64[np.ndarray, "states outputs"]:
    """Back-calculation L that takes every integrator to the limited output within `tracking_time` (s).

    It acts on the poles at 1 alone, which become exp(-sample_time/tracking_time) in A - LC; the others stay. For a PID
    the root of integral and differential time is usual: Astrom and Hagglund, PID Controllers (1995), section 3.5.
    """
    poles, left, right = (
        linalg.eig(model.a, left=True) if len(model.a) else (np.zeros(0), *np.zeros((2, 0, 0)))
    )
    ones = np.abs(poles - 1) < AT_ONE
    if not ones.any():
        return np.zeros((len(model.a), len(model.c)))
    left, right = left[:, ones].real, right[:, ones].real
    overlap = left.T @ right
    seen = model.c @ right
    if np.linalg.matrix_rank(seen) < seen.shape[1] or np.linalg.cond(overlap) > 1e9:
        raise InputError(
            "model has integrators in series, or more integrators than outputs; give the gain anti_windup"
        )
    return -np.expm1(-model.sample_time / tracking_time) * right @ np.linalg.pinv(seen)


@checked
def from_biquads(sections: ArrayLike, sample_time: Positive) -> StateModel:
    """Model of biquads in a row, (b0, b1, b2, 1, a1, a2) each as SciPy has them, in a form that single precision can hold.

    The states rotate as the poles do; b and a themselves would keep only a few digits near z = 1.
    """
    sections = require_array("sections", sections, shape=(None, 6))
    if not len(sections) or np.any(sections[:, 3] != 1):
        raise InputError("sections must hold at least one (b0, b1, b2, 1, a1, a2)")
    models = []
    for b0, b1, b2, _, a1, a2 in sections:
        n1, n0, square = b1 - a1 * b0, b2 - a2 * b0, a1 * a1 / 4 - a2
        if a2 == b2 == 0:  # of first order: one state, and none that only delays
            a, c = [[-a1]], [[n1]]
        elif square < 0:
            turn, middle = np.sqrt(-square), -a1 / 2
            a = [[middle, turn], [-turn, middle]]
            c = [[(n0 + n1 * middle) / turn, n1]]
        else:
            outer = -a1 / 2 - np.copysign(np.sqrt(square), a1)
            inner = a2 / outer if outer else 0.0
            a, c = [[outer, 1.0], [0.0, inner]], [[n0 + n1 * outer, n1]]
        models.append(
            StateModel(np.array(a), np.eye(len(a))[:, -1:], np.array(c), np.array([[b0]]), sample_time)
        )
    return series(models)


class EquivalentBiquads(NamedTuple):
    """A controller of r and y in a drive's form, f = feedback(r - y) + reference(r), within its limits."""

    feedback: np.ndarray  # (sections, 6)
    reference: np.ndarray | None  # (sections, 6); None: nothing is added
    error: float  # largest relative difference from the controller's own response


@checked(infinite=True)
def equivalent_biquads(controller: DigitalController) -> EquivalentBiquads | None:
    """Second-order sections of a controller's whole linear map from (r, y), or r - y, to f, including an observer.

    None where a pole lies outside the unit circle, the integrator of the reference's part does not cancel, or the
    sections differ from the controller's response by more than `ALIKE` at a frequency.
    """
    m = controller.linear
    if m.d.shape == (1, 1):
        m = replace(m, b=np.hstack([m.b, -m.b]), d=np.hstack([m.d, -m.d]))
    if m.d.shape != (1, 2):
        raise InputError("controller must have the inputs r and y, or their difference, and one output")
    feedback = StateModel(m.a, -m.b[:, 1:], m.c, -m.d[:, 1:], m.sample_time)
    together = m.b.sum(axis=1, keepdims=True), m.d.sum(axis=1, keepdims=True)
    reference = StateModel(m.a, together[0], m.c, together[1], m.sample_time)
    omega = np.geomspace(1e-4, 0.99, 400) * np.pi / m.sample_time
    wanted, beside = (each.frequency_response(omega)[0, 0] for each in (feedback, reference))
    found = _sections(feedback, omega, wanted, np.abs(wanted), forgets=False)
    if found is None:
        return None
    sections, error = found
    if np.abs(beside).max() <= AT_ONE * np.abs(wanted).min():  # without an observer r and y count alike
        return EquivalentBiquads(sections, None, error)
    # What r adds counts beside all that r does.
    size = np.maximum(np.abs(wanted + beside), np.abs(beside))
    added = _sections(reference, omega, beside, size, forgets=True)
    return None if added is None else EquivalentBiquads(sections, added[0], max(error, added[1]))


def _sections(
    model: StateModel, omega: np.ndarray, wanted: np.ndarray, size: np.ndarray, forgets: bool
) -> tuple[np.ndarray, float] | None:
    """Sections of a stable model and their largest error over a size; with `forgets` its integrators must cancel."""
    # Of z - 1: near 1, where a fast sampled controller has its poles and zeros, z itself has lost its digits.
    lifted = _minimal(replace(model, a=model.a - np.eye(len(model.a))))
    zeros, poles = lifted.zeros, lifted.poles
    poles[np.abs(poles) < AT_ONE] = 0.0
    if np.any(np.abs(1 + poles[poles != 0]) >= 1):
        return None
    for pole in poles:  # what the input does not reach, or the output does not show
        apart = np.abs(zeros - pole)
        if len(zeros) and apart.min() < (SAME if pole == 0 else AT_ONE):
            zeros, poles = np.delete(zeros, apart.argmin()), np.delete(poles, np.abs(poles - pole).argmin())
    if forgets and np.any(poles == 0):
        return None
    step = 2j * np.sin(omega * model.sample_time / 2) * np.exp(0.5j * omega * model.sample_time)

    def shape():
        return np.exp(np.log(step[:, None] - zeros).sum(axis=1) - np.log(step[:, None] - poles).sum(axis=1))

    first = shape()
    gain = float(np.sum((first.conj() * wanted).real / size**2) / np.sum(np.abs(first / size) ** 2))
    best = (np.inf, gain, zeros)
    for _ in range(4):  # Gauss and Newton, on the error of both halves of the circle
        now = gain * shape() / size
        error = wanted / size - now
        if not np.abs(error).max() < best[0]:
            break
        best = (float(np.abs(error).max()), gain, zeros)
        slopes = now[:, None] * np.column_stack([np.ones(len(step)), -1 / (step[:, None] - zeros)])
        turned = now.conj()[:, None] * np.column_stack(
            [np.ones(len(step)), -1 / (step.conj()[:, None] - zeros)]
        )
        slopes = np.asarray_chkfinite(np.vstack([slopes, turned]))
        moves = np.linalg.lstsq(slopes, np.append(error, error.conj()), rcond=1e-10)[0]
        gain, zeros = gain * (1 + moves[0].real), zeros + moves[1:]
    _, gain, zeros = best
    zeros, poles = (_conjugate(1 + each) for each in (zeros, poles))
    sections = signal.zpk2sos(zeros, poles, gain)
    for _ in range(
        len(poles) - len(zeros)
    ):  # SciPy puts a zero at 0, a sample too early, for each that lacks
        late = np.flatnonzero(sections[:, 2] == 0)
        if not len(late):
            return None
        sections[late[0], :3] = 0.0, *sections[late[0], :2]
    found = signal.sosfreqz(sections, omega * model.sample_time)[1]
    worst = float(np.abs((found - wanted) / size).max())
    return (sections, worst) if worst <= ALIKE else None


def _alive(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Mask of the states that some coefficient leads to from the input, and from which one leads to the output."""
    links = (a != 0) | np.eye(len(a), dtype=bool)
    reached, seen = np.any(b, axis=1), np.any(c, axis=0)
    for _ in range(len(links)):
        reached, seen = links @ reached, seen @ links
    return reached & seen


def _minimal(model: StateModel) -> StateModel:
    """Without the states that no coefficient leads to from the input, or from which none leads to the output."""
    kept = _alive(model.a, model.b, model.c)
    return replace(model, a=model.a[np.ix_(kept, kept)], b=model.b[kept], c=model.c[:, kept])


def _conjugate(roots: np.ndarray) -> np.ndarray:
    """The roots with each pair exactly conjugate, and what is real but for rounding real."""
    real = np.abs(roots.imag) <= AT_ONE * np.maximum(np.abs(roots), 1)
    upper = roots[~real & (roots.imag > 0)]
    return np.concatenate([upper, upper.conj(), roots[real].real.astype(complex)])


@checked(infinite=True)
def load_controller(file: str | Path) -> DigitalController:
    """Read a controller from the JSON file that `design` writes, or from a table ``controller`` in JSON or TOML.

    The table holds ``rate_hz`` and either ``biquads`` or ``a``, ``b``, ``c`` and ``d``; optionally ``inputs``,
    ``outputs``, ``low``, ``high``, ``delay_samples``, ``patience_samples`` and ``tracking_time_s``, the time of
    anti-wind-up. Of one input and one output a table [controller.motion] may hold ``lag_s`` and two tables,
    ``feedforward`` with the fields of `Feedforward` and ``limits`` with those of `MoveLimits`.

    Parameters
    ----------
    file : str or Path

    Returns
    -------
    DigitalController
        Ready to run sample by sample, or to be exported.

    Raises
    ------
    InputError
        When it is none of these; the message states what is missing.

    Examples
    --------
    >>> text = '[controller]\\nrate_hz = 1000.0\\nbiquads = [[0.5, 0.5, 0.0, 1.0, 0.0, 0.0]]\\n'
    >>> _ = open("mean.toml", "w").write(text)
    >>> control.load_controller("mean.toml").run(np.ones((1, 3)))
    array([[0.5, 1. , 1. ]])
    """
    file = Path(file)
    if file.suffix.lower() == ".toml":
        return _from_table(read_toml(file), file.name)
    table = read_json(file)
    if "controller" in table:
        return _from_table(table, file.name)
    if table["format"] != FORMAT:
        raise InputError(
            f"{file.name}: format is {short_repr(table['format'])}; the supported format is {FORMAT!r}"
        )
    space = table.table("state_space")
    model = _model(space, table["sample_time_s"])
    read = {
        "low": [-np.inf if x is None else x for x in _list(table, "low")],
        "high": [np.inf if x is None else x for x in _list(table, "high")],
        "anti_windup": require_array("anti_windup", table["anti_windup"]) if len(model.a) else 0.0,
        "delay": table["delay_samples"],
        "patience": table.get("patience_samples", PATIENCE),
        "about": {name: value for name, value in table.items() if name not in KEPT},
    }
    if table.get("motion") is not None:
        read["motion"] = _read_motion(table.table("motion"), 0.0)
    return DigitalController(model, tuple(_list(table, "inputs")), tuple(_list(table, "outputs")), **read)


@checked
def read_json(file: str | Path) -> Table:
    """The entries of a JSON file; `InputError` when it is none, or holds no table."""
    file = Path(file)
    try:
        entries = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{short_repr(str(file))} cannot be read ({error.strerror}); give a JSON or TOML file"
        ) from None
    except (ValueError, RecursionError):
        entries = None
    if not isinstance(entries, dict):
        raise InputError(f"{file.name} is no controller; give the controller.json that design wrote")
    return Table(entries, file.name)


def _from_table(entries: Table, name: str) -> DigitalController:
    try:
        return _of_numbers(entries.table("controller"))
    except InputError as error:
        raise InputError(str(error) if name in str(error) else f"{name}: {error}") from None


def _of_numbers(table: Table) -> DigitalController:
    sample_time = 1 / require_number("rate_hz", table["rate_hz"], above=0.0)
    if "biquads" in table:
        model = from_biquads(require_array("biquads", table["biquads"], shape=(None, 6)), sample_time)
    else:
        model = _model(table, sample_time)
    outputs, inputs = model.d.shape
    read: dict[str, Any] = {
        name: tuple(table.get(name, [f"{name[:-1]} {k + 1}" for k in range(count)]))
        for name, count in (("inputs", inputs), ("outputs", outputs))
    }
    read |= {name: table[name] for name in ("low", "high") if name in table}
    if "tracking_time_s" in table:
        read["anti_windup"] = anti_windup(model, table["tracking_time_s"])
    delay = table.get("delay_samples", 0)
    read["patience"] = table.get("patience_samples", PATIENCE)
    if "motion" in table:
        lag = (require_number("delay_samples", delay) + 0.5) * sample_time
        read["motion"] = _read_motion(table.table("motion"), lag)
    return DigitalController(model, delay=delay, **read)


def _model(table: Table, sample_time: float) -> StateModel:
    a, b, c, d = (require_array(f"{table.where}: {name}", table[name]) for name in "abcd")
    if d.ndim == 2 and not a.size:  # without states the other lists are empty
        a, b, c = np.zeros((0, 0)), np.zeros((0, d.shape[1])), np.zeros((len(d), 0))
    return StateModel(a, b, c, d, sample_time)


def _list(table: Table, name: str) -> list:
    if not isinstance(table[name], list):
        raise InputError(f"{table.where}: {name} is {short_repr(table[name])}; give a list")
    return table[name]
