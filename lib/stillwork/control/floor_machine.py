"""A stage on a frame on an isolator on a shaking floor, along one axis, as the network of an error budget."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from scipy import signal

from stillwork.base.bounds import Count, NonNegative, Positive, at_least
from stillwork.base.checks import InputError
from stillwork.base.validation import by_value, check_fields, checked
from stillwork.control.budget import Network
from stillwork.control.digital import observed_controller
from stillwork.control.pid import Pid
from stillwork.lti.discretisation import tustin
from stillwork.lti.modal import ModalModel
from stillwork.lti.state_space import StateModel, interconnect

DISTURBANCES = {"floor": "m/s^2", "stage force": "N", "frame force": "N", "setpoint": "m"}
COMMANDS = {"stage drive": "N", "isolator drive": "N"}
ERRORS = {"stage to frame": "m", "frame": "m/s^2"}  # the first less the setpoint
MEASUREMENTS = {"stage sensor": "m", "frame sensor": "m/s^2", "floor sensor": "m/s^2"}


@by_value
@dataclass(frozen=True)
class FloorMachine:
    r"""A stage that floats over a frame and is held by its controller; the frame on springs, a skyhook and a feedforward.

    The frame of mass M moves by :math:`M\ddot x = -k(x - x_0) - d(\dot x - \dot x_0) + u - f + w`, with the floor
    :math:`x_0` and the reaction of the force f on the stage. The isolator commands
    :math:`u = -\frac{c}{s + \omega_s}\ddot x - g(dH + kH^2)\ddot x_0`, with weak integrators
    :math:`H = (1 - (\alpha/(s + \alpha))^n)/s`.

    Attributes
    ----------
    frame_mass : float
        kg.
    suspension_hz, suspension_damping : float
        Of frame and stage together on the passive springs; the damping as ratio to critical.
    stage : ModalModel
        Free stage, force (N) to position (m); its first mode is the rigid body.
    controller : Pid or StateModel
        Acts on the stage's error; a StateModel from the stage sensor to the force, including its sign, sampled if the machine is.
    compensator : StateModel, optional
        Compensator of an observer, see `compensator`; sampled if the machine is.
    isolator : StateModel, optional
        From frame and floor sensor to the isolator's force, in place of skyhook and feedforward; sampled if the machine is.
    isolator_pole_hz : float
        First-order lag from the isolator's drive to its force; 0: none.
    skyhook : float
        Damping ratio that it adds.
    skyhook_hz : float
        Corner below which it does not act.
    feedforward : float
        g, share of the floor's path that it cancels: 0 none, 0.968 for 30 dB.
    integrator_hz : float
        Corner of the weak integrators; they are of order `integrator_order`.
    sample_time : float
        s, of all controllers; 0: continuous time.
    delay : float
        Samples from a command to its force.

    Raises
    ------
    InputError
        When the stage is not free with one rigid body, or a number is out of its range.

    References
    ----------
    The isolator: the paper that extends Beijen, Heertjes, van Dijk and Hakvoort, Control Engineering Practice 72 (2018),
    eqs. (1) and (10)-(12). The stage: Verkerk, thesis (2018), Fig. 3.4.

    Examples
    --------
    >>> stage = lti.ModalModel([0.0], [0.0], [[0.5]], [[0.5]], [[0.0]])  # 4 kg
    >>> machine = control.FloorMachine(16.0, 5.0, 0.05, stage, control.PidFamily(4.0)(50.0))
    >>> push = control.Source("push", ("stage force",), "N", lambda f: np.full(len(f), 1e-6))
    >>> round(float(control.error_budget(machine.network(), [push], (0.5, 300.0)).rms[0]), 9)  # m, of stage to frame
    3.4e-08
    """

    frame_mass: Positive
    suspension_hz: Positive
    suspension_damping: NonNegative
    stage: ModalModel
    controller: Pid | StateModel
    compensator: StateModel | None = None
    isolator: StateModel | None = None
    isolator_pole_hz: NonNegative = 0.0
    skyhook: NonNegative = 0.0
    skyhook_hz: Positive = field(default=1 / (2 * np.pi))
    feedforward: float = 0.0
    integrator_hz: Positive = 2.0
    integrator_order: Annotated[int, at_least(2)] = 3
    sample_time: NonNegative = 0.0
    delay: NonNegative = 0.0

    def __post_init__(self):
        check_fields(self)
        if (
            self.stage.rigid_modes != 1
            or self.stage.input_shapes.shape[1] != 1
            or len(self.stage.output_shapes) != 1
        ):
            raise InputError(
                "stage must be free, with one rigid body, one force and one sensor; fit it without a suspension"
            )

    @property
    def stage_mass(self) -> float:
        """kg."""
        return float(1 / (self.stage.input_shapes[0, 0] * self.stage.output_shapes[0, 0]))

    @property
    def suspension(self) -> tuple[float, float, float]:
        """Stiffness (N/m), passive damping (N s/m), and damping for a ratio of 1."""
        omega, mass = 2 * np.pi * self.suspension_hz, self.frame_mass + self.stage_mass
        return omega**2 * mass, 2 * self.suspension_damping * omega * mass, 2 * omega * mass

    def _plant(self) -> StateModel:
        """From `DISTURBANCES` and `COMMANDS` to `ERRORS` and `MEASUREMENTS`, in motions relative to the floor."""
        stage, (k, d, _), mass = self.stage.state_space(), self.suspension, self.frame_mass
        n = len(stage.a)
        a = np.zeros((n + 2, n + 2))
        a[0, 1], a[1, :2], a[2:, 2:] = 1, (-k / mass, -d / mass), stage.a
        b = np.zeros((n + 2, 6))
        b[1] = -1, 0, 1 / mass, 0, -1 / mass, 1 / mass
        b[2:, [1, 4]] = stage.b
        b[3, 0] = -1 / stage.c[0, 0]  # of the rigid body alone: the others do not feel a shift of all
        apart = np.concatenate([[-1.0, 0.0], stage.c[0]])
        frame = a[1].copy()
        c = np.array([apart, frame, apart, frame, np.zeros(n + 2)])
        felt = b[1] + [1, 0, 0, 0, 0, 0]  # the frame's own acceleration, not relative to the floor's
        apart_at_once = float(stage.d[0, 0]) * np.array([0, 1, 0, 0, 1, 0]) - [0, 0, 0, 1, 0, 0]
        plant = StateModel(a, b, c, np.array([apart_at_once, felt, apart_at_once, felt, [1, 0, 0, 0, 0, 0]]))
        return self._lagging(plant) if self.isolator_pole_hz else plant

    def _lagging(self, plant: StateModel) -> StateModel:
        """The plant with the isolator's drive, its last input, behind a lag."""
        pole, one = 2 * np.pi * self.isolator_pole_hz, np.ones((1, 1))
        lag = StateModel(-pole * one, one, pole * one, 0 * one)
        inputs, outputs = plant.d.shape[1], len(plant.d)
        feedback = np.zeros((inputs + 1, outputs + 1))
        feedback[inputs - 1, outputs] = 1  # the last input of the plant from the lag
        entering = np.eye(inputs + 1)[:, [*range(inputs - 1), inputs]]
        return interconnect([plant, lag], feedback, entering, np.eye(outputs, outputs + 1))

    def _stage_law(self) -> StateModel:
        """From the stage sensor to the force on the stage."""
        if isinstance(self.controller, StateModel):
            return self.controller
        pid = self._sampled(self.controller.state_space())
        if self.compensator is None:
            return StateModel(pid.a, pid.b, -pid.c, -pid.d, pid.sample_time)
        return force_law(observed_controller(pid, self.compensator))

    def _isolator_law(self) -> StateModel:
        """From frame and floor sensors to the isolator's force."""
        if self.isolator is not None:
            return self.isolator
        k, d, critical = self.suspension
        sky = 2 * np.pi * self.skyhook_hz
        lag = np.ones((1, 1))
        skyhook = StateModel(-sky * lag, lag, -self.skyhook * critical * lag, 0 * lag)
        first = weak_integrator(self.integrator_hz, self.integrator_order)
        forward = interconnect(
            [first, first],
            np.array([[0.0, 0], [1, 0]]),
            np.array([[1.0], [0]]),
            -self.feedforward * np.array([[d, k]]),
        )
        return self._sampled(interconnect([skyhook, forward], np.zeros((2, 2)), np.eye(2), np.ones((1, 2))))

    def _sampled(self, model: StateModel) -> StateModel:
        return tustin(model, self.sample_time) if self.sample_time else model

    def network(self) -> Network:
        """The closed loop with its places for sources.

        Returns
        -------
        Network

        Raises
        ------
        InputError
            When it is unstable.

        Examples
        --------
        >>> stage = lti.ModalModel([0.0], [0.0], [[0.5]], [[0.5]], [[0.0]])  # 4 kg
        >>> machine = control.FloorMachine(16.0, 5.0, 0.05, stage, control.PidFamily(4.0)(50.0))
        >>> list(machine.network().places)[:3]
        ['floor', 'stage force', 'frame force']
        """
        laws = [self._stage_law(), self._isolator_law()]
        controller = interconnect(laws, np.zeros((3, 2)), np.eye(3), np.eye(2))
        return Network(
            self._plant(),
            controller,
            DISTURBANCES,
            COMMANDS,
            ERRORS,
            MEASUREMENTS,
            self.delay * self.sample_time,
        )


@checked
def force_law(model: StateModel) -> StateModel:
    """A controller from (r, y, f), where f is its own output or left out, as one from y alone; see `observed_controller`."""
    if model.d.shape[1] == 2:
        return model.select([1], [0])
    feedback = np.array([[0.0], [1.0]])
    return interconnect([model.select([1, 2], [0])], feedback, feedback[::-1].copy(), np.ones((1, 1)))


@checked
def weak_integrator(corner_hz: Positive, order: Count) -> StateModel:
    """(1 - (a / (s + a))^n) / s, an integrator that ignores motion slower than its corner."""
    alpha = 2 * np.pi * corner_hz
    whole = np.poly(-np.ones(order))  # in s / a, so that all states are of one size
    a, b, c, d = signal.tf2ss(whole[:-1], whole)
    return StateModel(a * alpha, b, c, d)
